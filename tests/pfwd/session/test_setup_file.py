"""The setup file: every key at fault is named with its file; what it says wins over the device."""

import contextlib
import dataclasses
import datetime
import math
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfwd.errors import SurveyError
from pfwd.files.header import HEADER_KEYS
from pfwd.session.setup_file import (
    MAX_FILE_CHARACTERS,
    MeasuringSetup,
    parse_setup,
    read_setup_file,
    response_warnings,
    setup_of,
)
from pfwd_device.errors import DeviceError, SetupError
from pfwd_device.identity import ChannelIdentity
from pfwd_device.setup import CHANNEL_KEYS, DETECTION_KEYS, INSTRUMENT_KEYS, LINK_KEYS
from pfwd_plugins.quantities import Measurand
from tests.pfwd.scripted_feed import GEOPHONE, IDENTITY, LOAD, NOW

DAY, WEEK = datetime.date(2026, 5, 31), datetime.timedelta(days=7)
ASCII = """
plate_radius_m = 0.1
[link]
dialect = "ascii"
sampling_rate_hz = 5000.0
[instrument]
adc_bits = 16
adc_range_v = 5.0
[[channels]]
name = "load"
column = 1
role = "load"
sensitivity = 4e-4
[[channels]]
name = "g0"
column = 2
role = "geophone"
sensitivity = 28.8
natural_frequency_hz = 4.5
damping = 0.6
resolution = 0.5
"""


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("plate_radius_m = 0", "plate_radius_m"),
        (f'point = "{"x" * 65}"', "point"),
        ("[link]\nbaud_rate = 10", "baud_rate"),
        ('[link]\ndialect = "morse"', "dialect"),
        ('[instrument]\nmodel = "a\\u001b[2J"', "model"),
        ("channels = [1]", r"channels\[1\]: expected a table"),
        ('[[channels]]\nrole = "load"', r"channels\[1\].name: expected text"),
        ('[[channels]]\nname = "a"\nrole = "nose"', "role"),
        ('[[channels]]\nname = "a"\nzero_v = inf', "zero_v"),
        (
            '[[channels]]\nname = "a"\nnatural_frequency_hz = 0',
            "natural_frequency_hz: .*write geophone_natural_frequency_hz = 0.0",
        ),
        ('[[channels]]\nname = "a"\ndue = 2026-01-01T00:00:00', "due"),
        ('[[channels]]\nname = "a"\n[[channels]]\nname = "a"', "name.*'a' twice"),
        (
            '[[channels]]\nname = "a"\ncolumn = 1\n[[channels]]\nname = "b"\ncolumn = 1',
            "column.*1 twice",
        ),
        *((f"[detection]\n{key} = 0", key) for key in DETECTION_KEYS),
        ("[detection]\nhysteresis = 1.0", "hysteresis"),
        ("[detection]\npost_trigger_s = 60", "10 s"),
        ("plate_radius_m = 0,15", "TOML"),
        ("a = " + "[" * 5000, "TOML"),
        ("plate_radius = 0.15", r"did you mean plate_radius_m\?"),
        ('[[channels]]\nname = "a"\nsensitivty = 1.0', r"did you mean sensitivity\?"),
        ("zzzzz = 1", "known are plate_radius_m, plate_mass_kg"),
        ("[link]\nzzzzz = 1", "known are dialect, baud_rate"),
        ('[procedure]\nname = "mndot"\nfile = "x.toml"', "got name and file"),
        ("[procedure]\n", "either name or file, got none"),
        ('[procedure]\nnmae = "mndot"', "a known key, got 'nmae'; did you mean name"),
        ("procedure = 3", "a name or a table .procedure., got 3"),
        ('seating_drops = 2\nprocedure = "mndot"', "seating_drops: expected 3, .* got 2"),
    ],
)
def test_the_key_at_fault_is_named_with_its_file(text: str, key: str) -> None:
    with pytest.raises((SurveyError, DeviceError), match=f"(?s)field.toml.*{key}") as caught:
        parse_setup(text, "field.toml")
    assert "\n" not in str(caught.value)
    assert "\x1b" not in str(caught.value)


@pytest.mark.parametrize(
    ("line", "replacement", "message"),
    [
        ("sampling_rate_hz = 5000.0", "", "sampling_rate_hz"),
        ("adc_bits = 16", "", "adc_bits"),
        ("adc_range_v = 5.0", "", "adc_range_v"),
        ("column = 2", "", "'g0': column"),
        ('role = "geophone"', "", "'g0': role"),
        ("sensitivity = 28.8", "", "'g0': sensitivity"),
        ("damping = 0.6", "", "natural_frequency and damping together"),
        ('role = "load"', 'role = "unused"', "role load"),
        ('role = "geophone"', 'role = "unused"', "role geophone"),
    ],
)
def test_lines_need_everything_that_they_do_not_report(
    line: str, replacement: str, message: str
) -> None:
    assert ASCII.count(line) == 1
    with pytest.raises(SetupError, match=f"field.toml: .*{message}"):
        parse_setup(ASCII.replace(line, replacement), "field.toml")


def test_lines_that_are_declared_completely() -> None:
    setup = parse_setup(ASCII, "field.toml")
    assert setup.device.make_dialect(77).name == "ascii"
    identity = setup.device.declared_identity()
    assert identity.sampling_rate == 5000
    assert identity.channels == (
        ChannelIdentity("load", Measurand.LOAD, sensitivity=4e-4),
        ChannelIdentity(
            "g0", Measurand.VELOCITY, sensitivity=28.8, natural_frequency=4.5, damping=0.6
        ),
    )
    assert setup.device.apply(identity) is identity
    assert setup.setup_with(identity).plate_radius == 0.1
    assert setup.differences(identity) == []


def test_the_file_wins_and_the_differences_are_listed() -> None:
    text = """
plate_radius_m = 0.1
poisson_ratio = 0.4
[link]
sampling_rate_hz = 9000.0
[instrument]
serial_number = "X-9"
[[channels]]
name = "g0"
sensitivity = 30.0
offset_m = -0.02
calibrated = 2026-01-02
"""
    setup = parse_setup(text, "field.toml")
    identity = setup.identity_with(IDENTITY)
    assert (identity.serial_number, identity.channels[1].sensitivity) == ("X-9", 30.0)
    assert (identity.channels[1].natural_frequency, identity.channels[1].offset) == (4.5, -0.02)
    assert identity.channels[1].calibrated == datetime.date(2026, 1, 2)
    declared = setup.declared_with(identity)
    assert (declared["plate_radius_m"], declared["device"]) == (0.1, "X-9")
    differences = [
        re.findall(r"(\w+) = (\S+) .*?(\S+)$", line)[0] for line in setup.differences(IDENTITY)
    ]
    assert differences == [
        ("plate_radius_m", "0.1", "0.15"),
        ("serial_number", "'X-9'", "'T-1'"),
        ("offset_m", "-0.02", "0.0"),
        ("sensitivity", "30.0", str(GEOPHONE.sensitivity)),
        ("calibrated", "2026-01-02", "none"),
        ("sampling_rate_hz", "9000", "10000"),
    ]


def test_a_channel_that_the_instrument_does_not_have_is_named_with_the_file() -> None:
    setup = parse_setup('[[channels]]\nname = "g9"\nsensitivity = 1.0', "field.toml")
    with pytest.raises(SetupError, match=r"field.toml: .*among 'load', 'g0', got 'g9'"):
        setup.identity_with(IDENTITY)


def test_half_a_response_is_refused_with_the_file() -> None:
    setup = parse_setup('[[channels]]\nname = "load"\ndamping = 0.6', "field.toml")
    with pytest.raises(SetupError, match=r"field\.toml: .*natural_frequency and damping together"):
        setup.identity_with(IDENTITY)
    setup = parse_setup("geophone_damping = 0.6", "field.toml")
    bare = dataclasses.replace(GEOPHONE, natural_frequency=None, damping=None)
    identity = dataclasses.replace(IDENTITY, channels=(LOAD, bare))
    with pytest.raises(SurveyError, match=r"field\.toml: .*geophone_damping alone"):
        setup.setup_with(identity)


def test_recording_requires_a_plate_radius() -> None:
    bare = dataclasses.replace(IDENTITY, plate_radius=None)
    with pytest.raises(SetupError, match=r"Recording does not start: write plate_radius_m = 0\.15"):
        MeasuringSetup().declared_with(bare)
    assert parse_setup("plate_radius_m = 0.2", "f").setup_with(bare).plate_radius == 0.2


def test_dates_and_infinity() -> None:
    setup = parse_setup("bedrock_depth_m = inf\ntime_utc = 2026-05-04T12:00:00Z", "f")
    assert setup.declared["time_utc"] == "2026-05-04T12:00:00+00:00"
    assert setup.setup_with(IDENTITY).bedrock_depth == math.inf
    assert NOW.isoformat() == setup.declared["time_utc"]


def test_geophones_that_differ_from_the_centre_geophone_are_named() -> None:
    similar = dataclasses.replace(GEOPHONE, name="g1", offset=0.3, natural_frequency=4.6)
    for offset in (0.6, -0.6):
        different = dataclasses.replace(GEOPHONE, name="g2", offset=offset, natural_frequency=10.0)
        identity = dataclasses.replace(IDENTITY, channels=(LOAD, different, similar, GEOPHONE))
        (line,) = response_warnings(identity)
        assert line.startswith("geophone g2 (10 Hz, damping 0.6)")


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(SurveyError, match="expected a readable TOML file"):
            read_setup_file(path)
    for procedure, refused in (
        ('file = "none.toml"', "none.toml: expected a readable TOML file"),
        ('name = "none"', "field.toml: procedure: expected one of astm-e2583"),
    ):
        with pytest.raises(SurveyError, match=refused):
            parse_setup(f"[procedure]\n{procedure}", "field.toml")
    odd = tmp_path / "odd.toml"
    odd.write_bytes(b"site = '\xff\xfe'")
    with pytest.raises(SurveyError, match="UTF-8"):
        read_setup_file(odd)
    odd.write_text("#" * (MAX_FILE_CHARACTERS + 1))
    with pytest.raises(SurveyError, match="at most 100000 characters"):
        read_setup_file(odd)
    odd.write_bytes(b"\xef\xbb\xbfplate_radius_m = 0.15")  # as an editor of Windows writes it
    assert read_setup_file(odd).declared == {"plate_radius_m": 0.15}


@pytest.mark.parametrize(
    ("load", "geophone", "declared"),
    [
        ({}, {}, None),
        ({"calibrated": DAY}, {}, None),
        ({"calibrated": DAY}, {"calibrated": DAY - WEEK}, "2026-05-24"),
        ({"calibrated": DAY}, {"calibrated": DAY, "due": DAY + WEEK}, None),
        ({"calibrated": DAY}, {"calibrated": DAY, "due": datetime.date.max}, "2026-05-31"),
    ],
)
def test_the_oldest_calibration_is_declared_until_a_channel_expires(
    load: dict[str, Any], geophone: dict[str, Any], declared: str | None
) -> None:
    channels = (dataclasses.replace(LOAD, **load), dataclasses.replace(GEOPHONE, **geophone))
    identity = dataclasses.replace(IDENTITY, channels=channels)
    assert MeasuringSetup().setup_with(identity).calibrated == declared


_KEYS = st.sampled_from(
    [*HEADER_KEYS, *LINK_KEYS, *INSTRUMENT_KEYS, *CHANNEL_KEYS, *DETECTION_KEYS, "x", '"\\u001b"']
)
_VALUES = st.one_of(
    st.integers(-(10**30), 10**30).map(str),
    st.floats().map(repr),
    st.sampled_from(
        [
            *('"ascii"', '"pfwd"', '"load"', '"geophone"', '"a"', "true", "[]", "{}"),
            *("2026-01-01", "2026-01-01T00:00:00", "12:00:00", "1" + "0" * 400, '"\\u0000"'),
            '"' + "x" * 99 + '"',
        ]
    ),
)
_TABLES = st.sampled_from(
    ["[link]", "[instrument]", "[[channels]]", '[[channels]]\nname = "a"', "[detection]", "[x]"]
)
_LINES = st.one_of(_TABLES, st.builds("{} = {}".format, _KEYS, _VALUES), st.text(max_size=10))


@settings(max_examples=300, deadline=None)
@given(st.lists(_LINES, max_size=12).map("\n".join))
def test_any_text_is_a_setup_or_an_error_of_the_setup(text: str) -> None:
    with contextlib.suppress(SurveyError, DeviceError):
        setup = parse_setup(text, "f")
        setup.device.make_dialect()
        identity = setup.identity_with(IDENTITY)
        setup.setup_with(identity)
        setup.differences(IDENTITY)


@settings(max_examples=60, deadline=None)
@given(st.dictionaries(st.sampled_from([*HEADER_KEYS]), st.floats() | st.text() | st.integers()))
def test_stored_declarations_are_validated(declared: dict[str, Any]) -> None:
    try:
        setup_of(declared, "drop 1")
    except SurveyError:
        return
    assert declared["plate_radius_m"] > 0
