"""A byte stream in pieces: the same however the bytes were cut."""

import pytest

from pfwd_device.wire.dialect import LinkCounters
from pfwd_device.wire.pieces import Cutter

STREAM = b"ab;;cdefg;hi;" + 9 * b"x" + b";j;rest"
PIECES = [b"ab", b"", b"hi", b"j"]


@pytest.mark.parametrize("size", range(1, len(STREAM) + 1))
def test_it_does_not_matter_how_the_bytes_came(size: int) -> None:
    counters = LinkCounters()
    cutter = Cutter(b";", 4, counters)
    found = [
        piece
        for start in range(0, len(STREAM), size)
        for piece in cutter.feed(STREAM[start : start + size])
    ]
    assert found == PIECES
    assert counters.bytes_received == len(STREAM)
    assert counters.frames_damaged == 2
    assert counters.bytes_discarded == len(b"cdefg;") + len(b"xxxxxxxxx;")


def test_a_piece_as_long_as_allowed_is_one() -> None:
    counters = LinkCounters()
    assert Cutter(b"\n", 4, counters).feed(b"abcd\nabcde\n") == [b"abcd"]


def test_what_has_begun_is_forgotten_and_counted() -> None:
    counters = LinkCounters()
    cutter = Cutter(b";", 4, counters)
    assert cutter.feed(b"ab") == []
    cutter.reset()
    assert counters.bytes_discarded == 2
    assert cutter.feed(b"c;") == [b"c"]
