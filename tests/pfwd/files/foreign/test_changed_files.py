"""Right files with something changed in them: read or refused on one line, never anything else."""

import json
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfwd.errors import SurveyError
from pfwd.files.reading import read_points
from tests.pfwd.files.foreign.builders import (
    acquired,
    dataset,
    pulse,
    stored,
    thy,
    viewed,
    zipped,
)

DROPS = {"1": [pulse(samples=20, pre=0.0005), pulse(samples=20, pre=0.0005)]}
TRACES = stored(DROPS["1"])
ACQUIRED = json.dumps(acquired(DROPS)).encode()
VIEWED = json.dumps(viewed(DROPS)).encode()
TEXT = b"".join(b"%d,%d,%d\n" % (n, n % 7, n % 5) for n in range(40))
MAP = b"""plate_radius_m = 0.15
[text]
names = false
[time]
column = 1
unit = "ms"
[load]
column = 2
unit = "kN"
[[sensor]]
column = 3
quantity = "velocity"
unit = "mm/s"
offset_m = 0.0
"""

Made = tuple[str, bytes, bytes | None]
MAKERS: dict[str, tuple[bytes, Callable[[bytes], Made]]] = {
    "traces": (
        TRACES,
        lambda part: ("a.prjz", zipped({"database.json": ACQUIRED, "rawdata/1": part}), None),
    ),
    "acquired": (
        ACQUIRED,
        lambda part: ("a.prjz", zipped({"database.json": part, "rawdata/1": TRACES}), None),
    ),
    "viewed": (
        VIEWED,
        lambda part: ("a.mpvz", zipped({"database.json": part, "rawdata/1": TRACES}), None),
    ),
    "dataset": (dataset(DROPS), lambda part: ("a.dynz", zipped({"database.xml": part}), None)),
    "archive": (
        zipped({"database.json": ACQUIRED, "rawdata/1": TRACES}),
        lambda part: ("a.prjz", part, None),
    ),
    "thy": (
        thy([(1, 1, pulse(samples=20)), (2, 1, pulse(samples=20))]),
        lambda part: ("a.thy", part, None),
    ),
    "text": (TEXT, lambda part: ("a.txt", part, MAP)),
    "map": (MAP, lambda part: ("a.txt", TEXT, part)),
}

PIECES = st.one_of(
    st.binary(max_size=6),
    st.sampled_from(
        [b"-1", b"0", b"1e999", b"NaN", b"null", b"{}", b"[]", b'""', b"<", b"]]>", b"&a;"]
    ),
    st.sampled_from(
        [b"9" * 30, b"true", b"-", b",", b"\n", b"=", b"\0", b"\xff\xfe", b"\x7f\xff\xff\xff"]
    ),
)
CHANGES = st.lists(
    st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 12), PIECES), min_size=1, max_size=4
)


def changed(data: bytes, changes: list[tuple[float, int, bytes]]) -> bytes:
    for place, length, piece in changes:
        at = int(place * len(data))
        data = data[:at] + piece + data[at + length :]
    return data


@pytest.mark.parametrize("kind", list(MAKERS))
def test_the_file_that_is_changed_is_right(kind: str, tmp_path: Path) -> None:
    assert judged(kind, MAKERS[kind][0], tmp_path)


@pytest.mark.parametrize("kind", list(MAKERS))
@given(changes=CHANGES)
@settings(max_examples=150, deadline=None)
def test_a_changed_file_is_read_or_refused(
    kind: str, changes: list[tuple[float, int, bytes]]
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        judged(kind, changed(MAKERS[kind][0], changes), Path(folder))


def judged(kind: str, part: bytes, folder: Path) -> bool:
    """Whether the file is read; what is read is whole."""
    name, data, columns = MAKERS[kind][1](part)
    (folder / name).write_bytes(data)
    (folder / "h.toml").write_text("plate_radius_m = 0.15\nsensor_offsets_m = [0.0]\n")
    column_map = None
    if columns is not None:
        column_map = folder / "m.toml"
        column_map.write_bytes(columns)
    header = folder / "h.toml" if kind == "thy" else None
    points, refused = [], ""
    try:
        points = read_points(folder / name, header, column_map=column_map)
    except SurveyError as err:
        refused = str(err)
    assert points or str(folder) in refused
    assert len(refused.splitlines()) <= 1
    for point in points:
        assert point.setup.point is None or len(str(point.setup.point)) <= 64
        for drop in point.drops:
            assert np.isfinite(drop.load).all()
            assert (np.diff(drop.time) > 0).all()
            assert all(np.isfinite(channel.values).all() for channel in drop.channels)
    return not refused
