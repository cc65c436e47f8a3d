"""Lines of a sound trace file, and the comparison of the drops of two files."""

from collections.abc import Callable, Sequence
from pathlib import Path

from pfwd_device import Drop

HEADER = ["# pfwd-traces = 1", "# plate_radius_m = 0.15"]
NAMES = "drop,time_s,load_N,displacement_m@0.0000"

Write = Callable[..., Path]
"""The fixture ``write``: takes lines or bytes and perhaps a name, gives the path."""


def rows(drop: int = 1, count: int = 20, step: float = 0.001) -> list[str]:
    return [f"{drop},{index * step:.6f},{100 * index},1e-6" for index in range(count)]


def assert_same_drops(drops: Sequence[Drop], expected: Sequence[Drop]) -> None:
    """Assert that two files have the same numbers of the same sensors in the same order."""
    for drop, expected_drop in zip(drops, expected, strict=True):
        assert drop.number == expected_drop.number
        assert drop.time.tobytes() == expected_drop.time.tobytes()
        assert drop.load.tobytes() == expected_drop.load.tobytes()
        for channel, other in zip(drop.channels, expected_drop.channels, strict=True):
            assert (channel.offset, channel.quantity) == (other.offset, other.quantity)
            assert channel.values.tobytes() == other.values.tobytes()
