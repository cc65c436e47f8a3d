"""The report of a survey of peaks: no empty columns, nothing about a fit that cannot be."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from statistics import fmean

import numpy as np
import pytest

from pfwd.files.importing import import_files
from pfwd.files.traces import TracePoint, write_traces
from pfwd.report.blocks import Pairs, Paragraph, Picture, Table
from pfwd.report.certificate_blocks import points_table
from pfwd.report.composing import compose
from pfwd.report.fonts import Letters
from pfwd.report.gathering import ReportOptions, gather
from pfwd.report.peaks_blocks import basin_of_drop, has_only_peaks
from tests.pfwd.report.surveys import EN, SETUP, drawn, flat, half_sine_drop


def test_peaks_have_no_empty_column_and_no_fitted_modulus(peaks: Path) -> None:
    report = gather(peaks)
    assert has_only_peaks(report)
    table = points_table(report, EN)
    assert "Modulus E" not in table.columns
    assert [title for title in table.columns if title in ("Target", "Verdict", "s/v, ms")] == []
    columns = list(zip(*table.rows, strict=True))
    assert all(any(cell != "–" for cell in column) for column in columns)
    point, row = report.points[0], dict(zip(table.columns, table.rows[0], strict=True))
    depths = [drop.peaks.centre for drop in point.drops if drop.peaks and drop.peaks.centre]
    assert float(str(row["s,\N{NO-BREAK SPACE}µm"])) == pytest.approx(1e6 * fmean(depths), rel=5e-3)
    indices = [basin.sci_m for drop in point.drops if (basin := basin_of_drop(drop))]
    assert float(str(row["SCI, µm"])) == pytest.approx(
        1e6 * fmean(value for value in indices if value is not None), rel=5e-3
    )


def test_peaks_have_no_text_on_histories_and_fits(peaks: Path) -> None:
    blocks = flat(compose(gather(peaks), EN, Letters()))
    paragraphs = [block.text for block in blocks if isinstance(block, Paragraph)]
    pairs = dict(row for block in blocks if isinstance(block, Pairs) for row in block.rows)
    assert paragraphs[0] == "Deflectometer report: peaks of load and deflection"
    assert pairs["Judged by"].startswith("peaks of load and deflection as recorded")
    assert EN["settings"] not in pairs
    assert EN["uncertainty_note"] not in paragraphs
    assert not any(text.startswith(EN["traces_note"]) for text in paragraphs)
    assert not any("full time history" in text for text in [*paragraphs, *pairs.values()])


def test_a_procedure_that_needs_no_more_has_its_columns(peaks: Path) -> None:
    report = gather(peaks, ReportOptions(procedure="astm-e2583", target=5e-4))
    table = points_table(report, EN)
    assert table.columns[-3:] == ("Peak deflection", "Target", "Verdict")
    paragraphs = [b.text for b in flat(compose(report, EN, Letters())) if isinstance(b, Paragraph)]
    assert EN["uncertainty_note"] in paragraphs


def test_the_peaks_of_all_sensors_are_in_tables_and_picture(peaks: Path) -> None:
    report = gather(peaks)
    blocks = flat(compose(report, EN, Letters()))
    (picture,) = (b for b in blocks if isinstance(b, Picture) and "sensor" in b.caption)
    depth, moduli = drawn(picture).axes
    drops = report.points[0].drops
    recorded = [dict(drop.peaks.displacements) for drop in drops if drop.peaks is not None]
    offsets = sorted(recorded[0])
    assert len(depth.lines) == len(offsets)
    for line, offset in zip(depth.lines, offsets, strict=True):
        assert line.get_ydata()[0] == pytest.approx(1e6 * fmean(p[offset] for p in recorded))
    assert np.isfinite(moduli.lines[0].get_ydata()).all()
    tables = [block for block in blocks if isinstance(block, Table)]
    (sensors, _) = (table for table in tables if any("d(" in title for title in table.columns))
    assert len(sensors.columns) == 3 + len(offsets)
    assert float(str(sensors.rows[0][3])) == pytest.approx(1e6 * recorded[0][offsets[0]], rel=5e-3)


def test_names_in_a_crowded_sketch_do_not_overlap(peaks: Path) -> None:
    first = gather(peaks)
    points = []
    for number in range(40):
        place = {"latitude": 48.0 + 2e-4 * number, "longitude": 2.0 + 1e-4 * number}
        name = {"name": f"station {number}", "title": f"station {number}"}
        place_of = {"place": {**place, "source": "declared"}}
        points.append(replace(first.points[0], whole=None, **name, **place_of))
    report = replace(first, points=tuple(points))
    blocks = flat(compose(report, EN, Letters()))
    (sketch,) = (b for b in blocks if isinstance(b, Picture) and b.alternative == EN["map"])
    (axes,) = drawn(sketch).axes
    renderer = axes.figure.canvas.get_renderer()
    names = [text for text in axes.texts if text.get_text().isdigit()]
    assert len(names) > 5
    boxes = [name.get_window_extent(renderer) for name in names]
    assert not any(first.overlaps(second) for first, second in combinations(boxes, 2))


def test_a_report_of_a_rig_has_its_stiffness_and_no_modulus(tmp_path: Path) -> None:
    setup = replace(SETUP, plate_radius=0.0, rig_stiffness=16e6)
    drops = (half_sine_drop(1, 8000.0), half_sine_drop(2, 8010.0))
    write_traces(tmp_path / "R1.csv", TracePoint("", setup, drops, ()))
    list(import_files([str(tmp_path / "R1.csv")], tmp_path / "rig"))
    report = gather(tmp_path / "rig")
    blocks = flat(compose(report, EN, Letters()))
    first = next(block for block in blocks if isinstance(block, Table))
    assert first.columns[-2:] == ("Stiffness, secant, MN/m", "Stiffness, dynamic, MN/m")
    assert first.rows[0][2:4] == ("2", "8.01")
    assert 15.0 < float(str(first.rows[0][-2])) < 18.0  # 8 kN move 0.5 mm
    pairs = dict(row for block in blocks if isinstance(block, Pairs) for row in block.rows)
    assert pairs["Judged by"] == EN["stiffness_basis"]
    assert "rejected" not in str([block.rows for block in blocks if isinstance(block, Table)])
    notes = [block.text for block in blocks if isinstance(block, Paragraph)]
    assert EN["uncertainty_note"] not in notes
    assert EN["report_of_stiffness"] in notes
    judged = gather(tmp_path / "rig", ReportOptions(procedure="astm-e2835"))
    assert judged.points[0].progress.value is None
