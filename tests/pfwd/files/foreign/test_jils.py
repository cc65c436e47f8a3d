"""JILS time histories: units, signs, stations; what is wrong with a file is said."""

from pathlib import Path

import numpy as np
import pytest

from inversion.notices import text_of
from pfwd.errors import SurveyError
from pfwd.files.reading import read_points
from tests.pfwd.files.foreign.builders import pulse, thy

DROPS = [
    (1, 1, pulse(samples=470, rate=1e3 / 0.1707, pre=0.0, peak=40e3, channels=3)),
    (1, 2, pulse(samples=470, rate=1e3 / 0.1707, pre=0.0, peak=50e3, channels=3)),
    (2, 1, pulse(samples=470, rate=1e3 / 0.1707, pre=0.0, peak=60e3, channels=3)),
]
HEADER = "plate_radius_m = 0.15\nsensor_offsets_m = [0.0, 0.3, nan]\n"


@pytest.fixture
def header(tmp_path: Path) -> Path:
    path = tmp_path / "h.toml"
    path.write_text(HEADER)
    return path


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "a.THY"
    path.write_bytes(thy(DROPS))
    return path


def test_units_and_signs_are_ours(file: Path, header: Path) -> None:
    first, second = read_points(file, header)
    assert (first.setup.point, second.setup.point) == ("station 1 lane 1", "station 2 lane 1")
    assert [drop.number for drop in first.drops] == [1, 2]
    for drop, (_, _, recorded) in zip([*first.drops, *second.drops], DROPS, strict=True):
        assert [channel.offset for channel in drop.channels] == [0.0, 0.3]
        np.testing.assert_allclose(drop.load, recorded.load, atol=0.01)
        for channel, values in zip(drop.channels, recorded.sensors, strict=False):
            assert channel.quantity == "displacement"
            assert channel.values.max() > 0
            np.testing.assert_allclose(channel.values, values, atol=2e-11)
        assert drop.time[0] == 0
        assert np.diff(drop.time) == pytest.approx(0.1707e-3, rel=1e-6)
    assert first.setup.temperature == 20.0
    assert (first.setup.site, first.setup.operator) == ("Test road", "A. B.")
    desired = first.setup.extra["imported"]["desired_peak_force_n"]
    assert desired == pytest.approx([40033.99, 40033.99], abs=0.01)


@pytest.mark.parametrize(
    ("declared", "offsets", "remark"),
    [
        ("sensor_offsets_m = [0.0, 0.3, -0.3]", [0.0, 0.3, -0.3], None),
        ("sensor_offsets_m = [0.0, 0.3, 0.3]", [0.0, 0.3], "a second sensor at 0.3 m is left out"),
        ("", [0.0], "sensors in the file: 9"),
    ],
)
def test_sensors_are_where_they_are_declared(
    tmp_path: Path, file: Path, declared: str, offsets: list[float], remark: str | None
) -> None:
    header = tmp_path / "h.toml"
    header.write_text(f"plate_radius_m = 0.15\n{declared}\n")
    first, _ = read_points(file, header)
    for drop, (_, _, recorded) in zip(first.drops, DROPS, strict=False):
        assert [channel.offset for channel in drop.channels] == offsets
        for channel, values in zip(drop.channels, recorded.sensors, strict=False):
            np.testing.assert_allclose(channel.values, values, atol=2e-11)
    sensors = [text for text in map(text_of, first.warnings) if "sensor" in text]
    assert len(sensors) == (remark is not None)
    assert all(remark is not None and remark in text for text in sensors)


def test_rounded_times_become_even(tmp_path: Path, header: Path) -> None:
    path = tmp_path / "a.thy"
    path.write_bytes(thy(DROPS, digits=2))
    first, _ = read_points(path, header)
    steps = np.diff(first.drops[0].time)
    assert steps.max() - steps.min() < 1e-12


def test_content_tells_it_under_any_name(tmp_path: Path, header: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(thy(DROPS))
    assert len(read_points(path, header)) == 2


def test_a_repeated_number_becomes_the_next_number(tmp_path: Path, header: Path) -> None:
    path = tmp_path / "a.thy"
    path.write_bytes(thy([DROPS[0], DROPS[0]]))
    (point,) = read_points(path, header)
    assert [drop.number for drop in point.drops] == [1, 2]


GOOD = thy(DROPS)
WRONG = [
    (b"", HEADER, "drops with Impact: and rows of numbers, got none"),
    (b"\x00\x01" * 50, HEADER, "a line of text, got binary data"),
    (GOOD[: len(GOOD) // 2], HEADER, "got the end of the file after|expected 5 numbers"),
    (GOOD.replace(b"Time Force", b"Zeit Kraft"), HEADER, "a line Time Force Disp1"),
    (GOOD.replace(b"samples: 470", b"samples: 469", 1), HEADER, "number of rows that Number_of"),
    (GOOD.replace(b"samples: 470", b"samples: 471", 1), HEADER, "expected 5 numbers, got ''"),
    (GOOD.replace(b"0.1707 ", b"x.1707 ", 1), HEADER, "line 14: expected 5 numbers"),
    (GOOD.replace(b"0.1707 ", b"0.3000 ", 1), HEADER, "even, growing time steps"),
    (GOOD, "site = 'x'", "a header key plate_radius_m, got none"),
    (GOOD, "plate_radius_m = 0.1\nsensor_offsets_m = [0.0]", "3 distances in m"),
    (GOOD, "plate_radius_m = 0.1\nsensor_offsets_m = 'x'", "3 distances in m"),
]


@pytest.mark.parametrize(("data", "header", "message"), WRONG)
def test_a_wrong_history_is_an_error_line_with_the_file(
    tmp_path: Path, data: bytes, header: str, message: str
) -> None:
    path, keys = tmp_path / "a.thy", tmp_path / "h.toml"
    path.write_bytes(data)
    keys.write_text(header)
    with pytest.raises(SurveyError, match=message) as caught:
        read_points(path, keys)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def dat(station: int, drops: list[tuple[float, list[float]]], note: str = "retest") -> str:
    """Return the lines of a station in a .DAT; loads in N, deflections in m."""
    lines = [
        f"{station} 1   0.000 1 {load / 4448.2216152605:.2f} "
        f"{' '.join(f'{peak / 2.54e-5:.2f}' for peak in moved)}  68.0"
        for load, moved in drops
    ]
    lines += [
        "Drop Sequence Completed Time: 08:36    Air Temp (F): 71.6",
        "GPS: Quality : DGPS Fix   Latitude = 34 deg30.000000  N   Longitude = 89 deg15.000000   W"
        "   PDOP = 1.50",
        f"Note: {note}",
    ]
    return "\n".join(lines) + "\n"


HEAD = (
    "M5\nDate-Time:  5/13/2019  8:35:57\nSensors: 1, 2, 3\nWeight/spring: 3\n"
    "Location: Test road\nTemp:   68.00\nOperator: A. B.\nComments: \n"
)


def of_drops(station: int) -> list[tuple[float, list[float]]]:
    return [
        (float(recorded.load.max()), [float(row.max()) for row in recorded.sensors])
        for number, _, recorded in DROPS
        if number == station
    ]


def test_peaks_alone_are_read_as_peaks(tmp_path: Path, header: Path) -> None:
    path = tmp_path / "a.DAT"
    path.write_text(HEAD + dat(1, of_drops(1)) + dat(2, of_drops(2)))
    first, second = read_points(path, header)
    assert (first.setup.point, second.setup.point) == ("station 1 lane 1", "station 2 lane 1")
    assert (first.setup.latitude, first.setup.longitude) == (34.5, -89.25)
    noted = first.setup.extra["imported"]
    assert (noted["note"], noted["position_dop"]) == ("retest", 1.5)
    assert (noted["surface_temperature_c"], noted["air_temperature_c"]) == (20.0, 22.0)
    for drop, (load, moved) in zip(first.drops, of_drops(1), strict=True):
        assert drop.only_peaks is not None
        assert drop.only_peaks.load == pytest.approx(load, abs=23)
        assert dict(drop.only_peaks.displacements) == pytest.approx(
            {0.0: moved[0], 0.3: moved[1]}, abs=1.3e-7
        )


def test_peaks_with_histories_are_compared(tmp_path: Path, file: Path, header: Path) -> None:
    good, second_peaks = of_drops(1), of_drops(2)
    (load, moved), wrong = second_peaks[0], [of_drops(2)[0][1][0], 9e-4, 0.0]
    (tmp_path / "a.DAT").write_text(HEAD + dat(1, good) + dat(2, [(load, wrong)], "again"))
    first, second = read_points(file, header)
    assert (second.setup.latitude, second.setup.longitude) == (34.5, -89.25)
    assert second.setup.extra["imported"]["note"] == "again"
    assert not any(".DAT" in text_of(text) for text in first.warnings)
    differing = [text for text in second.warnings if "a.DAT" in text_of(text)]
    assert [text_of(text).split(" is ")[0] for text in differing] == [
        "a.DAT, line 14: peak of sensor 2",
        "a.DAT, line 14: peak of sensor 3",
    ]
    (tmp_path / "a.DAT").write_text(HEAD + dat(1, good[:1]) + dat(2, [(1.1 * load, moved)]))
    first, second = read_points(file, header)
    assert any("1 drops of this station, 2 in the .THY" in text_of(text) for text in first.warnings)
    assert any("line 13: load" in text_of(text) for text in second.warnings)
    # A damaged one keeps nobody from the histories.
    (tmp_path / "a.DAT").write_text(HEAD + "1 1   0.000 1 x 5.83 71.3\n")
    first, _ = read_points(file, header)
    assert any(
        text_of(text).startswith("a.DAT: not read: line 9: expected") for text in first.warnings
    )


def test_damaged_peaks_are_an_error_line(tmp_path: Path, header: Path) -> None:
    path = tmp_path / "a.DAT"
    for text, message in (
        (HEAD, "lines with load and deflections, got none; is it a JILS .DAT"),
        (HEAD + "1 1   0.000 1 10.05 71.3\n", "line 9: expected a load and deflections"),
        (
            HEAD + dat(1, of_drops(1)) + "2 1   0.000 1 10.05 5.83 4.91 4.68 9.9 71.3\n",
            "one number",
        ),
    ):
        path.write_text(text)
        with pytest.raises(SurveyError, match=message):
            read_points(path, header)
