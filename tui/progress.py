"""Progress on standard error, on a terminal only."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from tui.output import clean, say

if TYPE_CHECKING:
    from rich.progress import TaskID


@contextmanager
def building() -> Iterator[Callable[[str, float], None]]:
    """Yields the callable that a library tells about a surrogate it builds.

    On a terminal a bar; elsewhere one line a surrogate, because it may take some seconds the
    first time and silence would look like a hang.
    """
    if not sys.stderr.isatty():
        told: set[str] = set()

        def tell(what: str, fraction: float) -> None:
            if what not in told:
                told.add(what)
                say(f"building the response table once: {what}")

        yield tell
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    bar = Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    tasks: dict[str, int] = {}

    def draw(what: str, fraction: float) -> None:
        if what not in tasks:
            bar.start()
            tasks[what] = bar.add_task(f"building once: {clean(what)}", total=1.0)
        bar.update(tasks[what], completed=fraction)  # type: ignore[arg-type]

    try:
        yield draw
    finally:
        bar.stop()


@contextmanager
def counting(total: Callable[[], int]) -> Iterator[Callable[[int, str], None]]:
    """Yields the callable that is told how many are done, and what else there is to say.

    On a terminal a bar with the time that is left; elsewhere nothing is shown, nor counted.

    Parameters
    ----------
    total : callable
        Counts what there is; asked once, and only when it is shown.
    """
    if not sys.stderr.isatty():
        yield lambda done, text: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    with Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    ) as bar:
        task = bar.add_task("counting", total=None)
        bar.update(task, total=total())

        def show(done: int, text: str) -> None:
            bar.update(task, completed=done, description=clean(text))

        yield show


@contextmanager
def diagnosis_progress() -> Iterator[Callable[[str, str, int, int], None]]:
    """Yield the callable that receives what is tried, at which point, and how many are done.

    A terminal shows a bar for each kind of work, elsewhere nothing is shown.
    """
    if not sys.stderr.isatty():
        yield lambda what, point, done, total: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn())
    times = (TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, *times, console=Console(stderr=True), transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def draw(what: str, point: str, done: int, total: int) -> None:
            at_point = f": {os.path.basename(point)}" if point else ""
            text = clean(f"diagnosis, {what}{at_point}")
            if what not in tasks:
                tasks[what] = bar.add_task(text, total=total)
            bar.update(tasks[what], completed=done, total=total, description=text)

        yield draw


@contextmanager
def telling() -> Iterator[Callable[[str], None]]:
    """Yields the callable that a library tells what it does, a sentence each.

    On a terminal the last one stands on a line that goes away; elsewhere each is a line, so that a
    log says what was inverted.
    """
    if not sys.stderr.isatty():
        yield say
        return
    from rich.console import Console

    with Console(stderr=True).status("", spinner="line") as line:
        heading = ""

        def show(text: str) -> None:
            nonlocal heading
            if not text.startswith(" "):
                heading = text
            within = f", {text.strip()}" if text.startswith(" ") else ""
            from rich.markup import escape

            line.update(escape(clean(heading + within)))

        yield show
