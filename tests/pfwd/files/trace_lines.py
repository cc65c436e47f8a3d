"""Lines of a sound trace file, to be changed by tests."""

from collections.abc import Callable
from pathlib import Path

HEADER = ["# pfwd-traces = 1", "# plate_radius_m = 0.15"]
NAMES = "drop,time_s,load_N,displacement_m@0.0000"

Write = Callable[..., Path]
"""The fixture ``write``: takes lines or bytes and perhaps a name, gives the path."""


def rows(drop: int = 1, count: int = 20, step: float = 0.001) -> list[str]:
    return [f"{drop},{index * step:.6f},{100 * index},1e-6" for index in range(count)]
