"""Trace files: what is read, what is written, and how each kind of broken file is refused."""

import dataclasses
import os
import string
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pfwd_device import Channel, Drop
from pfwd_survey.errors import SurveyError, TraceError
from pfwd_survey.files.header import KEYS, Setup
from pfwd_survey.files.traces import TracePoint, read_traces, write_traces

HEADER = ["# pfwd-traces = 1", "# plate_radius_m = 0.15"]
NAMES = "drop,time_s,load_N,displacement_m@0.0000"


def rows(drop: int = 1, count: int = 20, step: float = 0.001) -> list[str]:
    return [f"{drop},{index * step:.6f},{100 * index},1e-6" for index in range(count)]


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Writes lines as a trace file; bytes as they are."""

    def write_file(lines: list[str] | bytes, name: str = "point.csv") -> Path:
        path = tmp_path / name
        data = lines if isinstance(lines, bytes) else ("\n".join(lines) + "\n").encode()
        path.write_bytes(data)
        return path

    return write_file


Write = Callable[..., Path]


def test_a_file_is_read_as_it_was_declared(write: Write) -> None:
    header = [
        *HEADER,
        "# poisson_ratio = 0.3",
        "# bedrock_depth_m = inf",
        '# centre_sensor = "ground"',
        "# geophone_natural_frequency_hz = 4.5",
        "# geophone_damping = 0.7",
        "# seating_drops = 1",
        '# device = "SN 1042"',
        "# time_utc = 2026-05-01T10:00:00Z",
        "#",
        "# colour = 'red'",
    ]
    names = "drop,time_s,load_N,velocity_m_s@0.0000,displacement_m@0.3"
    numbers = [f"{drop},{i / 1000},{i},{i + 0.5},{-i}" for drop in (1, 3) for i in range(-5, 15)]
    point = read_traces(write([*header, names, *numbers]))
    assert point.setup == Setup(
        plate_radius=0.15,
        poisson_ratio=0.3,
        bedrock_depth=float("inf"),
        centre_sensor="ground",
        geophone_natural_frequency=4.5,
        geophone_damping=0.7,
        seating_drops=1,
        device="SN 1042",
        time_utc="2026-05-01T10:00:00+00:00",
        extra={"colour": "red"},
    )
    assert [drop.number for drop in point.drops] == [1, 3]
    second = point.drops[1]
    np.testing.assert_allclose(second.time, np.arange(-5, 15) / 1000)
    np.testing.assert_array_equal(second.load, np.arange(-5, 15))
    assert [(c.quantity, c.offset) for c in second.channels] == [
        ("velocity", 0.0),
        ("displacement", 0.3),
    ]
    np.testing.assert_array_equal(second.channels[0].values, np.arange(-5, 15) + 0.5)
    assert second.sampling_rate == pytest.approx(1000.0)


def test_what_is_not_declared_is_unknown(write: Write) -> None:
    setup = read_traces(write([*HEADER, NAMES, *rows()])).setup
    assert setup == Setup(plate_radius=0.15)
    assert setup.plate_mass is None
    assert setup.bedrock_depth is None


def test_a_point_carries_its_warnings(write: Write) -> None:
    header = [*HEADER, "# plate_radius = 0.15"]
    warnings = read_traces(write([*header, NAMES, *rows()])).warnings
    assert warnings == (
        "plate_mass_kg is not declared: taken as 0",
        "header key 'plate_radius' is not known to the format: kept, not used",
    )


def test_a_radius_in_millimetres_is_suspect(write: Write) -> None:
    lines = ["# pfwd-traces = 1", "# plate_radius_m = 150", "# plate_mass_kg = 5", NAMES, *rows()]
    assert read_traces(write(lines)).warnings == (
        "units suspect: plate_radius_m = 150 (in metres?)",
    )


def test_without_a_drop_column_the_file_is_drop_1(write: Write) -> None:
    numbers = [row.split(",", 1)[1] for row in rows()]
    point = read_traces(write([*HEADER, NAMES.removeprefix("drop,"), *numbers]))
    assert [drop.number for drop in point.drops] == [1]


def test_columns_may_come_in_any_order(write: Write) -> None:
    names = "displacement_m@0.0000,load_N,drop,time_s"
    numbers = [",".join(reversed(row.split(","))) for row in rows()]
    swapped = [",".join((a, b, d, c)) for a, b, c, d in (n.split(",") for n in numbers)]
    drop = read_traces(write([*HEADER, names, *swapped])).drops[0]
    assert drop.load[3] == 300.0
    assert drop.time[3] == pytest.approx(0.003)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_any_line_end_and_a_byte_order_mark_are_accepted(
    write: Write, end: str, mark: bytes
) -> None:
    text = end.join([*HEADER, NAMES, *rows(), ""])
    assert read_traces(write(mark + text.encode())).drops[0].time.size == 20


def test_blank_lines_are_passed_over_and_the_last_needs_no_end(write: Write) -> None:
    text = "\n".join([*HEADER, "", NAMES, "", *rows(), "", *rows(2)])
    assert len(read_traces(write(text.encode())).drops) == 2


def test_a_file_without_sensors_is_left_to_the_screening(write: Write) -> None:
    numbers = [row.rsplit(",", 1)[0] for row in rows()]
    point = read_traces(write([*HEADER, "drop,time_s,load_N", *numbers]))
    assert point.drops[0].channels == ()


# A header from elsewhere


def test_a_header_file_stands_in_for_the_header(write: Write) -> None:
    header = write(["plate_radius_m = 0.1", "seating_drops = 3"], "setup.toml")
    foreign = write(["# Recorder 3, exported 1.5.2026", "# plate_radius_m = 9", NAMES, *rows()])
    setup = read_traces(foreign, header).setup
    assert setup == Setup(plate_radius=0.1, seating_drops=3)


def test_option_wins_over_header_file_wins_over_header(write: Write) -> None:
    header = write(["plate_radius_m = 0.1", "poisson_ratio = 0.1"], "setup.toml")
    lines = ["# pfwd-traces = 1", "# plate_radius_m = 0.2", "# poisson_ratio = 0.2"]
    lines += ["# density_kg_m3 = 1800"]
    setup = read_traces(write([*lines, NAMES, *rows()]), header, {"poisson_ratio": 0.4}).setup
    assert (setup.plate_radius, setup.poisson_ratio, setup.density) == (0.1, 0.4, 1800)


def test_an_option_supplies_a_missing_plate_radius(write: Write) -> None:
    path = write(["# pfwd-traces = 1", NAMES, *rows()])
    assert read_traces(path, None, {"plate_radius_m": 0.15}).setup.plate_radius == 0.15


def test_a_bad_value_in_a_header_file_is_found_there(write: Write) -> None:
    header = write(["# mine", "", 'plate_radius_m = "0.15"'], "setup.toml")
    with pytest.raises(TraceError, match=r"setup\.toml, line 3: expected plate_radius_m: a number"):
        read_traces(write([*HEADER, NAMES, *rows()]), header)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, r"setup\.toml: expected a readable TOML file, came No such file"),
        (b"plate_radius_m = 0,15", r"setup\.toml: expected TOML, came .*line 1"),
        (b"site = '\xff'", r"setup\.toml: expected UTF-8 text"),
    ],
)
def test_a_header_file_that_cannot_be_read(
    write: Write, tmp_path: Path, content: bytes | None, message: str
) -> None:
    header = tmp_path / "setup.toml" if content is None else write(content, "setup.toml")
    with pytest.raises(TraceError, match=message):
        read_traces(write([*HEADER, NAMES, *rows()]), header)


# Refused: the header


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("plate_mass_kg = -1", "expected plate_mass_kg: a number >= 0, in kg, came -1"),
        ("plate_mass_kg = nan", "came nan"),
        ("plate_mass_kg = true", "expected plate_mass_kg: a number >= 0, in kg, came True"),
        ('plate_mass_kg = "5"', "came '5'"),
        ("poisson_ratio = -0.1", "expected poisson_ratio: 0 <= number < 0.5, came -0.1"),
        ("poisson_ratio = 0.5", "came 0.5; 0.5 is an incompressible soil.*use 0.49"),
        ("density_kg_m3 = 0", "expected density_kg_m3: a number > 0, in kg/m3, came 0"),
        ("density_kg_m3 = inf", "came inf"),
        ("density_kg_m3 = 1" + 400 * "0", r"came 10+\.\.\."),
        ("bedrock_depth_m = 0", "expected bedrock_depth_m: a number > 0, in m, or inf"),
        ("bedrock_depth_m = -inf", "came -inf"),
        ('centre_sensor = "hole"', 'expected centre_sensor: "plate" or "ground", came \'hole\''),
        ("geophone_damping = 0", "expected geophone_damping: a number > 0, came 0"),
        ("geophone_natural_frequency_hz = 0", "a number > 0, in Hz, came 0"),
        ("load_filter_hz = 0", "expected load_filter_hz"),
        ("load_delay_s = inf", "expected load_delay_s: a finite number, in s, came inf"),
        ("seating_drops = -1", "expected seating_drops: a whole number >= 0, came -1"),
        ("seating_drops = 1.0", "came 1.0"),
        ("seating_drops = true", "came True"),
        ("model_floor_m = -1e-6", "expected model_floor_m"),
        ("site = true", "expected site: text in quotation marks or a finite number, came True"),
        ("latitude = nan", "expected latitude"),
        ("plate_mass_kg = 5,0", "expected one TOML key = value, came 'plate_mass_kg = 5,0'"),
        ("site = km 12", "text goes in quotation marks"),
        ("measured on a rainy day", "expected one TOML key = value"),
        ("[table]", "tables are not used here"),
        ("plate_radius_m = 0.15", "expected every key once, came 'plate_radius_m' again"),
        ("a = " + 5000 * "[", "expected one TOML key = value"),
        ("a = " + 5000 * "9", "expected one TOML key = value"),
    ],
)
def test_a_bad_header_line_is_refused_with_its_number(
    write: Write, line: str, message: str
) -> None:
    with pytest.raises(TraceError, match=f"point.csv, line 3: .*{message}"):
        read_traces(write([*HEADER, f"# {line}", NAMES, *rows()]))


@pytest.mark.parametrize("radius", ["0", "-0.15", "inf", "nan", "true", '"0.15"'])
def test_a_bad_plate_radius_is_refused(write: Write, radius: str) -> None:
    lines = ["# pfwd-traces = 1", f"# plate_radius_m = {radius}", NAMES, *rows()]
    with pytest.raises(TraceError, match="line 2: expected plate_radius_m: a number > 0, in m"):
        read_traces(write(lines))


def test_a_missing_plate_radius_is_refused(write: Write) -> None:
    lines = ["# pfwd-traces = 1", "# plate_radius = 0.15", NAMES, *rows()]
    message = "line 3: expected a header key plate_radius_m, came none; .*--plate-radius .*'plate_r"
    with pytest.raises(TraceError, match=message):
        read_traces(write(lines))


@pytest.mark.parametrize(
    ("declared", "missing"),
    [
        ("geophone_damping = 0.7", "geophone_natural_frequency_hz"),
        ("geophone_natural_frequency_hz = 4.5", "geophone_damping"),
    ],
)
def test_half_a_geophone_is_refused(write: Write, declared: str, missing: str) -> None:
    with pytest.raises(TraceError, match=f"{declared.split()[0]} alone; declare {missing} too"):
        read_traces(write([*HEADER, f"# {declared}", NAMES, *rows()]))


@pytest.mark.parametrize("version", ["2", "1.0", '"1"', "true"])
def test_another_version_is_refused(write: Write, version: str) -> None:
    lines = [f"# pfwd-traces = {version}", HEADER[1], NAMES, *rows()]
    with pytest.raises(TraceError, match="line 1: expected pfwd-traces = 1, came"):
        read_traces(write(lines))


@pytest.mark.parametrize("first", ["# plate_radius_m = 0.15", "", NAMES, "# by pfwd-traces"])
def test_a_file_of_another_program_needs_a_header_file(write: Write, first: str) -> None:
    with pytest.raises(TraceError, match=r"line 1: expected # pfwd-traces = 1, .*--header"):
        read_traces(write([first, *HEADER[1:], NAMES, *rows()]))


# Refused: the columns


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ("drop,load_N,displacement_m@0", "line 3: expected a column time_s, came columns"),
        ("drop,time_s,displacement_m@0", "line 3: expected a column load_N"),
        (NAMES + ",temperature", "line 3: expected a column drop, .*came 'temperature'"),
        (NAMES + ",", "came ''"),
        (NAMES + ",acceleration_m_s2@0.3", "came 'acceleration_m_s2@0.3'"),
        (NAMES + ",velocity_m_s", "the centre sensor is velocity_m_s@0.0000"),
        (NAMES + ",velocity_m_s@-0.3", "came 'velocity_m_s@-0.3'"),
        (NAMES + ",velocity_m_s@1e999", "came 'velocity_m_s@1e999'"),
        (NAMES + ",velocity_m_s@0.3.1", "came 'velocity_m_s@0.3.1'"),
        (NAMES + ",load_N", "expected every column once, came 'load_N' again"),
        (NAMES + ",displacement_m@0", "expected every column once, came 'displacement_m@0' again"),
        (NAMES.replace(",", ";"), "separate the columns with commas"),
    ],
)
def test_bad_columns_are_refused(write: Write, names: str, message: str) -> None:
    with pytest.raises(TraceError, match=message):
        read_traces(write([*HEADER, names, *rows()]))


def test_a_velocity_and_a_displacement_may_share_a_place(write: Write) -> None:
    numbers = [row + ",0" for row in rows()]
    drop = read_traces(write([*HEADER, NAMES + ",velocity_m_s@0", *numbers])).drops[0]
    assert len(drop.channels) == 2


# Refused: the numbers


def broken(index: int, row: str, lines: list[str] | None = None) -> list[str]:
    """A sound file of 40 rows (or `lines`) with row `index` replaced; row 0 is line 4."""
    numbers = lines or [*rows(1), *rows(2)]
    numbers[index] = row
    return [*HEADER, NAMES, *numbers]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("1,0.007,700", r"expected 4 values, one per column, came 3: '1,0.007,700'"),
        ("1,0.007,700,1e-6,", "expected 4 values, one per column, came 5"),
        ("1,0.007,,1e-6", "expected a number in load_N, came ''"),
        ("1,0.007,7OO,1e-6", "expected a number in load_N, came '7OO'"),
        ("1,0.007,1_000,1e-6", "expected a number in load_N, came '1_000'"),
        ("1,0.007,nan,1e-6", "expected a finite number in load_N, came nan"),
        ("1,0.007,700,inf", "expected a finite number in displacement_m@0.0000, came inf"),
        ("1,0.007,700,-1e999", "expected a finite number in displacement_m@0.0000, came -inf"),
        ("1.5,0.007,700,1e-6", "expected a whole drop number from 1, came 1.5"),
        ("0,0.007,700,1e-6", "expected a whole drop number from 1, came 0"),
        ("-1,0.007,700,1e-6", "expected a whole drop number from 1, came -1"),
        ("1e9,0.007,700,1e-6", "expected a whole drop number from 1, came 1e"),
        ("1,0.00702,700,1e-6", "expected even time steps, each within 1 % of 0.001 s, came"),
        ("1,0.006,700,1e-6", "expected even time steps"),
        ("# a remark,0,0,0", "expected a number in drop, came '# a remark'"),
        ("  ", "expected 4 values, one per column, came 1"),
    ],
)
def test_a_bad_row_is_refused_with_its_line(write: Write, row: str, message: str) -> None:
    with pytest.raises(TraceError, match=f"point.csv, line 11: {message}"):
        read_traces(write(broken(7, row)))


def test_the_line_counts_blank_lines_too(write: Write) -> None:
    numbers = rows()
    numbers[3:3] = ["", ""]
    numbers[12] = "1,0.010,nan,0"
    with pytest.raises(TraceError, match="line 16: expected a finite number"):
        read_traces(write([*HEADER, NAMES, *numbers]))


def test_every_row_too_short_is_refused_at_the_first(write: Write) -> None:
    numbers = [row.rsplit(",", 1)[0] for row in rows()]
    with pytest.raises(TraceError, match="line 4: expected 4 values, one per column, came 3"):
        read_traces(write([*HEADER, NAMES, *numbers]))


def test_a_lost_sample_is_found_where_it_is(write: Write) -> None:
    numbers = rows(count=40)
    del numbers[30]
    with pytest.raises(
        TraceError, match=r"line 34: expected even time steps.*came a step of 0.002"
    ):
        read_traces(write([*HEADER, NAMES, *numbers]))


def test_steps_uneven_by_rounding_are_accepted(write: Write) -> None:
    numbers = [f"1,{index / 15000:.7f},{index},0" for index in range(100)]
    read_traces(write([*HEADER, NAMES, *numbers]))


def test_time_that_starts_again_asks_for_a_drop_column(write: Write) -> None:
    numbers = [row.split(",", 1)[1] for row in [*rows(), *rows()]]
    with pytest.raises(
        TraceError, match=r"line 24: .*several drops in one file need a column drop"
    ):
        read_traces(write([*HEADER, NAMES.removeprefix("drop,"), *numbers]))


def test_a_drop_in_two_pieces_is_refused(write: Write) -> None:
    with pytest.raises(
        TraceError, match="line 44: expected the rows of a drop together, came drop 1"
    ):
        read_traces(write([*HEADER, NAMES, *rows(1), *rows(2), *rows(1)]))


@pytest.mark.parametrize("count", [0, 1, 15])
def test_fewer_than_16_samples_are_refused(write: Write, count: int) -> None:
    with pytest.raises(TraceError, match=f"line 3: expected at least 16 samples, came {count}"):
        read_traces(write([*HEADER, NAMES, *rows(count=count)]))


def test_a_short_second_drop_is_refused(write: Write) -> None:
    with pytest.raises(TraceError, match="line 24: expected at least 16 samples in drop 2, came 3"):
        read_traces(write([*HEADER, NAMES, *rows(1), *rows(2, 3)]))


def test_16_samples_are_enough(write: Write) -> None:
    assert read_traces(write([*HEADER, NAMES, *rows(count=16)])).drops[0].time.size == 16


# Refused: no trace file at all


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "point.csv: expected a row of column names, came the end of the file"),
        (b"# pfwd-traces = 1\n", "expected a row of column names, came the end of the file"),
        (bytes(range(256)) * 40, "expected UTF-8 text"),
        (b"\0" * 100, "line 1: expected UTF-8 text, came binary data"),
        (b"\x89PNG\r\n\x1a\n" + b"\0\1\2" * 100, "expected UTF-8 text"),
        ("\n".join(HEADER).encode("utf-16"), "expected UTF-8 text"),
        (b"x" * 100_000, "line 1: expected UTF-8 text, came binary data"),
    ],
)
def test_what_is_no_text_is_refused(write: Write, data: bytes, message: str) -> None:
    with pytest.raises(TraceError, match=message):
        read_traces(write(data))


@pytest.mark.parametrize(
    "rubbish", [b"1,0.02,\xff\xfe,0\n", b"1,0.02,1\0,0\n", "1,0.02,١,0\n".encode()]
)
def test_rubbish_among_the_numbers_is_refused(write: Write, rubbish: bytes) -> None:
    text = "\n".join([*HEADER, NAMES, *rows(), ""]).encode()
    with pytest.raises(TraceError, match=r"point\.csv.*: expected UTF-8 text"):
        read_traces(write(text + rubbish))


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        TraceError, match=r"none\.csv: expected a readable trace file, came No such file"
    ):
        read_traces(tmp_path / "none.csv")


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match="expected a trace file, came a folder"):
        read_traces(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this platform has no named pipes")
def test_a_pipe_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(TraceError, match="came a device or pipe"):
        read_traces(tmp_path / "pipe")


def test_a_file_that_may_not_be_read_is_refused(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(*_: object, **__: object) -> None:  # a superuser may read whatever chmod says
        raise PermissionError(13, "Permission denied")

    path = write([*HEADER, NAMES, *rows()])
    monkeypatch.setattr("builtins.open", denied)
    with pytest.raises(TraceError, match="expected a readable trace file, came Permission denied"):
        read_traces(path)


@pytest.mark.timeout(5)
def test_a_huge_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "huge.csv"
    with open(path, "wb") as stream:
        stream.truncate(2_000_000_000)
    with pytest.raises(TraceError, match=r"expected at most 500 MB, came 2000\.0 MB"):
        read_traces(path)


def test_a_message_is_one_line_whatever_the_file_holds(write: Write) -> None:
    line = "# x = \x1b[31m" + 300 * "y"
    with pytest.raises(TraceError) as caught:
        read_traces(write([*HEADER, line, NAMES, *rows()]))
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 400
    assert isinstance(caught.value, SurveyError)


# Writing

texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
finite = st.floats(allow_nan=False, allow_infinity=False)
free_values = st.one_of(texts, st.integers(-(10**9), 10**9), finite)
VALUES = {
    "plate_radius": st.floats(1e-3, 10),
    "plate_mass": st.floats(0, 1e3),
    "poisson_ratio": st.floats(0, 0.5, exclude_max=True),
    "density": st.floats(1, 1e4),
    "bedrock_depth": st.one_of(st.floats(1e-2, 1e3), st.just(float("inf"))),
    "centre_sensor": st.sampled_from(["plate", "ground"]),
    "geophone_natural_frequency": st.floats(1, 100),
    "geophone_damping": st.floats(0.01, 2),
    "load_filter_frequency": st.floats(1, 1e5),
    "load_delay": st.floats(-1, 1),
    "seating_drops": st.integers(0, 10),
    "model_floor": st.floats(0, 1e-3),
    "moisture": st.floats(0, 100),
    "temperature": st.floats(-90, 100),
}
PAIR = {"geophone_natural_frequency", "geophone_damping"}


@st.composite
def setups(draw: st.DrawFn) -> Setup:
    names = {rule.attribute for rule in KEYS.values()}
    chosen = draw(st.sets(st.sampled_from(sorted(names)))) | {"plate_radius"}
    chosen = chosen | PAIR if chosen & PAIR else chosen
    bare = st.text(string.ascii_letters + string.digits + "-_ .\"'é", min_size=1, max_size=10)
    unknown = bare.filter(lambda key: key not in KEYS and key != "pfwd-traces")
    inner = st.one_of(free_values, st.booleans(), st.dates())
    extra = st.dictionaries(unknown, st.one_of(inner, st.lists(inner, max_size=3)), max_size=3)
    values = {name: draw(VALUES.get(name, free_values)) for name in sorted(chosen)}
    return Setup(**values, extra=draw(extra))


@st.composite
def points(draw: st.DrawFn) -> TracePoint:
    sensors = draw(
        st.lists(
            st.tuples(st.floats(0, 10), st.sampled_from(["velocity", "displacement"])),
            unique=True,
            max_size=3,
        )
    )
    drops = []
    for number in sorted(draw(st.sets(st.integers(1, 50), min_size=1, max_size=3))):
        size = draw(st.integers(16, 24))
        first, step = draw(st.integers(-30, 30)), draw(st.sampled_from([1e-5, 1 / 15000, 1e-3]))
        vector = st.lists(finite, min_size=size, max_size=size).map(np.array)
        channels = [Channel(offset, kind, draw(vector)) for offset, kind in sensors]  # type: ignore[arg-type]
        time = (first + np.arange(size)) * step
        drops.append(Drop(number, time, draw(vector), tuple(channels)))
    return TracePoint("made up", draw(setups()), tuple(drops))


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60
)
@given(point=points())
def test_what_is_written_is_read_back_exactly(tmp_path: Path, point: TracePoint) -> None:
    path = tmp_path / "point.csv"
    write_traces(path, point)
    back = read_traces(path)
    assert back.setup == point.setup
    assert [drop.number for drop in back.drops] == [drop.number for drop in point.drops]
    for ours, theirs in zip(point.drops, back.drops, strict=True):
        np.testing.assert_array_equal(theirs.time, ours.time)
        np.testing.assert_array_equal(theirs.load, ours.load)
        for one, other in zip(ours.channels, theirs.channels, strict=True):
            assert (other.offset, other.quantity) == (one.offset, one.quantity)
            np.testing.assert_array_equal(other.values, one.values)
    assert [entry.name for entry in tmp_path.iterdir()] == ["point.csv"]


def test_drops_with_different_sensors_are_not_written(
    make_drop: Callable[..., Drop], tmp_path: Path
) -> None:
    drops = (make_drop(), make_drop(number=2, offsets=(0.0, 0.3)))
    with pytest.raises(TraceError, match="expected the same sensors in every drop"):
        write_traces(tmp_path / "point.csv", TracePoint("made up", Setup(plate_radius=0.15), drops))


def test_a_failed_write_leaves_the_old_file(make_drop: Callable[..., Drop], tmp_path: Path) -> None:
    path = tmp_path / "point.csv"
    point = TracePoint("made up", Setup(plate_radius=0.15), (make_drop(),))
    write_traces(path, point)
    before = path.read_bytes()
    unwritable = dataclasses.replace(point, setup=Setup(plate_radius=0.15, site="\udc80"))
    with pytest.raises(TraceError, match="expected text that UTF-8 can hold"):
        write_traces(path, unwritable)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["point.csv"]


# Files that other people wrote


def test_every_measured_and_computed_file_is_read(shared: Path) -> None:
    files = [*shared.glob("measured/*.csv"), *shared.glob("fe_drops/*.csv")]
    assert files
    for file in files:
        point = read_traces(file)
        assert all(drop.channels[0].offset == 0 for drop in point.drops)
