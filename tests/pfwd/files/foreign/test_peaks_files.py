"""Files with peaks and no time history: F25, Dynatest and Sweco .fwd, PDDX, projects."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from inversion.notices import text_of
from pfwd.errors import TraceError
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from tests.pfwd.files.foreign.builders import acquired, prjz, pulse, viewed, zipped
from tests.pfwd.files.foreign.peaks_builders import (
    OFFSETS,
    dynatest,
    f25,
    newtons,
    pddx,
    places,
    sweco,
)
from tests.records import known

Reader = Callable[..., list[TracePoint]]

ALL: dict[str, str] = {
    "a.F25": f25(places()),
    "a-sweco.fwd": sweco(places()),
    "a-dynatest.fwd": dynatest(places()),
    "a.pdx": pddx(places()),
}


def numbers(points: list[TracePoint]) -> list[tuple[float, dict[float, float]]]:
    """Load and deflection by offset of every drop."""
    peaks = [known(drop.only_peaks) for point in points for drop in point.drops]
    return [(drop.load, dict(drop.displacements)) for drop in peaks]


def remarks(point: TracePoint) -> str:
    return "\n".join(map(text_of, point.warnings))


def noted(point: TracePoint) -> dict[str, Any]:
    return dict(point.setup.extra["imported"])


@pytest.mark.parametrize("name", ALL)
def test_every_layout_gives_the_numbers_it_was_written_with(read: Reader, name: str) -> None:
    points = read(ALL[name], name)
    assert len(points) == 2
    expected = [drop for place in places() for drop in place.drops]
    for (load, moved), (pressure, peaks) in zip(numbers(points), expected, strict=True):
        # F25 has whole kPa, Sweco 0.1 kN.
        assert load == pytest.approx(newtons(pressure), abs=52 if name != "a.pdx" else 0.01)
        if name in ("a.F25", "a-sweco.fwd", "a.pdx"):
            assert list(moved) == pytest.approx(list(OFFSETS))
        else:  # the head has seven of them
            assert list(moved) == pytest.approx(list(OFFSETS[2:9]))
        for offset, peak in zip(OFFSETS, peaks, strict=True):
            if offset in moved and offset != -0.2:
                assert moved[offset] == pytest.approx(1e-6 * peak, abs=0.051e-6)
    first = points[0]
    assert first.setup.plate_radius == 0.15
    assert (first.setup.latitude, first.setup.longitude) == pytest.approx((48.5, 2.25), abs=1e-7)
    assert noted(first)["air_temperature_c"] == pytest.approx(8.6)
    assert noted(first)["surface_temperature_c"] == pytest.approx(3.0)
    assert "peaks as another program recorded them" in remarks(first)
    if name != "a-dynatest.fwd":
        assert noted(first)["time_local"].startswith("2024-05-06T07:30")
    assert noted(points[1]).get("chainage_m", 20.0) == 20.0


def test_zero_deflections_are_written_as_a_tenth(read: Reader) -> None:
    values = numbers(
        read(ALL["a-dynatest.fwd"], "a-dynatest.fwd", "sensor_offsets_m = " + str(list(OFFSETS)))
    )
    assert [moved[-0.2] for _, moved in values] == pytest.approx(
        [8e-8, 1e-7, 1e-7, 8e-8, 1e-7, 8e-8]
    )
    assert list(values[0][1]) == pytest.approx(list(OFFSETS))


def test_assumptions_about_a_dynatest_file_are_remarks(read: Reader) -> None:
    (first, _) = read(ALL["a-dynatest.fwd"], "a.fwd")
    assert "line 3: the plate radius is 0, 0.15 m was assumed" in remarks(first)
    assert "7 sensor positions, but 11 deflections" in remarks(first)
    (first, _) = read(dynatest(places(), radius=0.225), "a.fwd")
    assert first.setup.plate_radius == 0.225
    assert "assumed" not in remarks(first)
    (first, _) = read(ALL["a-dynatest.fwd"], "a.fwd", "plate_radius_m = 0.3")
    assert first.setup.plate_radius == 0.3
    assert numbers([first])[0][0] == pytest.approx(4 * newtons(992.67))


def test_columns_of_a_dynatest_file_are_not_guessed(read: Reader) -> None:
    """The positions are unknown if the largest deflection is not always in the same column."""
    values = places()
    for number, (_, moved) in enumerate(drop for place in values for drop in place.drops):
        moved[number % 4] = 999.0  # type: ignore[index]
    with pytest.raises(TraceError, match=r"got 11; declare sensor_offsets_m") as caught:
        read(dynatest(values), "a.fwd")
    assert "/a.fwd, line 3: expected 7 deflections" in str(caught.value).replace("\\", "/")


def test_the_pddx_of_the_viewer_is_detected(read: Reader) -> None:
    (first, _) = read(ALL["a.pdx"], "a.pdx")
    assert "a.pdx, line 19: LoadPlateRadius 0.3 is the diameter in m" in remarks(first)
    sound = read(pddx(places(), viewer=False), "a.pdx")
    assert [point.setup.point for point in sound] == ["km 1", "km 1 (2)"]
    assert sound[0].setup.plate_radius == 0.15
    assert "diameter" not in remarks(sound[0])
    for (load, moved), (pressed, peaks) in zip(numbers(sound), numbers([first]), strict=False):
        assert load == pytest.approx(pressed, rel=1e-3)
        assert moved == pytest.approx(peaks)
    assert noted(sound[1])["chainage_m"] == pytest.approx(20.0)


def test_units_of_a_pddx(read: Reader) -> None:
    text = pddx(places(), viewer=False)
    text = text.replace("LoadUnits = kilo-Newton", "LoadUnits = kip")
    text = text.replace("DeflectionUnits = micron", "DeflectionUnits = mils")
    text = text.replace("TemperatureUnits = Celsius", "TemperatureUnits = Fahrenheit")
    (first, _) = read(text, "a.pdx")
    (sound, _) = read(pddx(places(), viewer=False), "b.pdx")
    assert numbers([first])[0][0] == pytest.approx(4.4482216152605 * numbers([sound])[0][0])
    assert numbers([first])[0][1][0.0] == pytest.approx(25.4 * numbers([sound])[0][1][0.0])
    assert noted(first)["air_temperature_c"] == pytest.approx((8.6 - 32) / 1.8)


def basin_row(number: int, count: int, centre: str = " 400.0") -> str:
    """A drop of an F25: a pressure of 700 kPa and deflections that fall from the plate outward."""
    falling = "".join(f",{100 - 10 * sensor:6.1f}" for sensor in range(1, count))
    return f"{number:4d},   700,{centre}{falling}"


def f25_of(*rows: str, positions: str = "0,   300,   600") -> str:
    """An F25 of one station with lines of our own after its heading; drops are lines 5 and on."""
    heading = [
        '5001,25.60,1,40, 3, 1,"Prog    "',
        '5002,"25SI  ","8002-000","CP15-000"',
        f"5020,   150,{positions},N0    ,N0    ",
        "5301,0,1,3,3,  12.000,1,1,NA      ,2024,05,06,07,30",
    ]
    return "\r\n".join([*heading, *rows]) + "\r\n"


FIRST, CUT_OFF = basin_row(1, 3), basin_row(2, 3)[:-9]
SHIFTED = basin_row(2, 3).replace("700,", "700,  49.5,")
SOUND = {0.0: 400e-6, 0.3: 90e-6, 0.6: 80e-6}
SHORT, LONG = {0.0: 400e-6, 0.3: 90e-6}, {0.0: 1607e-6, 0.3: 90e-6, 0.6: 80e-6}


COUNT = "deflections, 3 positions in line 5020"
NOT_LARGEST = f"4 {COUNT}, and the largest deflection is not"
THOUSANDS = "numbers with a comma between the thousands"


@pytest.mark.parametrize(
    ("rows", "deflections", "remark"),
    [
        ([FIRST, basin_row(2, 4), basin_row(3, 4)], [SOUND] * 3, f"4 {COUNT}: deflection 4 was"),
        ([FIRST, basin_row(2, 2), basin_row(3, 2)], [SOUND, SHORT, SHORT], f"2 {COUNT}"),
        # The last number may have lost digits.
        ([FIRST, CUT_OFF], [SOUND], "the file is cut off within this drop"),
        ([FIRST, SHIFTED], [SOUND], NOT_LARGEST),
        # Four fields of three numbers: the deflection at the plate is 1607 um, not 1 um.
        ([FIRST, basin_row(2, 3, "1,607.0")], [SOUND, LONG], THOUSANDS),
        ([basin_row(1, 3, " 1,607"), basin_row(2, 3)], [LONG, SOUND], None),
    ],
)
def test_columns_of_an_f25_that_do_not_fit_its_positions(
    read: Reader, rows: list[str], deflections: list[dict[float, float]], remark: str | None
) -> None:
    (point,) = read(f25_of(*rows), "a.f25")
    assert [moved for _, moved in numbers([point])] == [pytest.approx(d) for d in deflections]
    if remark is not None:
        assert f"a.f25, line 6: {remark}" in remarks(point)


def test_an_f25_of_which_no_drop_can_be_read_is_refused(read: Reader) -> None:
    with pytest.raises(TraceError, match="drops with a load and deflections, got none"):
        read(f25_of(SHIFTED), "b.f25")


def test_a_position_of_an_f25_may_be_missing(read: Reader) -> None:
    (point,) = read(f25_of(FIRST, positions="0,N0    ,   600"), "a.f25")
    assert numbers([point])[0][1] == pytest.approx({0.0: 400e-6, 0.6: 80e-6})
    assert "deflection 2 was left out" in remarks(point)


STATION = "5301,0,1,3,3,  13.000,1,1,NA      ,2024,05,06,07,40"


def test_sensors_of_an_f25_that_change_within_the_file(read: Reader) -> None:
    """A deflection belongs to the positions of the last line 5020 before it."""
    positions = "5020,   150,   300,     0,   900,  1200,N0    ,N0    "
    row = "   1,   700,  90.0, 400.0,  50.0,  30.0"
    first, second = read(f25_of(basin_row(1, 3), positions, STATION, row), "a.f25")
    assert numbers([first])[0][1] == pytest.approx(SOUND)
    expected = {0.0: 400e-6, 0.3: 90e-6, 0.9: 50e-6, 1.2: 30e-6}
    assert numbers([second])[0][1] == pytest.approx(expected)
    assert "line 5020" not in remarks(first) + remarks(second)


def test_the_plate_of_an_f25_may_change_between_stations(read: Reader) -> None:
    plate = "5020,   225,     0,   300,   600,N0    ,N0    "
    first, second = read(f25_of(basin_row(1, 3), plate, STATION, basin_row(1, 3)), "a.f25")
    assert (first.setup.plate_radius, second.setup.plate_radius) == (0.15, 0.225)
    loads = [load for load, _ in numbers([first, second])]
    assert loads[1] == pytest.approx(2.25 * loads[0])
    assert "radius 0.15 or 0.225 m" in remarks(first)
    with pytest.raises(TraceError, match="line 7: expected one plate at a station, of radius 150"):
        read(f25_of(basin_row(1, 3), plate, basin_row(2, 3)), "b.f25")


def test_a_sensor_without_data_is_excluded(read: Reader) -> None:
    (first, _) = read(f25(places(), empty=(1,)), "a.f25")
    assert -0.2 not in numbers([first])[0][1]
    assert len(numbers([first])[0][1]) == 10


OFF = [-0.3, 0.0, 0.6]


def peaks_of_project(database: dict[str, Any]) -> bytes:
    return zipped({"database.json": json.dumps(database).encode()})


def with_deflections() -> dict[str, Any]:
    database = acquired({"1F": [pulse()]}, offsets=OFF)
    (point,) = database["PVs"][0]["Points"]
    point["Drops"] = [
        {"Number": 1, "PulseTime": 0.025, "Load": 60e3, "Deflections": [2e-4, 7e-4, 1e-4]},
        {"Number": 2, "PulseTime": 0.025, "Load": "NaN", "Deflections": [2e-4, 7e-4, 1e-4]},
        {"Number": 3, "PulseTime": 0.025, "Load": 61e3, "Deflections": [3e-4, 8e-4, 1e-4]},
    ]
    del database["ParamsAcqu"]  # peaks have no rate
    database["ParamsAcqu"] = {}
    return database


def test_a_project_without_traces_has_peaks(tmp_path: Path) -> None:
    path = tmp_path / "a.prjz"
    path.write_bytes(peaks_of_project(with_deflections()))
    (point,) = read_points(path)
    assert (point.setup.point, point.setup.plate_radius) == ("north 1", 0.15)
    assert [drop.number for drop in point.drops] == [1, 3]
    assert numbers([point])[1] == (61e3, {-0.3: 3e-4, 0.0: 8e-4, 0.6: 1e-4})
    assert point.setup.source == "Rincent project (.prjz), peaks"
    assert noted(point)["pulse_durations_s"] == [0.025] * 3
    assert "drop 2: no peaks, left out" in remarks(point)
    assert "processed and stored" not in remarks(point)


def test_a_viewers_project_names_its_sensors(tmp_path: Path) -> None:
    database = viewed({"1F": [pulse()]})
    report = database["project"]["base"]["reports"]["list"][0]["base"]
    (point,) = report["zones"][0]["base"]["points"]
    values = {"PulseTime": 0.02, "Load": 5e4, "D-300": 1e-4, "D0": 5e-4, "D1200": 3e-5}
    data = [{"label": key, "value": value} for key, value in values.items()]
    # As the viewer corrects it; what was measured stands before.
    data.append({"label": "D0", "value": 9e-4})
    point["base"]["drops"] = [{"base": {"data": data}}]
    path = tmp_path / "a.mpvz"
    path.write_bytes(peaks_of_project(database))
    (imported,) = read_points(path)
    assert numbers([imported]) == [(5e4, {-0.3: 1e-4, 0.0: 5e-4, 1.2: 3e-5})]


def test_a_point_without_traces_has_its_peaks(tmp_path: Path) -> None:
    drops = {"1F": [pulse(peak=80e3)], "2F": [pulse(peak=81e3)]}
    database = acquired(drops)
    for entry in database["PVs"][0]["Points"]:
        entry["Drops"] = [{"Fmax": 80e3, "Umax": 1e-3}]
    path = tmp_path / "a.prjz"
    path.write_bytes(prjz({"1F": drops["1F"]}, database))
    first, second = read_points(path)
    assert first.drops[0].only_peaks is None
    assert numbers([second]) == [(80e3, {0.0: 1e-3})]


def test_an_unknown_line_is_a_remark(read: Reader) -> None:
    lines = ALL["a.F25"].split("\r\n")
    lines.insert(12, "EOJ")
    (first, second) = read("\r\n".join(lines) + "\x1a", "a.f25")
    assert "a.f25, line 13: not read, because it does not begin" in remarks(first)
    assert len(first.drops) == len(second.drops) == 3


def test_points_with_the_same_number_stay_separate(read: Reader) -> None:
    text = pddx(places()).replace("[Test Location 1]", "[Test Location 0]")
    points = read(text, "a.pdx")
    assert [point.setup.point for point in points] == ["location 0", "location 0 (2)"]
    assert [len(point.drops) for point in points] == [3, 3]
