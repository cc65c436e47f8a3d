"""Right files with something changed in them: read or refused on one line, never anything else."""

import json
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fuzz.foreign_targets import read_or_refused
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

HEADER = b"plate_radius_m = 0.15\nsensor_offsets_m = [0.0]\n"
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
def test_the_file_that_is_changed_is_right(kind: str) -> None:
    assert is_read(kind, MAKERS[kind][0])


@pytest.mark.parametrize("kind", list(MAKERS))
@given(changes=CHANGES)
@settings(max_examples=150, deadline=None)
def test_a_changed_file_is_read_or_refused(
    kind: str, changes: list[tuple[float, int, bytes]]
) -> None:
    is_read(kind, changed(MAKERS[kind][0], changes))


def is_read(kind: str, part: bytes) -> bool:
    name, data, columns = MAKERS[kind][1](part)
    header = HEADER if kind == "thy" else None
    return read_or_refused(data, name, header=header, map_=columns)
