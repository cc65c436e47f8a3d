"""Progress of long work on standard error: bars on a terminal, otherwise lines or nothing."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from tui.output import clean, say

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.progress import Progress, TaskID


MAX_PART_S = 3600.0
"""Longest time of a part of the work, s, that the estimate of the time left takes into account. The
default of rich, 30 s, is less than the diagnosis of a point with many sensors takes."""


class ProgressBars:
    """Context manager that shows one bar for each kind of work, with text, count and times."""

    def __init__(self) -> None:
        self.is_terminal = sys.stderr.isatty()
        self._last_line = ""
        self._display: Progress | None = None
        self._tasks: dict[str, TaskID] = {}

    def update(
        self,
        text: str,
        finished: int = 0,
        total: int | None = None,
        *,
        work: str = "",
        line: bool = False,
    ) -> None:
        """Show text and count of one kind of work.

        Parameters
        ----------
        text : str
        finished : int
            Number of finished parts.
        total : int, optional
            Number of all parts; None: the bar only shows that work goes on.
        work : str
            Kind of the work, which has a bar of its own.
        line : bool
            Without a terminal, True prints each new text as a line; False prints nothing.
        """
        if not self.is_terminal:
            if line and text != self._last_line:
                self._last_line = text
                say(text)
            return
        if self._display is None:
            self._display = _start_display()
        if work not in self._tasks:
            self._tasks[work] = self._display.add_task("", total=None, count="")
        self._display.update(
            self._tasks[work],
            description=clean(text),
            completed=finished,
            total=total,
            count="" if total is None else f"{finished}/{total}",
        )

    def clear(self) -> None:
        """Remove the bars, so that lines can be printed."""
        if self._display is not None:
            self._display.stop()
        self._display = None
        self._tasks.clear()

    def __enter__(self) -> "ProgressBars":
        return self

    def __exit__(self, *exception: object) -> None:
        self.clear()


def _start_display() -> "Progress":
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    display = Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.fields[count]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        speed_estimate_period=MAX_PART_S,
        transient=True,
        redirect_stdout=False,  # results may go to a file
    )
    display.start()
    return display


@contextmanager
def diagnosis_progress() -> "Iterator[Callable[[str, str, int, int], None]]":
    """Yield a function that shows the progress of diagnoses.

    It is called with the kind of work, the name of the point, the number of finished parts and the
    number of all parts.
    """
    with ProgressBars() as bars:

        def update(work: str, point: str, finished: int, total: int) -> None:
            at_point = f": {os.path.basename(point)}" if point else ""
            bars.update(f"diagnosis, {work}{at_point}", finished, total, work=work)

        yield update


@contextmanager
def report_progress() -> "Iterator[Callable[[str], None]]":
    """Yield a function that shows sentences about the progress of a report.

    A sentence that begins with a blank is a detail of the one before.
    """
    with ProgressBars() as bars:
        heading = ""

        def update(text: str) -> None:
            nonlocal heading
            is_detail = text.startswith(" ")
            if not is_detail:
                heading = text
            elif bars.is_terminal:
                text = f"{heading}, {text.strip()}"
            bars.update(text, line=True)

        yield update
