"""Lines whose layout a setup file declares: numbers of samples, and lines without any."""

import numpy as np
import pytest

from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_device.wire.ascii_lines import AsciiDialect, LineLayout
from pfwd_device.wire.messages import SampleBlock
from pfwd_plugins.quantities import Measurand

IDENTITY = Identity(
    "7", "lines", "", 1000.0, 24, 2.5,
    (ChannelIdentity("load", Measurand.LOAD), ChannelIdentity("plate", Measurand.VELOCITY)),
)  # fmt: skip


def dialect_with(place: int | None, bits: int = 32) -> AsciiDialect:
    layout = LineLayout(separator=" ", place=place, time_unit=None, counter_bits=bits)
    return AsciiDialect(IDENTITY, (0, 1), layout=layout)


def samples(dialect: AsciiDialect, data: bytes) -> list[tuple[int, int, int]]:
    """Stream, index and first value of each sample."""
    return [
        (block.stream, block.first_sample + i, int(row[0]))
        for block in dialect.feed(data)
        if isinstance(block, SampleBlock)
        for i, row in enumerate(block.counts)
    ]


@pytest.mark.parametrize("bits", [8, 16, 31, 32])
def test_a_wrong_number_moves_no_sample(bits: int) -> None:
    rng = np.random.default_rng(bits)
    first = (1 << bits) - 150
    lines = [b"%d %d 5\n" % ((first + i) % (1 << bits), i) for i in range(300)]
    wrong = rng.choice(np.arange(2, 298, 5), 30, replace=False)
    for at in wrong:
        lines[at] = b"%d %d 5\n" % (rng.integers(1 << bits), at)
    received = samples(dialect_with(1, bits), b"".join(lines))
    assert {(stream, index - value) for stream, index, value in received} == {(0, 0)}
    assert len(received) >= 270


def test_lines_that_lost_their_end_are_discarded_with_any_separator() -> None:
    lines = [b"%d %d 5\n" % (i, i) for i in range(20)]
    data = b"".join(lines[:7]) + lines[7].replace(b"\n", b" ") + b"".join(lines[8:])
    values = [value for _, _, value in samples(dialect_with(1), data)]
    assert values == [*range(7), *range(9, 20)]


@pytest.mark.parametrize(("place", "bits", "streams"), [(1, 32, 1), (1, 16, 2), (None, 32, 2)])
def test_samples_behind_a_lost_connection_are_a_new_run_unless_counted(
    place: int | None, bits: int, streams: int
) -> None:
    dialect = dialect_with(place, bits)
    head = b"" if place is None else b"%d "
    lines = [(head % i if head else b"") + b"%d 5\n" % i for i in range(40)]
    received = samples(dialect, b"".join(lines[:20]))
    dialect.reset()
    received += samples(dialect, b"".join(lines[30:]))
    assert len({stream for stream, _, _ in received}) == streams
    if streams == 1:
        assert {index - value for _, index, value in received} == {0}
