"""The first page: what the procedure's document asks for, and deflection curves past their peak."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from inversion.notices import Notice
from pfwd.analysis.drop_facts import judged_deflection
from pfwd.files.editing import Edit, edit_survey
from pfwd.files.importing import import_files
from pfwd.files.traces import TracePoint, write_traces
from pfwd.judging import PointView
from pfwd.report import drawing
from pfwd.report.blocks import Pairs, Paragraph, Picture, Table
from pfwd.report.certificate_blocks import certificate_blocks, points_table, verdict_reasons
from pfwd.report.composing import compose
from pfwd.report.content import Report
from pfwd.report.fonts import Letters
from pfwd.report.gathering import ReportOptions, gather
from pfwd.report.point_facts import time_with_zone
from pfwd_device import Channel
from tests.pfwd.report.surveys import EN, SETUP, RecordedInversion, half_sine_drop


def rows_of(report: Report) -> dict[str, str]:
    blocks = certificate_blocks(report, EN, Letters())
    return dict(next(block for block in blocks if isinstance(block, Pairs)).rows)


def table_of(report: Report) -> tuple[list[str], Table]:
    """Return the titles of the columns, with plain spaces, and the table of the points."""
    table = points_table(report, EN)
    return [title.replace("\N{NO-BREAK SPACE}", " ") for title in table.columns], table


SEATED = "3 (seating) + 3 (measured)"
E_VD, E_LWD = (
    "E_vd = 1.5 r σ / s̄, σ = 0.1 MPa",
    "E_LWD = 2 (1 - ν²) r σ / s̄, σ = F / (π r²), ν = 0.35",
)
S, MEAN, V, S_V, F = "s, mm", "s̄, mm", "v, mm/s", "s/v, ms", "F, kN"
MODULUS, EQUIVALENT = "Modulus E", "Equivalent modulus"


@pytest.mark.parametrize(
    ("procedure", "formula", "drops", "columns"),
    [
        ("tp-bf-stb-b8.3", E_VD, SEATED, [S, MEAN, V, S_V, "E_vd", MODULUS]),
        ("mchw-885", E_LWD, SEATED, [S, MEAN, F, "E_LWD", MODULUS]),
        ("mndot", None, SEATED, [S, F, "Peak deflection", MODULUS]),
        ("paper", None, None, [S, MEAN, F, MODULUS, EQUIVALENT]),
        (None, None, None, [S, MEAN, V, S_V, EQUIVALENT, MODULUS]),
    ],
)
def test_the_first_page_has_the_formula_and_columns_of_its_procedure(
    survey: Path, procedure: str | None, formula: str | None, drops: str | None, columns: list[str]
) -> None:
    report = gather(survey, ReportOptions(procedure=procedure))
    rows, (titles, table) = rows_of(report), table_of(report)
    assert (rows.get("Formula"), rows.get("Drops at a point")) == (formula, drops)
    assert titles == ["Point", "Time", *columns, "Target", "Verdict"]
    right = [titles[place] for place in table.right]
    assert right == [name for name in columns if name in (MEAN, V, S_V, F)]


def test_an_incomplete_point_shows_its_drops(survey: Path) -> None:
    report = gather(survey, ReportOptions(procedure="tp-bf-stb-b8.3", target=40e6))
    first = report.points[0]
    short = replace(first, drops=first.drops[:2], whole=None)  # both are seating drops
    report = replace(report, points=(short, *report.points[1:]))
    titles, table = table_of(report)
    row = dict(zip(titles, table.rows[0], strict=True))
    assert row["s, mm"] == "0.500 / 0.500"
    assert row["s̄, mm"] == row["E_vd"] == "–"
    assert row["v, mm/s"] != "–"
    assert row["F, kN"] == "8.00"
    assert row["Modulus E"] == "45.1 / 45.2 MPa"
    blocks = certificate_blocks(replace(report, points=(short,)), EN, Letters())
    assert Paragraph(EN["existing_drops"], "note") in blocks
    assert any(isinstance(block, Picture) and block.caption for block in blocks), "the curves"
    assert "measured: 8.00 kN" in rows_of(replace(report, points=(short,)))["Peak load"]


def test_loads_pressures_and_conditions_are_stated(survey: Path) -> None:
    report = gather(survey)
    assert rows_of(report)["Peak load"] == "measured: 8.00 – 8.03 kN, σ = 113 – 114 kPa"
    by_nominal = rows_of(gather(survey, ReportOptions(procedure="tp-bf-stb-b8.3")))["Peak load"]
    assert "presumed: 7.07 kN, σ = 100 kPa (± 10 %" in by_nominal
    assert "Conditions" not in rows_of(report)
    first, second = report.points

    def declared(point: PointView, **values: Any) -> PointView:
        setup = replace(point.setup, **values)
        return replace(point, drops=[replace(drop, setup=setup) for drop in point.drops])

    wet = declared(first, moisture=5.5, temperature=12.0)
    dry = declared(second, moisture=4.0, material="gravel")
    conditions = rows_of(replace(report, points=(wet, dry)))["Conditions"]
    assert conditions == "Material: gravel; Moisture: 4 – 5.5 %; Temperature: 12 °C"


def drawn_curves(points: list[PointView]) -> list[Any]:
    """Return the axes of the picture of the first page."""
    figure = Figure(figsize=(7, 3))
    FigureCanvasSVG(figure)
    drawing.draw_curves(figure, points, EN, Letters())
    return list(figure.axes)


def test_the_curve_has_the_peak_of_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    RecordedInversion(monkeypatch)
    setup = replace(SETUP, geophone_natural_frequency=4.5, geophone_damping=0.56)
    drops = []
    for number in (1, 2, 3, 4):
        drop = half_sine_drop(number, 8000.0 + number)
        velocity = np.gradient(drop.channels[0].values, drop.time)
        drops.append(replace(drop, channels=(Channel(0.0, "velocity", velocity),)))
    write_traces(tmp_path / "A.csv", TracePoint("", setup, tuple(drops), ()))
    list(import_files([str(tmp_path / "A.csv")], tmp_path / "survey"))
    report = gather(tmp_path / "survey")
    titles, table = table_of(report)
    row = dict(zip(titles, table.rows[0], strict=True))
    (axes,) = drawn_curves(list(report.points))
    lines = [line for line in axes.lines if line.get_label().isdigit()]
    peaks = [float(line.get_ydata().max()) for line in lines]
    assert " / ".join(f"{peak:.3f}" for peak in peaks) == row[S]
    facts = report.points[0].facts[1:]
    np.testing.assert_allclose(peaks, [fact.peak_deflection * 1e3 for fact in facts], rtol=1e-12)
    blocks = compose(report, EN, Letters())
    stated = [block.caption for block in blocks if isinstance(block, Picture)]
    stated += [block.text for block in blocks if isinstance(block, Paragraph)]
    assert "declared response" in " ".join(stated)
    assert peaks[0] > 1.1 * 0.5  # the record with the response of the geophone has 0.5 mm
    for line in lines:
        bottom, top = axes.get_ylim()
        assert top < line.get_ydata().min() <= line.get_ydata().max() < bottom
        assert line.get_xdata()[-1] > line.get_xdata()[line.get_ydata().argmax()]


def deepened(point: PointView, times: float) -> PointView:
    """Return a point whose plate went down further."""
    drops = []
    for drop in point.drops:
        assert drop.deflection is not None
        deeper = replace(drop.deflection, deflection=times * drop.deflection.deflection)
        drops.append(replace(drop, deflection=deeper))
    return replace(point, drops=tuple(drops))


@pytest.mark.parametrize(("times", "out_of_scale"), [(2.4, set()), (2.6, {2})])
def test_a_much_deeper_point_has_a_separate_scale(
    survey: Path, times: float, out_of_scale: set[int]
) -> None:
    first, second = gather(survey).points
    points = [first, second, deepened(first, times)]
    assert drawing.points_out_of_scale(points) == out_of_scale
    axes = drawn_curves(points)
    assert axes[0].get_ylim() == axes[1].get_ylim()
    assert (axes[2].get_ylim() != axes[0].get_ylim()) == bool(out_of_scale)
    marked = ["own scale" in [text.get_text() for text in place.texts] for place in axes]
    assert marked == [False, False, bool(out_of_scale)]
    for place in axes:
        bottom, top = place.get_ylim()
        for line in place.lines:
            assert top <= min(line.get_ydata())
            assert max(line.get_ydata()) < bottom


def test_a_drop_without_traces_or_centre_has_no_deflection() -> None:
    drop = half_sine_drop(1, 8000.0)
    assert judged_deflection(drop, SETUP) is not None
    aside = replace(drop, channels=(replace(drop.channels[0], offset=0.3),))
    upwards = replace(drop, channels=(replace(drop.channels[0], values=-drop.channels[0].values),))
    flat = replace(drop, load=np.zeros_like(drop.load))
    assert [judged_deflection(drop, SETUP) for drop in (aside, upwards, flat)] == [None] * 3


def test_the_reason_of_each_verdict_is_on_the_first_page(survey: Path) -> None:
    assert not verdict_reasons(gather(survey), EN)
    report = gather(survey, ReportOptions(target=50e6))
    _, reasons = (b for b in certificate_blocks(report, EN, Letters()) if isinstance(b, Pairs))
    reason = EN.message(Notice("target-missed"))
    assert reasons.rows == (("✗ fail", f"{reason} (all 2 points)"),)
    (reasons,) = verdict_reasons(replace(report, points=report.points[:1]), EN)
    assert reasons == Pairs((("✗ fail", reason),))


@pytest.mark.parametrize(
    ("recorded", "zone", "expected"),
    [
        ({"time_local": "2026-07-01T14:05:09+02:00"}, None, "2026-07-01 14:05:09 UTC+02:00"),
        ({"time_utc": "2026-07-01T12:05:09+00:00"}, None, "2026-07-01 12:05:09 UTC"),
        ({"time_utc": "2026-07-01T12:05:09Z"}, "+02:00", "2026-07-01 14:05:09 UTC+02:00"),
        ({"time_local": "2026-07-01T14:05:09"}, "+02:00", "2026-07-01 14:05:09 UTC+02:00"),
        ({"time_local": "2026-07-01T14:05:09"}, None, "2026-07-01 14:05:09 zone not declared"),
        ({}, None, ""),
    ],
)
def test_times_are_local_and_name_their_zone(
    survey: Path, recorded: dict[str, str], zone: str | None, expected: str
) -> None:
    point = gather(survey).points[0]
    drops = tuple(replace(drop, metadata=recorded) for drop in point.drops)
    point = replace(point, drops=drops, job=replace(point.job, time_zone=zone))
    assert time_with_zone(point, EN) == expected


def test_curves_of_the_first_page_have_a_time_axis(survey: Path) -> None:
    points = gather(survey).points
    short_lot, long_lot = drawn_curves([*points] * 2), drawn_curves([*points] * 5)
    assert [axes.get_xlabel() for axes in short_lot] == ["time after the trigger, ms"] * 4
    assert [axes.get_xlabel() for axes in long_lot] == [""] * 4 + ["t, ms"] * 6
    for axes in long_lot:
        axes.figure.canvas.draw()
        labels = [label for label in axes.get_xticklabels() if label.get_text()]
        assert labels[1:]
        assert all(label.get_visible() for label in labels)


def test_a_chainage_has_a_column(survey: Path) -> None:
    edit_survey(survey, [Edit("declared", {"chainage_m": 8827.754})], point="A")
    report = gather(survey)
    first = replace(report.points[1], title="km 12+320")
    titles, table = table_of(replace(report, points=(report.points[0], first)))
    assert titles[:2] == ["Point", "Chainage, m"]
    assert [row[1] for row in table.rows] == ["8827.75", "12320"]
    assert 1 in table.right
