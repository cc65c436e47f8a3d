"""Sensors on both sides of the plate: two sensors, kept apart from the file to every export."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from inversion.notices import text_of
from pfwd.analysis.drop_facts import point_drop, unbroken_peaks
from pfwd.analysis.screening.drops import screen
from pfwd.export.export import export_survey
from pfwd.files.importing import import_files
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from pfwd_device import Drop
from pfwd_device.signals import channels_outward
from tests.pfwd.files.trace_lines import HEADER

HEAVYDYN = [-0.3, -0.2, 0.0, 0.2, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8, 2.1]
"""m; where the database of the file puts its sensors."""
JILS = [0.0, 0.2032, 0.3048, 0.4572, 0.6096, 0.9144, 1.2192, 1.524, -0.3048]
"""m; 0, 8, 12, 18, 24, 36, 48, 60 and -12 in."""

Write = Callable[..., Path]


@pytest.fixture
def trace_file(write: Write, make_drop: Callable[..., Drop]) -> Path:
    """A trace file whose first column is on the other side, and no two columns alike."""
    drop = make_drop(offsets=(0.3, 0.0, 0.6), quantity="velocity")
    left = 1.1 * drop.channels[0].values
    columns = [left, *(channel.values for channel in drop.channels)]
    names = ",".join(f"velocity_m_s@{place}" for place in ("-0.3000", "0.3", "-0.0", "0.6"))
    rows = [
        ",".join(repr(float(number)) for number in row)
        for row in np.column_stack([drop.time, drop.load, *columns])
    ]
    return write([*HEADER, f"time_s,load_N,{names}", *rows])


def same(one: TracePoint, other: TracePoint) -> None:
    """Every sensor with its place and its numbers, in the same order."""
    assert len(one.drops) == len(other.drops)
    for mine, theirs in zip(one.drops, other.drops, strict=True):
        assert [c.offset for c in mine.channels] == [c.offset for c in theirs.channels]
        for left, right in zip(mine.channels, theirs.channels, strict=True):
            np.testing.assert_array_equal(left.values, right.values)


def round_trip(file: Path, folder: Path, header: Path | None = None) -> None:
    """Into a survey, out as trace files and as one file, and back."""
    points = read_points(file, header)
    survey = folder / "survey"
    for done in import_files([str(file)], survey, None if header is None else str(header)):
        assert done.error is None
    export_survey(survey, "csv", folder / "csv")
    export_survey(survey, "survey", folder / "s.pfwdz")
    for written in (read_points(survey), read_points(folder / "s.pfwdz")):
        for one, other in zip(points, written, strict=True):
            same(one, other)
    files = sorted((folder / "csv").iterdir())
    assert len(files) == len(points)
    by_name = {read_points(path)[0].setup.point: read_points(path)[0] for path in files}
    for one in points:
        same(one, by_name[one.setup.point] if len(points) > 1 else read_points(files[0])[0])


def test_a_negative_distance_is_a_sensor_of_its_own(trace_file: Path) -> None:
    (point,) = read_points(trace_file)
    (drop,) = point.drops
    assert [channel.offset for channel in drop.channels] == [-0.3, 0.3, 0.0, 0.6]
    # -0 is the centre: no sign is left on it.
    assert not np.signbit(drop.channels[2].offset)
    np.testing.assert_allclose(drop.channels[0].values, 1.1 * drop.channels[1].values)
    assert [channel.offset for channel in channels_outward(drop)] == [0.0, 0.3, -0.3, 0.6]


def test_what_is_of_the_centre_is_not_of_the_other_side(trace_file: Path) -> None:
    (point,) = read_points(trace_file)
    (drop,) = point.drops
    screening = screen(drop, point.setup)
    assert screening.status == "measured"
    peaks = unbroken_peaks(drop)
    assert peaks is not None
    assert peaks.centre == pytest.approx(5e-4, rel=0.01)
    facts = point_drop(drop, point.setup, screening)
    assert facts.peak_deflection == pytest.approx(5e-4, rel=0.01)
    without = Drop(1, drop.time, drop.load, drop.channels[:2])
    assert text_of(screen(without, point.setup).reason) == (
        "no centre channel: none of the sensors stands at offset 0"
    )


def test_both_sides_come_through_survey_and_exports(trace_file: Path, tmp_path: Path) -> None:
    round_trip(trace_file, tmp_path)
    export_survey(tmp_path / "survey", "pddx", tmp_path / "a.pdx")
    text = (tmp_path / "a.pdx").read_text(encoding="utf-8")
    assert "DeflectionSensorXAxisDistances = -300,300,0,600" in text
    assert "NumberOfDeflectionSensors = 4" in text


def test_a_heavydyn_keeps_its_eleven_sensors(shared: Path, tmp_path: Path) -> None:
    file = shared / "originals/mapview/heavydyn-5-points.prjz"
    points = read_points(file)
    assert len(points) == 5
    for point in points:
        assert len(point.drops) == 3
        assert all([c.offset for c in drop.channels] == HEAVYDYN for drop in point.drops)
        assert not any("left out" in text_of(text) for text in point.warnings)
    round_trip(file, tmp_path)


def test_a_jils_trailer_keeps_its_nine_sensors(shared: Path, tmp_path: Path) -> None:
    header = tmp_path / "h.toml"
    header.write_text(f"plate_radius_m = 0.15\nsensor_offsets_m = {JILS}\n")
    file = shared / "originals/pywave/stations-1-5.THY"
    points = read_points(file, header)
    assert len(points) == 5
    for point in points:
        assert all([c.offset for c in drop.channels] == JILS for drop in point.drops)
    round_trip(file, tmp_path, header)
