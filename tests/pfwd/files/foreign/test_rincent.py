"""Projects of Rincent's programs: what they say is read, what is wrong with them is said."""

import json
import re
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inversion.notices import text_of
from pfwd.errors import SurveyError, TraceError
from pfwd.files.foreign import archive as archive_module
from pfwd.files.importing import import_files
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from pfwd_device.recording import read_survey
from tests.pfwd.files.foreign.builders import (
    Traces,
    acquired,
    dataset,
    dynz,
    prjz,
    pulse,
    stored,
    viewed,
    zipped,
)

Reader = Callable[..., list[TracePoint]]
RAW = {"1": [pulse(peak=8000.0 + n, offset=2000.0) for n in range(3)], "A": [pulse()]}
HEX = {"F0000000000000AB": [pulse(peak=80e3 + n) for n in range(3)]}


def test_raw_channels_are_read_exactly(read: Reader) -> None:
    first, second = read(dynz(RAW), "a.dynz")
    assert (first.setup.point, second.setup.point) == ("a & b 1", "a & b 2")
    assert [drop.number for drop in first.drops] == [1, 2, 3]
    for drop, recorded in zip(first.drops, RAW["1"], strict=True):
        assert drop.load.tobytes() == recorded.load.tobytes()
        (channel,) = drop.channels
        assert (channel.offset, channel.quantity) == (0.0, "velocity")
        assert channel.values.tobytes() == recorded.sensors[0].tobytes()
        assert drop.time[0] == -0.005
        assert drop.time[75] == 0.0
        assert drop.sampling_rate == pytest.approx(15_000.0)
    setup = first.setup
    assert (setup.plate_radius, setup.poisson_ratio, setup.seating_drops) == (0.15, 0.35, 1)
    assert (setup.latitude, setup.longitude) == (45.5, 6.25)
    assert (setup.time_utc, setup.temperature) == ("2024-05-06T08:00:00+00:00", 12.0)
    assert setup.device == "Minidyn T-1"
    assert setup.extra["imported"]["position_dop"] == 0.7
    assert any("geophone_natural_frequency_hz" in text_of(text) for text in first.warnings)
    # What another program's file said is no mistake of the user.
    assert not any("not known to the format" in text_of(text) for text in first.warnings)


def test_stored_channels_are_read_on_request(read: Reader) -> None:
    first, _ = read(dynz(RAW), "a.dynz", channels="stored")
    assert first.setup.point == "north 1"
    for drop, recorded in zip(first.drops, RAW["1"], strict=True):
        np.testing.assert_array_equal(drop.load, (2 * recorded.load).astype("f4"))
        assert drop.channels[0].quantity == "displacement"
    assert any("processed and stored" in text_of(text) for text in first.warnings)


@pytest.mark.parametrize("folder", ["Rawdata\\", "rawdata/", "RAWDATA/"])
@pytest.mark.parametrize("rate", [None, 15_000.0])
def test_a_project_with_stored_traces(read: Reader, folder: str, rate: float | None) -> None:
    (point,) = read(prjz(HEX, acquired(HEX), folder=folder, rate=rate), "a.prjz")
    setup = point.setup
    assert (setup.plate_radius, setup.poisson_ratio, setup.seating_drops) == (0.3, 0.25, 2)
    assert (setup.point, setup.operator, setup.site) == ("north 1", "A. B.", "yard")
    assert setup.device == "Maxidyn T-2"
    assert setup.extra["imported"]["chainage_m"] == 10.0
    assert "position_dop" not in setup.extra["imported"]
    for drop, recorded in zip(point.drops, next(iter(HEX.values())), strict=True):
        np.testing.assert_array_equal(drop.load, recorded.load.astype("f4"))
        np.testing.assert_array_equal(drop.channels[0].values, recorded.sensors[0].astype("f4"))


def test_the_viewers_project(read: Reader) -> None:
    (point,) = read(prjz(HEX, viewed(HEX), folder="rawdata/"), "a.mpvz")
    setup = point.setup
    assert (setup.plate_radius, setup.poisson_ratio, setup.seating_drops) == (0.15, 0.35, 1)
    assert (setup.point, setup.site, setup.device) == ("east 1", "field", "Minidyn T-3")
    assert (setup.latitude, setup.longitude) == (45.5, 6.25)
    assert setup.extra["imported"]["surface_temperature_c"] == 13.0
    assert len(point.drops) == 3


@pytest.mark.parametrize("by_sample", [False, True])
def test_several_sensors_stand_where_the_database_says(read: Reader, by_sample: bool) -> None:
    offsets = [-0.3, 0.0, 0.3, 0.6]
    drops = {"1F": [pulse(channels=4), pulse(channels=4, peak=9000.0)]}
    (point,) = read(prjz(drops, acquired(drops, offsets=offsets), by_sample=by_sample), "a.prjz")
    assert point.setup.plate_radius == 0.15
    for drop, recorded in zip(point.drops, drops["1F"], strict=True):
        assert [channel.offset for channel in drop.channels] == offsets
        for channel, values in zip(drop.channels, recorded.sensors, strict=True):
            np.testing.assert_array_equal(channel.values, values.astype("f4"))
    assert not any("left out" in text_of(text) for text in point.warnings)


def test_the_first_of_two_sensors_at_a_place_is_read(read: Reader) -> None:
    drops = {"1F": [pulse(channels=4)]}
    (point,) = read(prjz(drops, acquired(drops, offsets=[-0.3, 0.0, 0.3, -0.3])), "a.prjz")
    (drop,) = point.drops
    assert [channel.offset for channel in drop.channels] == [-0.3, 0.0, 0.3]
    np.testing.assert_array_equal(drop.channels[0].values, drops["1F"][0].sensors[0].astype("f4"))
    assert any("a second sensor at -0.3 m is left out" in text_of(text) for text in point.warnings)


def test_accelerations_are_no_traces_but_the_stored_ones_are(read: Reader) -> None:
    point, _ = read(dynz(RAW, kind=1), "a.dynz")
    assert point.drops[0].channels[0].quantity == "displacement"
    assert any("accelerations" in text_of(text) for text in point.warnings)
    with pytest.raises(TraceError, match="got accelerations; import the stored traces with"):
        read(dynz(RAW, kind=1), "a.dynz", channels="raw")
    with pytest.raises(TraceError, match="got accelerations"):
        read(zipped({"database.xml": dataset(RAW, kind=1)}), "a.dynz")


def test_raw_displacements_are_displacements(read: Reader) -> None:
    point, _ = read(dynz(RAW, kind=3), "a.dynz")
    assert point.drops[0].channels[0].quantity == "displacement"


def test_traces_that_no_point_claims_are_not_lost(read: Reader) -> None:
    database = acquired({"1": HEX["F0000000000000AB"]})
    (point,) = read(prjz(HEX, database), "a.prjz")
    # Nobody can read out what a program calls its files.
    assert point.setup.point == "point 1"
    remark = "a.prjz, rawdata/f0000000000000ab: no point of the database has these traces"
    assert any(text_of(text).startswith(remark) for text in point.warnings)


def test_no_fix_is_no_position(read: Reader) -> None:
    database = acquired(HEX)
    place = database["PVs"][0]["Points"][0]["Point"]
    place["Latitude"] = place["Longitude"] = 0.0
    (point,) = read(prjz(HEX, database), "a.prjz")
    assert (point.setup.latitude, point.setup.longitude) == (None, None)


def test_a_time_without_a_zone_is_local(read: Reader) -> None:
    database = acquired(HEX)
    database["PVs"][0]["Points"][0]["Point"]["Date"] = "2024-05-06T08:00:00"
    (point,) = read(prjz(HEX, database), "a.prjz")
    assert point.setup.time_utc is None
    assert point.setup.extra["imported"]["time_local"] == "2024-05-06T08:00:00"


def test_a_survey_stores_the_facts_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.dynz"
    path.write_bytes(dynz(RAW))
    imported = list(import_files([str(path)], tmp_path / "s"))
    numbers = [("a & b 1", 1), ("a & b 1", 2), ("a & b 1", 3), ("a & b 2", 1)]
    assert [(recorded.point, recorded.number) for recorded in imported] == numbers
    points = read_points(tmp_path / "s")
    assert points[0].setup.extra["imported"]["position_dop"] == 0.7
    assert any("geophone_natural_frequency_hz" in text_of(text) for text in points[0].warnings)
    assert all(recorded.before for recorded in import_files([str(path)], tmp_path / "s"))
    assert len(read_survey(tmp_path / "s").drops) == 4


def test_a_header_wins(tmp_path: Path) -> None:
    path, header = tmp_path / "a.dynz", tmp_path / "h.toml"
    path.write_bytes(dynz(RAW))
    header.write_text("plate_radius_m = 0.1\nsite = 'mine'\n")
    point, _ = read_points(path, header)
    assert (point.setup.plate_radius, point.setup.site) == (0.1, "mine")


def edited(**changes: Any) -> bytes:
    return prjz(HEX, {**acquired(HEX), **changes})


def with_traces(data: bytes) -> bytes:
    database = json.dumps(acquired(HEX)).encode()
    return zipped({"database.json": database, "rawdata/F0000000000000AB": data})


def raw_with(old: bytes, new: bytes, count: int = -1) -> bytes:
    """Return a project with raw channels and a replaced text in its database."""
    return zipped({"database.xml": dataset(RAW).replace(old, new, count)})


GOOD = stored(HEX["F0000000000000AB"])
ENTITIES = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;">]>\n'
NAN = [Traces(np.full(300, np.nan), pulse().sensors)]

WRONG: list[tuple[str, bytes, str]] = [
    ("empty.dynz", b"", "expected a readable zip archive, got"),
    ("text.prjz", b"hello", "expected a readable zip archive"),
    ("cut.dynz", dynz(RAW)[:-300], "not a zip file.*; it may be cut off"),
    ("other.dynz", zipped({"a.txt": b"x"}), "database.json or database.xml.*got 'a.txt'"),
    ("dtd.dynz", dynz(RAW, head=ENTITIES), "without a document type, got one with entities"),
    ("xml.dynz", zipped({"database.xml": dataset(RAW)[:500]}), "complete XML, got"),
    ("root.dynz", zipped({"database.xml": b"<a/>"}), "a data set MDDataSet, got 'a'"),
    ("json.prjz", zipped({"database.json": b"{"}), "expected JSON, got"),
    ("deep.prjz", zipped({"database.json": b"[" * 100_000}), "expected JSON, got"),
    ("list.prjz", zipped({"database.json": b"[]"}), "a database with ParamsAcqu, project or base"),
    (
        "rate.prjz",
        edited(ParamsAcqu={"PreTrig": 0.0}),
        r"FreqAcqu \(Hz\), a number from 1 to 1e\+07, got none",
    ),
    ("pre.prjz", edited(ParamsAcqu={"FreqAcqu": 1e4, "PreTrig": "x"}), r"PreTrig \(s\)"),
    ("fast.prjz", edited(ParamsAcqu={"FreqAcqu": 10**30 - 1, "PreTrig": 0.005}), "FreqAcqu"),
    ("late.prjz", edited(ParamsAcqu={"FreqAcqu": 15e3, "PreTrig": 1e300}), "PreTrig"),
    ("packed.prjz", zipped({"database.json": b"{}"}, zipfile.ZIP_BZIP2), "packed by deflate"),
    ("plate.prjz", edited(ParamsBearing={}), "a header key plate_radius_m, got none"),
    (
        "sensors.prjz",
        prjz(HEX, acquired(HEX, offsets=[0.0, 0.3])),
        "2 displacements, as the database lists sensors, got 1",
    ),
    (
        "peaks.prjz",
        zipped({"database.json": json.dumps(acquired(HEX)).encode()}),
        "or peaks of load",
    ),
    ("magic.prjz", with_traces(b"x" * 200), "traces that begin with ISAANSIMPLEFILE"),
    ("short.prjz", with_traces(GOOD[:-1]), r"bytes, got \d+; the file was cut off"),
    ("long.prjz", with_traces(GOOD + b"12345"), "bytes, got"),
    ("head.prjz", with_traces(GOOD[:40]), "expected 52 bytes, got 40"),
    ("nan.prjz", with_traces(stored(NAN)), "finite numbers in the load, got nan as sample 1"),
    (  # numpy warns of a signalling NaN when it makes a double of it
        "signalling.prjz",
        with_traces(GOOD[:56] + b"\x01\x00\xa0\x7f" + GOOD[60:]),
        "finite numbers in the load, got nan as sample 1",
    ),
    (
        "count.prjz",
        with_traces(GOOD[:52] + struct.pack("<i", 299) + GOOD[56:]),
        "300 samples of the load, got 299",
    ),
    (
        "few.prjz",
        prjz({"1": [pulse(samples=8)]}, acquired({"1": [pulse(samples=8)]})),
        "at least 16 samples, got 8",
    ),
    ("base64.dynz", raw_with(b"<Data>", b"<Data>!!"), "Force in base64"),
    ("length.dynz", raw_with(b"h>2400<", b"h>2408<"), "2408 bytes in Force, got 2400"),
    (
        "settings.dynz",
        raw_with(b"<IdParamsAcqu>3<", b"<IdParamsAcqu>4<", 1),
        "one set of .*, got 2",
    ),
]


@pytest.mark.parametrize(("name", "data", "message"), WRONG, ids=[case[0] for case in WRONG])
def test_a_wrong_project_is_an_error_line_with_the_file(
    tmp_path: Path, name: str, data: bytes, message: str
) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(SurveyError, match=message) as caught:
        read_points(path)
    text = str(caught.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    assert len(text) < 600


def test_a_good_project_differs_from_the_wrong_ones(read: Reader) -> None:
    """The refusals above are for what was changed, not for how the files are built."""
    assert read(with_traces(GOOD), "a.prjz")
    assert read(zipped({"database.xml": dataset(RAW)}), "a.dynz")


def test_a_bomb_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive_module, "MAX_MEMBER_BYTES", 1_000_000)
    path = tmp_path / "bomb.prjz"
    path.write_bytes(zipped({"database.json": b" " * 50_000_000}))
    assert path.stat().st_size < 100_000
    with pytest.raises(TraceError, match="expected at most 1 MB, got more"):
        read_points(path)


def test_messages_have_no_control_characters(read: Reader) -> None:
    with pytest.raises(TraceError) as caught:
        read(zipped({"database.json": b'{"\\u001b[31m": 1}'}), "a.prjz")
    assert not re.search(r"[\x00-\x1f]", str(caught.value))


@pytest.mark.parametrize("letter", [b"\n", b"\0"])
def test_a_damaged_name_does_not_break_the_line(read: Reader, letter: bytes) -> None:
    """The list of members has a different name than the member, or none at all."""
    data = prjz(HEX, acquired(HEX))
    at = data.rfind(b"database.json")
    with pytest.raises(TraceError) as caught:
        read(data[:at] + letter + data[at + 1 :], "a.prjz")
    assert len(str(caught.value).splitlines()) == 1
