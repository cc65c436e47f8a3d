"""Delimited text by a column map."""

from pathlib import Path

import numpy as np
import pytest

from pfwd.errors import SurveyError, TraceError
from pfwd.files.foreign.column_map import read_map
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from tests.pfwd.files.foreign.builders import SIMPLE_MAP, Traces, Values, delimited, pulse
from tests.pfwd.files.trace_lines import HEADER, NAMES, rows

TOP = Path(__file__).resolve().parents[4]
EXAMPLE = TOP / "examples" / "column-map.toml"
DROPS = [pulse(rate=1e4, pre=0.02, peak=8000.0 + n, channels=2, samples=400) for n in (1, 2)]


def german(drops: list[Traces], rate: float = 1e4) -> bytes:
    """The text that the example is for."""
    lines = ["Site: Nürnberg", "Drop;t [ms];F [kN];s0 [mm];s1 [mm]"]
    for number, recorded in enumerate(drops, start=1):
        for row in range(recorded.load.size):
            numbers = [
                1e3 * row / rate,
                recorded.load[row] / 1e3,
                *(1e3 * recorded.sensors[:, row]),
            ]
            lines.append(";".join([str(number), *(f"{n:.7f}".replace(".", ",") for n in numbers)]))
    return "\r\n".join(lines).encode("cp1252")


def test_the_example_reads_its_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(german(DROPS))
    (point,) = read_points(path, column_map=EXAMPLE)
    setup = point.setup
    assert (setup.plate_radius, setup.plate_mass, setup.seating_drops) == (0.15, 12.5, 1)
    assert [drop.number for drop in point.drops] == [1, 2]
    for drop, recorded in zip(point.drops, DROPS, strict=True):
        assert [(c.offset, c.quantity) for c in drop.channels] == [
            (0.0, "displacement"),
            (0.3, "displacement"),
        ]
        np.testing.assert_allclose(drop.load, recorded.load, atol=1e-3)
        for channel, values in zip(drop.channels, recorded.sensors, strict=True):
            np.testing.assert_allclose(channel.values, values, atol=1e-10)
        assert drop.time[200] == pytest.approx(0.0, abs=1e-12)


def test_a_map_may_put_a_sensor_behind_the_plate(tmp_path: Path) -> None:
    path, column_map = tmp_path / "a.txt", tmp_path / "m.toml"
    path.write_bytes(german(DROPS))
    text = EXAMPLE.read_text(encoding="utf-8")
    assert text.count("offset_m = 0.3\n") == 1
    column_map.write_text(text.replace("offset_m = 0.3\n", "offset_m = -0.3\n"), encoding="utf-8")
    (point,) = read_points(path, column_map=column_map)
    assert [channel.offset for channel in point.drops[0].channels] == [0.0, -0.3]


def test_a_map_does_not_concern_a_trace_file(tmp_path: Path) -> None:
    (tmp_path / "b.csv").write_text("\n".join([*HEADER, NAMES, *rows()]))
    (point,) = read_points(tmp_path / "b.csv", column_map=EXAMPLE)
    assert len(point.drops) == 1


SINGLE = pulse(rate=1e4)
TIMES = np.arange(300) / 1e4


def read(folder: Path, map_text: str, *columns: Values, separator: str = ",") -> TracePoint:
    (folder / "m.toml").write_text(map_text)
    (folder / "a.csv").write_text(delimited(*columns, separator=separator))
    (point,) = read_points(folder / "a.csv", column_map=folder / "m.toml")
    return point


@pytest.mark.parametrize(
    ("unit", "factor"), [("kip", 4448.2216152605), ("lbf", 4.4482216152605), ("kgf", 9.80665)]
)
def test_units_of_force(tmp_path: Path, unit: str, factor: float) -> None:
    changed = SIMPLE_MAP.replace('"N"', f'"{unit}"')
    point = read(tmp_path, changed, TIMES, SINGLE.load / factor, SINGLE.sensors[0])
    np.testing.assert_allclose(point.drops[0].load, SINGLE.load, rtol=1e-12)


def test_a_map_with_a_wrong_unit_is_rejected(tmp_path: Path) -> None:
    changed = SIMPLE_MAP.replace('unit = "N"', 'unit = "kN"')
    message = r"a\.csv: expected a peak load of at most 500 kN, got .*units .* in .*m\.toml"
    with pytest.raises(TraceError, match=message):
        read(tmp_path, changed, TIMES, SINGLE.load, SINGLE.sensors[0])


def test_upward_channels_are_turned(tmp_path: Path) -> None:
    turned = SIMPLE_MAP.replace('unit = "m"', 'unit = "mil"\npositive = "up"')
    point = read(tmp_path, turned, TIMES, SINGLE.load, -SINGLE.sensors[0] / 2.54e-5)
    np.testing.assert_allclose(point.drops[0].channels[0].values, SINGLE.sensors[0], atol=1e-18)


def test_a_rate_stands_in_for_a_column_of_times(tmp_path: Path) -> None:
    text = SIMPLE_MAP.replace('column = 1\nunit = "s"', "sampling_rate_hz = 1e4\ntrigger_s = 0.005")
    text = text.replace("names = false", 'names = false\ndelimiter = "blank"')
    point = read(tmp_path, text, 0 * TIMES, SINGLE.load, SINGLE.sensors[0], separator="   ")
    assert point.drops[0].time[0] == pytest.approx(-0.005)
    assert point.drops[0].sampling_rate == pytest.approx(1e4)


def test_times_that_were_printed_with_three_digits_are_even(tmp_path: Path) -> None:
    recorded = pulse(rate=15e3)
    times = np.round(1e3 * np.arange(300) / 15e3, 3)
    changed = SIMPLE_MAP.replace('unit = "s"', 'unit = "ms"')
    point = read(tmp_path, changed, times, recorded.load, recorded.sensors[0])
    assert point.drops[0].sampling_rate == pytest.approx(15e3, rel=1e-4)


WRONG_MAPS = [
    (SIMPLE_MAP, "", "time: expected a table"),
    (SIMPLE_MAP, "= 1", "expected TOML"),
    ("column = 1", "column = 0", "a position from 1, got 0"),
    ('"N"', '"stone"', 'load.unit: expected "N" or'),
    ('unit = "N"', "", "load: expected either unit"),
    ("column = 3", "column = 2", "every column once"),
    ("column = 3", 'column = "v"', "positions from 1, as the file has no names"),
    ("offset_m = 0.0", "", "offset_m: expected a finite number, in m, got none"),
    ("names = false", 'encoding = "hex"', "an encoding such as utf-8"),
    ("names = false", 'decimal = ","', "another sign than the delimiter"),
    ('unit = "s"', 'unit = "s"\nsampling_rate_hz = 1.0', "either column or"),
    ('unit = "s"', "factor = 0", "a number other than 0"),
]


@pytest.mark.parametrize(("old", "new", "message"), WRONG_MAPS)
def test_a_wrong_map_is_refused_with_its_key(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = tmp_path / "m.toml"
    path.write_text(SIMPLE_MAP.replace(old, new))
    with pytest.raises(TraceError, match=message) as caught:
        read_map(path)
    assert "\n" not in str(caught.value)


def test_a_missing_column_lists_the_columns_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(german(DROPS).replace(b"F [kN]", b"Kraft"))
    with pytest.raises(SurveyError, match=r"one column named 'F \[kN\]', got columns 'Drop'"):
        read_points(path, column_map=EXAMPLE)
