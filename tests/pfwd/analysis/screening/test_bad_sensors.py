"""A bad sensor is left out of every drop of its point and said once; files and exports keep it."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from inversion import InversionError, Record, Settings, SurrogateLibrary
from inversion.notices import Notice, Value
from pfwd.analysis import analyse
from pfwd.analysis.analyse import analyse_drop, analyse_point
from pfwd.analysis.diagnosis.entries import entry_of
from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.screening.bad_sensors import leave_out_bad_sensors
from pfwd.analysis.screening.drops import Screening, screen_point
from pfwd.files.header import PointSetup
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from pfwd_device import Channel, Drop

PLACES = (0.0, 0.3, -0.3, 0.6, -0.6)
QUICK = AnalysisOptions(method="posterior", bedrock_depth="none")

Make = Callable[..., Drop]


def loose(drop: Drop, place: float = -0.6) -> Drop:
    """The same drop, in which a sensor runs away by the plate's own peak."""
    away = 5e-4 * np.clip(drop.time / 0.02, 0.0, 1.0)
    channels = tuple(
        Channel(c.offset, c.quantity, away) if c.offset == place else c for c in drop.channels
    )
    return Drop(drop.number, drop.time, drop.load, channels)


@pytest.fixture
def point(make_drop: Make) -> TracePoint:
    """Three drops, in the second of which a sensor is loose."""
    first, second, third = (make_drop(number=n, peak=8000.0 + n, offsets=PLACES) for n in (1, 2, 3))
    return TracePoint("f", PointSetup(plate_radius=0.15), (first, loose(second), third))


def screened(point: TracePoint) -> tuple[Screening, ...]:
    return leave_out_bad_sensors(point, screen_point(point))


def faults(warnings: Iterable[Notice] | None) -> list[Value]:
    """Faults of each bad sensor."""
    return [each.values["faults"] for each in warnings or () if each.code == "sensor-bad"]


def test_a_sensor_that_is_bad_in_a_drop_is_omitted_from_all_drops_of_its_point(
    point: TracePoint,
) -> None:
    for screening in screened(point):
        assert screening.left_out == (-0.6,)
        assert len(faults(screening.warnings)) == 1
    sound = replace(point, drops=(point.drops[0], point.drops[2]))
    assert screened(sound) == screen_point(sound)


def test_each_fault_of_a_sensor_is_named_once(point: TracePoint) -> None:
    first, second, third = point.drops
    channels = [
        replace(c, values=3 * first.channels[0].values) if c.offset == -0.6 else c
        for c in third.channels
    ]
    large = replace(third, channels=tuple(channels))
    for screening in screened(replace(point, drops=(loose(first), second, large))):
        assert faults(screening.warnings) == [("drift", "against the others")]


def test_a_rejected_drop_judges_no_sensor(point: TracePoint) -> None:
    first, second, third = point.drops
    knock = Drop(2, second.time, 0.1 * second.load, second.channels)
    screenings = screened(replace(point, drops=(first, knock, third)))
    assert [each.status for each in screenings] == ["measured", "rejected", "measured"]
    assert all(each.left_out == () for each in screenings)
    noted = screened(replace(point, drops=(loose(first), knock, third)))
    assert noted[1] == screen_point(replace(point, drops=(first, knock, third)))[1]


def test_two_sensors_do_not_judge_themselves(make_drop: Make) -> None:
    drop = loose(make_drop(offsets=(0.0, -0.6)))
    point = TracePoint("f", PointSetup(plate_radius=0.15), (drop,))
    assert screened(point) == screen_point(point)


def test_an_inversion_goes_on_without_it(
    point: TracePoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    used: list[list[list[float]]] = []

    def noted(records: list[Record], *_: Settings | SurrogateLibrary) -> None:
        used.append([[sensor.offset for sensor in record.sensors] for record in records])
        raise InversionError("enough")

    monkeypatch.setattr(analyse, "invert_joint", noted)
    library = SurrogateLibrary()
    every = analyse_point(point, QUICK, library)
    assert used == [[[0.0, 0.3, -0.3, 0.6]]] * 3
    used.clear()
    analyse_point(point, replace(QUICK, joint=True), library)
    assert used == [[[0.0, 0.3, -0.3, 0.6]] * 3]
    used.clear()
    # As it comes from the instrument: what the drop itself tells.
    (judged,) = screen_point(replace(point, drops=point.drops[1:2]))
    alone = analyse_drop(point.drops[1], point.setup, judged, QUICK, library)
    assert used == [[[0.0, 0.3, -0.3, 0.6]]]
    for each in (*every, alone):
        assert len(faults(drop_result("f", each).warnings)) == 1


def test_a_diagnosis_goes_on_without_it(point: TracePoint) -> None:
    entry = entry_of("f", point, QUICK)
    for record in entry.records.records:
        assert [sensor.offset for sensor in record.sensors] == [0.0, 0.3, -0.3, 0.6]
    assert len(faults(entry.warnings)) == 1


# Real records


def jils(shared: Path, folder: Path) -> list[TracePoint]:
    inches = [0, 8, 12, 18, 24, 36, 48, 60, -12]
    header = folder / "h.toml"
    header.write_text(
        f"plate_radius_m = 0.15\nsensor_offsets_m = {[round(0.0254 * i, 4) for i in inches]}\n"
    )
    return read_points(shared / "originals/pywave/stations-1-5.THY", header)


def test_the_loose_sensors_of_a_trailer_are_detected(shared: Path, tmp_path: Path) -> None:
    screenings = [{each.left_out for each in screened(point)} for point in jils(shared, tmp_path)]
    distant = (0.9144, 1.2192, 1.524)
    assert screenings == [{(-0.3048, *distant)}, {(-0.3048, *distant)}, {distant}, {()}, {()}]
