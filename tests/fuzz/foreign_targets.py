"""Targets that read other programs' files, and exported surveys."""

import json
import tempfile
from pathlib import Path

import numpy as np

from pfwd.errors import SurveyError
from pfwd.files.reading import read_points
from pfwd.peaks.basin import basin_of
from pfwd_device import Drop
from pfwd_device.signals import trace_peaks
from tests.fuzz.outside_targets import memory_folder
from tests.fuzz.targets import cuts, target
from tests.pfwd.files.foreign.builders import (
    acquired,
    dataset,
    pulse,
    stored,
    thy,
    viewed,
    zipped,
)
from tests.pfwd.files.foreign.peaks_builders import dynatest, f25, pddx, places, sweco

HEADER = b"plate_radius_m = 0.15\nsensor_offsets_m = [0.0, 0.3]\n"
CENTRE_ONLY = b"plate_radius_m = 0.15\nsensor_offsets_m = [0.0]\n"
MAP = b"""plate_radius_m = 0.15
[time]
column = 1
unit = "ms"
[load]
column = 2
unit = "kN"
[[sensor]]
column = 3
quantity = "displacement"
unit = "um"
offset_m = 0.0
[text]
names = false
"""
STORED = bytes.fromhex("01000000 0f") + b"ISAANSIMPLEFILE" + bytes.fromhex("5573938d 01000000")
XML = b'<MDDataSet xmlns="http://tempuri.org/MDDataSet.xsd">'
JILS = b"""Weight/spring: 3
Station: 1  Lane: 1  Milepost: 0.000
Drop # 1  Desired peak force: 9000.000
Time Force Disp1 Disp2
Impact: 0    Number_of_samples: 16
"""

DAT = b"""Weight/spring: 3
Operator: A. B.
1 1   0.000 1 10.05  5.83  4.91 71.3
Drop Sequence Completed Time: 08:36    Air Temp (F): 71.3
GPS: Quality : DGPS Fix   Latitude = 34 deg58.140780  N   Longitude = 89 deg49.0   W   PDOP = 0.00
Note: retest
"""
DROP = pulse(samples=20, pre=0.0005)
DROPS = {"1": [DROP, DROP]}
TRACES, DATA_SET = stored(DROPS["1"]), dataset(DROPS)
ACQUIRED, VIEWED = (json.dumps(make(DROPS)).encode() for make in (acquired, viewed))
THY = thy([(1, 1, DROP), (2, 1, DROP)])
TEXT = b"".join(b"%d,%d,%d\n" % (n, n % 7, n % 5) for n in range(40))
F25, SWECO, DYNATEST, PDDX = (make(places()).encode() for make in (f25, sweco, dynatest, pddx))

PIECES = (
    *(b"-1", b"0", b"1e999", b"NaN", b"null", b"{}", b"[]", b'""', b"<", b"]]>", b"&a;"),
    *(b"9" * 30, b"true", b"-", b",", b"\n", b"=", b"\0", b"\xff\xfe", b"\x7f\xff\xff\xff", b""),
)
"""Pieces with a meaning in one of the formats."""


def read_or_refused(
    data: bytes, name: str, *, header: bytes | None = None, map_: bytes | None = None
) -> bool:
    """Return True if a file is read completely, and False if it is refused in a line."""
    with tempfile.TemporaryDirectory(dir=memory_folder()) as folder:
        path, keys, columns = Path(folder) / name, Path(folder) / "h.toml", Path(folder) / "m.toml"
        path.write_bytes(data)
        if header is not None:
            keys.write_bytes(header)
        if map_ is not None:
            columns.write_bytes(map_)
        try:
            points = read_points(
                path,
                None if header is None else keys,
                column_map=None if map_ is None else columns,
            )
        except SurveyError as err:
            text = str(err)
            assert folder in text
            assert len(text.splitlines()) == 1
            assert len(text) < 2000
            return False
        assert points
        for point in points:
            assert point.setup.plate_radius > 0 or point.setup.is_stiffness_test
            assert point.setup.point is None or len(str(point.setup.point)) <= 64
            for drop in point.drops:
                if drop.only_peaks is not None:
                    _check_peaks(drop)
                assert np.isfinite(drop.load).all()
                assert (np.diff(drop.time) > 0).all()
                assert all(np.isfinite(channel.values).all() for channel in drop.channels)
                assert len({(c.quantity, c.offset) for c in drop.channels}) == len(drop.channels)
        return True


def _check_peaks(drop: Drop) -> None:
    """Check that all numbers are finite and that each sensor occurs once."""
    peaks = trace_peaks(drop)
    offsets = [offset for offset, _ in peaks.displacements]
    assert len(set(offsets)) == len(offsets) > 0
    assert np.isfinite([peaks.load, *offsets, *(peak for _, peak in peaks.displacements)]).all()
    basin_of(peaks, 0.15, 0.35)


def project(database: bytes = ACQUIRED, traces: bytes = TRACES) -> bytes:
    """A project with stored traces."""
    return zipped({"database.json": database, "rawdata/1": traces})


def changed(data: bytes, content: bytes) -> bytes:
    """Return content with up to four places replaced by a byte or a piece, as the data state."""
    for place, value, length, piece in zip(*(data[n:16:4] for n in range(4)), strict=False):
        at = (place * 251 + value) % (len(content) + 1)
        new = PIECES[piece % len(PIECES)] if piece < 200 else bytes([value])
        content = content[:at] + new + content[at + length % 12 :]
    return content


@target("foreign")
def archive_bytes(data: bytes) -> None:
    """Any bytes as a project, and behind the beginning of an archive."""
    read_or_refused(data, "a.dynz")
    read_or_refused(b"PK\x03\x04" + data, "a.bin")


@target("foreign")
def archive_changes(data: bytes) -> None:
    """A right archive with changes."""
    read_or_refused(changed(data, project()), "a.prjz")


@target("foreign")
def json_database(data: bytes) -> None:
    """Any bytes as a database, any values for its keys, and changes of databases."""
    keys = [b"ParamsAcqu", b"PVs", b"ParamsBearing", b"Calibrations", b"project"]
    text = (
        b"{" + b",".join(b'"%s": %s' % pair for pair in zip(keys, cuts(data), strict=False)) + b"}"
    )
    for database in (data, text, changed(data, ACQUIRED), changed(data, VIEWED)):
        read_or_refused(project(database), "a.prjz")


@target("foreign")
def stored_traces(data: bytes) -> None:
    """Any bytes as stored traces, and behind a right header, and changes of traces."""
    for member in (data, STORED + data, changed(data, TRACES)):
        read_or_refused(project(traces=member), "a.prjz")


@target("foreign")
def xml_database(data: bytes) -> None:
    """Any bytes as a data set, and within one, and changes of one."""
    for member in (data, XML + data, XML + data + b"</MDDataSet>", changed(data, DATA_SET)):
        read_or_refused(zipped({"database.xml": member}), "a.dynz")


@target("foreign")
def jils_file(data: bytes) -> None:
    """Any bytes as a time history, and as the rows of one, and changes of one."""
    rows = b"".join(b"%d.0 %d -%d 1\n" % (n, byte, byte) for n, byte in enumerate(data[:40]))
    for text in (data, JILS + data, JILS + rows):
        read_or_refused(text, "a.thy", header=HEADER)
    read_or_refused(changed(data, THY), "a.thy", header=CENTRE_ONLY)


@target("foreign")
def column_map(data: bytes) -> None:
    """Any bytes as a map, and as more keys of one, and changes of one."""
    for columns in (data, MAP + data, data + b"\n" + MAP, changed(data, MAP)):
        read_or_refused(TEXT, "a.txt", map_=columns)


@target("foreign")
def delimited_text(data: bytes) -> None:
    """Any bytes as a text, and as cells of one, and changes of one."""
    cells = [piece[:9].replace(b"\n", b" ") for piece in cuts(data)][:60]
    rows = b"".join(b"%d,%s,2\n" % (n, piece) for n, piece in enumerate(cells))
    for text in (data, rows, changed(data, TEXT)):
        read_or_refused(text, "a.txt", map_=MAP)


def _lines(data: bytes, head: bytes) -> bytes:
    """Return a valid head and lines of the bytes."""
    return head + b"".join(piece.replace(b"\n", b" ") + b"\r\n" for piece in cuts(data))


def _peaks_target(name: str, path: str, content: bytes, head: bytes = b"") -> None:
    def read_peaks(data: bytes) -> None:
        """Any bytes as a file of peaks, behind one, and changes of one."""
        read_or_refused(head + data, path)
        read_or_refused(head + data, path, header=HEADER)
        read_or_refused(changed(data, content), path)
        read_or_refused(_lines(data, content), path, header=HEADER)

    read_peaks.__name__ = name
    target("foreign")(read_peaks)


_peaks_target("f25_file", "a.f25", F25)
_peaks_target("dynatest_file", "a.fwd", DYNATEST)
_peaks_target("sweco_file", "a.fwd", SWECO, b"ROAD SYSTEM")
_peaks_target("pddx_file", "a.pdx", PDDX)


@target("foreign")
def jils_peaks_file(data: bytes) -> None:
    """Any bytes as a .DAT, and as its lines."""
    read_or_refused(data, "a.dat", header=HEADER)
    read_or_refused(_lines(data, DAT), "a.dat", header=HEADER)
    read_or_refused(changed(data, DAT), "a.dat", header=HEADER)


@target("foreign")
def hdf5_bytes(data: bytes) -> None:
    """Any bytes behind the signature of an HDF5 file."""
    read_or_refused(b"\x89HDF\r\n\x1a\n" + data, "a.h5")
