"""Counts what Python does, so that work that grows with the square turns red without a clock."""

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any


def operations(action: Callable[[], object]) -> int:
    """Return the number of bytecode instructions of an action in this thread."""
    count = 0

    def trace(frame: FrameType, event: str, _argument: Any) -> Any:
        nonlocal count
        frame.f_trace_opcodes = True
        frame.f_trace_lines = False
        count += event == "opcode"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        action()
    finally:
        sys.settrace(before)
    return count


def growth(actions: Callable[[int], Callable[[], object]], size: int) -> float:
    """Cost of each thing more among four times as many, over its cost among the first ones.

    Parameters
    ----------
    actions : callable
        Gives the action for so many things; making it is not counted.
    size : int
    """
    first, second, eighth = (operations(actions(n)) for n in (size, 2 * size, 8 * size))
    return (eighth - second) / 6 / (second - first)
