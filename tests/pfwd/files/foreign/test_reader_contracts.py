"""Contracts of every reader of another program's file; the file of a format has the rest."""

import json
import struct
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfwd.errors import SurveyError
from pfwd.files.foreign.registry import foreign_suffixes
from pfwd.files.importing import import_files
from pfwd.files.reading import read_points
from tests.pfwd.files.foreign.builders import (
    DAT_HEAD,
    SENSOR_OFFSETS,
    SIMPLE_MAP,
    Traces,
    acquired,
    dat,
    dataset,
    delimited,
    dynz,
    prjz,
    pulse,
    stored,
    thy,
    viewed,
    zipped,
)
from tests.pfwd.files.foreign.peaks_builders import dynatest, f25, pddx, places, sweco
from tests.pfwd.files.trace_lines import assert_same_drops

RAW = {"1": [pulse(peak=8000.0 + n, offset=2000.0) for n in range(3)], "A": [pulse()]}
HEX = {"F0000000000000AB": [pulse(peak=80e3 + n) for n in range(3)]}
HISTORY = thy([(1, n, pulse(samples=470, pre=0.0, peak=40e3 + n, channels=3)) for n in (1, 2, 3)])
PEAKS = DAT_HEAD + dat(1, [(40e3, [3e-4, 2e-4, 1e-4]), (50e3, [4e-4, 3e-4, 2e-4])])
ROWS = delimited(np.arange(50) / 1e3, np.full(50, 1.0), np.full(50, 2.0))


@dataclass(frozen=True)
class Sample:
    """File of another program, with the options that its reader requires."""

    name: str
    data: bytes
    header: str = ""
    column_map: str = ""

    def write(self, folder: Path, *, name: str = "", header: str = "") -> dict[str, Any]:
        """Write the file and return the arguments of `read_points`."""
        path = folder / (name or self.name)
        path.write_bytes(self.data)
        arguments = {"path": str(path)}
        texts = {"header": self.header + header, "column_map": self.column_map}
        for key, text in texts.items():
            if text:
                arguments[key] = str(folder / f"{key}.toml")
                Path(arguments[key]).write_text(text, encoding="utf-8")
        return arguments


PULSE = pulse(rate=1e4)
TEXT = delimited(np.arange(300) / 1e4, PULSE.load, PULSE.sensors[0]).encode()
MARKED = [
    Sample("raw.dynz", dynz(RAW)),
    Sample("stored.prjz", prjz(HEX, acquired(HEX))),
    Sample("viewed.mpvz", prjz(HEX, viewed(HEX), folder="rawdata/")),
    Sample("history.THY", HISTORY, SENSOR_OFFSETS),
    Sample("peaks.DAT", PEAKS.encode(), SENSOR_OFFSETS),
    Sample("a.F25", f25(places()).encode()),
    Sample("sweco.fwd", sweco(places()).encode()),
    Sample("dynatest.fwd", dynatest(places()).encode()),
    Sample("a.pdx", pddx(places()).encode()),
]
"""Formats that are recognised by their content."""
SAMPLES = [*MARKED, Sample("text.txt", TEXT, column_map=SIMPLE_MAP)]


def name_of(sample: Sample) -> str:
    return sample.name


@pytest.mark.parametrize("sample", SAMPLES, ids=name_of)
def test_a_survey_holds_the_file_and_a_second_import_adds_nothing(
    sample: Sample, tmp_path: Path
) -> None:
    arguments = sample.write(tmp_path)
    points = read_points(**arguments)
    drops = [drop for point in points for drop in point.drops]
    file = arguments.pop("path")
    for before in (False, True):
        imported = list(import_files([file], tmp_path / "survey", **arguments))
        expected = [(drop.number, before, None) for drop in drops]
        assert [(item.number, item.before, item.error) for item in imported] == expected
        assert [item.kind == "peaks" for item in imported] == [bool(d.only_peaks) for d in drops]
    for point, recorded in zip(points, read_points(tmp_path / "survey"), strict=True):
        assert recorded.setup.point == (point.setup.point or "text")
        assert recorded.setup.plate_radius == point.setup.plate_radius
        assert recorded.setup.extra.get("imported") == point.setup.extra.get("imported")
        assert_same_drops(recorded.drops, point.drops)


@pytest.mark.parametrize("sample", MARKED, ids=name_of)
def test_the_content_names_the_format_and_a_header_wins(sample: Sample, tmp_path: Path) -> None:
    declared = "site = 'mine'\n" + ("" if sample.header else "plate_radius_m = 0.1\n")
    for point in read_points(**sample.write(tmp_path, name="other.bin", header=declared)):
        assert point.setup.site == "mine"
        assert point.setup.plate_radius == (0.15 if sample.header else 0.1)


@pytest.mark.parametrize(
    "sample", [s for s in SAMPLES if not s.data.startswith(b"PK")], ids=name_of
)
def test_a_file_cut_anywhere_is_read_in_part_or_refused_on_one_line(
    sample: Sample, tmp_path: Path
) -> None:
    errors = []
    for end in np.linspace(3, len(sample.data), 60).astype(int).tolist():
        arguments = replace(sample, data=sample.data[:end]).write(tmp_path)
        try:
            assert read_points(**arguments)
        except SurveyError as err:
            errors.append(str(err))
    assert all(text.startswith(arguments["path"]) and text.isprintable() for text in errors)


def project(**changes: Any) -> bytes:
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
FEW = {"1": [pulse(samples=8)]}
WITHOUT_TRACES = zipped({"database.json": json.dumps(acquired(HEX)).encode()})

ARCHIVES: list[tuple[str, bytes, str]] = [
    ("empty.dynz", b"", "expected a readable zip archive, got"),
    ("cut.dynz", dynz(RAW)[:-300], "not a zip file.*; it may be cut off"),
    ("other.dynz", zipped({"a.txt": b"x"}), "database.json or database.xml.*got 'a.txt'"),
    ("dtd.dynz", dynz(RAW, head=ENTITIES), "without a document type, got one with entities"),
    ("xml.dynz", zipped({"database.xml": dataset(RAW)[:500]}), "complete XML, got"),
    ("root.dynz", zipped({"database.xml": b"<a/>"}), "a data set MDDataSet, got 'a'"),
    ("deep.prjz", zipped({"database.json": b"[" * 100_000}), "expected JSON, got"),
    ("list.prjz", zipped({"database.json": b"[]"}), "a database with ParamsAcqu, project or base"),
    ("key.prjz", zipped({"database.json": b'{"\\u001b[31m": 1}'}), "a database with ParamsAcqu"),
    ("packed.prjz", zipped({"database.json": b"{}"}, zipfile.ZIP_BZIP2), "packed by deflate"),
    ("rate.prjz", project(ParamsAcqu={"PreTrig": 0.0}), r"FreqAcqu \(Hz\), .*1e\+07, got none"),
    ("fast.prjz", project(ParamsAcqu={"FreqAcqu": 10**30 - 1, "PreTrig": 0.005}), "FreqAcqu"),
    ("pre.prjz", project(ParamsAcqu={"FreqAcqu": 1e4, "PreTrig": "x"}), r"PreTrig \(s\)"),
    ("late.prjz", project(ParamsAcqu={"FreqAcqu": 15e3, "PreTrig": 1e300}), "PreTrig"),
    ("plate.prjz", project(ParamsBearing={}), "a header key plate_radius_m, got none"),
    ("sensors.prjz", prjz(HEX, acquired(HEX, offsets=[0.0, 0.3])), "2 displacements, .*, got 1"),
    ("peaks.prjz", WITHOUT_TRACES, "or peaks of load and deflection in the database"),
    ("peaks.mpvz", WITHOUT_TRACES, "or peaks of load and deflection in the database"),
    ("magic.prjz", with_traces(b"x" * 200), "traces that begin with ISAANSIMPLEFILE"),
    ("short.prjz", with_traces(GOOD[:-1]), r"bytes, got \d+; the file was cut off"),
    ("long.prjz", with_traces(GOOD + b"12345"), "bytes, got"),
    ("head.prjz", with_traces(GOOD[:40]), "expected 52 bytes, got 40"),
    ("nan.prjz", with_traces(stored(NAN)), "finite numbers in the load, got nan as sample 1"),
    # numpy warns of a signalling NaN when it makes a double of it
    (
        "signal.prjz",
        with_traces(GOOD[:56] + b"\x01\x00\xa0\x7f" + GOOD[60:]),
        "got nan as sample 1",
    ),
    ("count.prjz", with_traces(GOOD[:52] + struct.pack("<i", 299) + GOOD[56:]), "300 .*, got 299"),
    ("few.prjz", prjz(FEW, acquired(FEW)), "at least 16 samples, got 8"),
    ("base64.dynz", raw_with(b"<Data>", b"<Data>!!"), "Force in base64"),
    ("length.dynz", raw_with(b"h>2400<", b"h>2408<"), "2408 bytes in Force, got 2400"),
    ("sets.dynz", raw_with(b"<IdParamsAcqu>3<", b"<IdParamsAcqu>4<", 1), "one set of .*, got 2"),
]
RADIUS = "plate_radius_m = 0.1\nsensor_offsets_m = "
HISTORIES: list[tuple[bytes, str, str]] = [
    (b"", SENSOR_OFFSETS, "drops with Impact: and rows of numbers, got none"),
    (b"\x00\x01" * 50, SENSOR_OFFSETS, "a line of text, got binary data"),
    (HISTORY[: len(HISTORY) // 2], SENSOR_OFFSETS, "got the end of the file after|5 numbers"),
    (HISTORY.replace(b"Time Force", b"Zeit Kraft"), SENSOR_OFFSETS, "a line Time Force Disp1"),
    (HISTORY.replace(b": 470", b": 469", 1), SENSOR_OFFSETS, "number of rows that Number_of"),
    (HISTORY.replace(b": 470", b": 471", 1), SENSOR_OFFSETS, "expected 5 numbers, got ''"),
    (HISTORY.replace(b"0.1707 ", b"x.1707 ", 1), SENSOR_OFFSETS, "line 14: expected 5 numbers"),
    (HISTORY.replace(b"0.1707 ", b"0.3000 ", 1), SENSOR_OFFSETS, "even, growing time steps"),
    (HISTORY, "site = 'x'", "a header key plate_radius_m, got none"),
    (HISTORY, f"{RADIUS}[0.0]", "3 distances in m"),
    (HISTORY, f"{RADIUS}'x'", "3 distances in m"),
]
STATIONS = [
    (DAT_HEAD, "lines with load and deflections, got none; is it a JILS .DAT"),
    (DAT_HEAD + "1 1   0.000 1 10.05 71.3\n", "line 9: expected a load and deflections"),
    (PEAKS + "2 1   0.000 1 10.05 5.83 4.91 4.68 9.9 71.3\n", "one number"),
]
VIEWER, SOUND_PDDX = pddx(places()), pddx(places(), viewer=False)
TEXTS = [
    ("a.f25", f25(places(), "25US"), r"line 2: expected units SI \(25SI\), got '25US'"),
    ("b.f25", "5001,25.60,1\r\n", "a line 5020 with plate and sensors"),
    ("c.f25", f25([]), "drops with a load and deflections"),
    ("d.f25", "5001,25.60,1\r\n   1,   700, 400.0\r\n", "5020 and 5301 before the first drop"),
    ("a.pdx", SOUND_PDDX.replace("us = 150", "us = 0.15"), "20 to 1000 mm, got 0.15 mm"),
    ("b.pdx", SOUND_PDDX.replace("kilo-N", "stone"), "LoadUnits: one of kilo-newton.*'stone"),
    ("c.pdx", SOUND_PDDX.replace("_0 = ", "_0 = 1,", 1), "line 31: expected 11 .*, got 12"),
    ("d.pdx", SOUND_PDDX.replace("_0 = ", "_0 = x", 1), "a load and deflections, got 'x"),
    ("e.pdx", SOUND_PDDX.replace("YAxisDistances = 0", "YAxisDistances = 5"), "one line"),
]
ROWS_WITH = "0.003,1.0"
TABLES = [
    ("", "rows of numbers, got the end of the file"),
    ("1,2\n", "line 1: expected at least 3 columns, got 2"),
    (ROWS.replace(ROWS_WITH, "0.003,x"), "line 4: expected a number, got 'x'"),
    (ROWS.replace(ROWS_WITH, "0.003,1_0"), "line 4: expected a number, got '1_0'"),
    (ROWS.replace(ROWS_WITH, "0.003,nan"), "finite numbers in the load, got nan as sample 4"),
    (ROWS.replace("0.003,", "0.009,"), "even, growing time steps"),
    ("\n".join(ROWS.splitlines()[:9]), "at least 16 samples, got 9"),
    ("a\0b\n", "a line of text, got binary data"),
    ("Zeit Ü\n", r"declare text.encoding in .*column_map.toml"),
]
NOISE = np.random.default_rng(1).bytes(3000)
WRONG = [
    *((Sample(f"noise{suffix}", NOISE), "expected") for suffix in foreign_suffixes()),
    *((Sample(name, data), message) for name, data, message in ARCHIVES),
    *((Sample("a.thy", data, header), message) for data, header, message in HISTORIES),
    *((Sample("a.DAT", text.encode(), SENSOR_OFFSETS), message) for text, message in STATIONS),
    *((Sample(name, text.encode(), ""), message) for name, text, message in TEXTS),
    *((Sample("a.csv", t.encode("cp1252"), column_map=SIMPLE_MAP), m) for t, m in TABLES),
]


@pytest.mark.parametrize(("sample", "message"), WRONG, ids=[f"{s.name}: {m}" for s, m in WRONG])
def test_a_wrong_file_is_refused_on_one_line_that_names_it(
    sample: Sample, message: str, tmp_path: Path
) -> None:
    arguments = sample.write(tmp_path)
    with pytest.raises(SurveyError, match=message) as caught:
        read_points(**arguments)
    text = str(caught.value)
    assert text.startswith(arguments["path"])
    assert text.isprintable()
    assert len(text) < 600
