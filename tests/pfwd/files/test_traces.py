"""Trace files: reading, writing, and sensors on both sides of the plate."""

import dataclasses
import datetime
import string
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pfwd.analysis.drop_facts import unbroken_peaks
from pfwd.errors import TraceError
from pfwd.files.header import HEADER_KEYS, PointSetup, declarations_of
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint, read_traces, write_traces
from pfwd_device import Channel, Drop
from pfwd_device.signals import channels_outward
from tests.pfwd.files.trace_lines import HEADER, NAMES, Write, assert_same_drops, rows
from tests.records import known


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
    assert point.setup == PointSetup(
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


@pytest.mark.parametrize(
    ("lines", "codes"),
    [
        ([], ["plate-mass-not-declared"]),
        (["# plate_radius = 1"], ["plate-mass-not-declared", "header-key-unknown"]),
        (["# plate_mass_kg = 5"], []),
    ],
)
def test_a_point_carries_its_warnings(write: Write, lines: list[str], codes: list[str]) -> None:
    point = read_traces(write([*HEADER, *lines, NAMES, *rows()]))
    assert [warning.code for warning in point.warnings] == codes
    suspect = [HEADER[0], "# plate_radius_m = 1.5", *lines]
    expected = ["plate-radius-suspect", *codes]
    point = read_traces(write([*suspect, NAMES, *rows()]))
    assert sorted(warning.code for warning in point.warnings) == sorted(expected)


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


def test_a_file_without_sensors_is_read(write: Write) -> None:
    numbers = [row.rsplit(",", 1)[0] for row in rows()]
    point = read_traces(write([*HEADER, "drop,time_s,load_N", *numbers]))
    assert point.drops[0].channels == ()


# A header from elsewhere


def test_a_header_file_stands_in_for_the_header(write: Write) -> None:
    header = write(["plate_radius_m = 0.1", "seating_drops = 3"], "setup.toml")
    foreign = write(["# Recorder 3, exported 1.5.2026", "# plate_radius_m = 9", NAMES, *rows()])
    setup = read_traces(foreign, declarations_of(header), foreign=True).setup
    assert setup == PointSetup(plate_radius=0.1, seating_drops=3)


def test_option_wins_over_header_file_wins_over_header(write: Write) -> None:
    header = write(["plate_radius_m = 0.1", "poisson_ratio = 0.1"], "setup.toml")
    lines = ["# pfwd-traces = 1", "# plate_radius_m = 0.2", "# poisson_ratio = 0.2"]
    lines += ["# density_kg_m3 = 1800"]
    declared = declarations_of(header, {"poisson_ratio": 0.4})
    setup = read_traces(write([*lines, NAMES, *rows()]), declared).setup
    assert (setup.plate_radius, setup.poisson_ratio, setup.density) == (0.1, 0.4, 1800)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, ": expected a readable TOML file, got No such file"),
        (b"plate_radius_m = 0,15", ": expected TOML, got .*line 1"),
        (b"site = '\xff'", ": expected UTF-8 text"),
        (b"# mine\n\nplate_radius_m = '1'", ", line 3, plate_radius_m: expected a number"),
    ],
)
def test_a_wrong_header_file_is_refused(
    write: Write, tmp_path: Path, content: bytes | None, message: str
) -> None:
    header = tmp_path / "setup.toml" if content is None else write(content, "setup.toml")
    with pytest.raises(TraceError, match=rf"setup\.toml{message}"):
        read_traces(write([*HEADER, NAMES, *rows()]), declarations_of(header))


# Writing

texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
finite = st.floats(allow_nan=False, allow_infinity=False)
free_values = st.one_of(texts, st.integers(-(10**9), 10**9), finite)
VALUES = {
    "plate_radius": st.floats(1e-2, 10),
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
    "calibrated": st.dates().map(datetime.date.isoformat),
    "moisture": st.floats(0, 100),
    "plate_load_modulus": st.floats(1.0, 1e9),
    "temperature": st.floats(-90, 100),
    "test": st.sampled_from(["ground", "stiffness"]),
    "rig_stiffness": st.floats(1e3, 1e9),
}
PAIR = {"geophone_natural_frequency", "geophone_damping"}


@st.composite
def setups(draw: st.DrawFn) -> PointSetup:
    names = {rule.attribute for rule in HEADER_KEYS.values()}
    chosen = draw(st.sets(st.sampled_from(sorted(names)))) | {"plate_radius"}
    chosen = chosen | PAIR if chosen & PAIR else chosen
    bare = st.text(string.ascii_letters + string.digits + "-_ .\"'é", min_size=1, max_size=10)
    unknown = bare.filter(lambda key: key not in HEADER_KEYS and key != "pfwd-traces")
    inner = st.one_of(free_values, st.booleans(), st.dates())
    extra = st.dictionaries(unknown, st.one_of(inner, st.lists(inner, max_size=3)), max_size=3)
    values = {name: draw(VALUES.get(name, free_values)) for name in sorted(chosen)}
    return PointSetup(**values, extra=draw(extra))


@st.composite
def points(draw: st.DrawFn) -> TracePoint:
    sensors = draw(
        st.lists(
            st.tuples(st.floats(-10, 10), st.sampled_from(["velocity", "displacement"])),
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
    suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=30
)
@given(point=points())
def test_written_traces_are_read_back_exactly(tmp_path: Path, point: TracePoint) -> None:
    path = tmp_path / "point.csv"
    write_traces(path, point)
    back = read_traces(path)
    assert back.setup == point.setup
    assert_same_drops(back.drops, point.drops)
    assert [entry.name for entry in tmp_path.iterdir()] == ["point.csv"]


def test_a_failed_write_leaves_the_old_file(make_drop: Callable[..., Drop], tmp_path: Path) -> None:
    path = tmp_path / "point.csv"
    point = TracePoint("made up", PointSetup(plate_radius=0.15), (make_drop(),))
    write_traces(path, point)
    before = path.read_bytes()
    unwritable = dataclasses.replace(point, setup=PointSetup(plate_radius=0.15, site="\udc80"))
    drops = (make_drop(), make_drop(number=2, offsets=(0.0, 0.3)))
    differing = dataclasses.replace(point, drops=drops)
    for wrong, message in (
        (unwritable, "text that UTF-8"),
        (differing, "the same sensors in every"),
    ):
        with pytest.raises(TraceError, match=f"expected {message}"):
            write_traces(path, wrong)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["point.csv"]


def test_a_negative_distance_is_a_separate_sensor(
    write: Write, make_drop: Callable[..., Drop]
) -> None:
    drop = make_drop(offsets=(0.3, 0.0, 0.6), quantity="velocity")
    behind = 1.1 * drop.channels[0].values
    columns = [drop.time, drop.load, behind, *(channel.values for channel in drop.channels)]
    names = ",".join(f"velocity_m_s@{place}" for place in ("-0.3000", "0.3", "-0.0", "0.6"))
    numbers = [",".join(map(repr, row)) for row in np.column_stack(columns).tolist()]
    (point,) = read_points(write([*HEADER, f"time_s,load_N,{names}", *numbers]))
    (drop,) = point.drops
    assert [channel.offset for channel in drop.channels] == [-0.3, 0.3, 0.0, 0.6]
    # -0 is the centre: no sign is left on it.
    assert not np.signbit(drop.channels[2].offset)
    np.testing.assert_allclose(drop.channels[0].values, 1.1 * drop.channels[1].values)
    assert [channel.offset for channel in channels_outward(drop)] == [0.0, 0.3, -0.3, 0.6]
    assert known(unbroken_peaks(drop)).centre == pytest.approx(5e-4, rel=0.01)
