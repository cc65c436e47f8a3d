"""`pfwd log` as a process whose lines are stored in their order, and the records of its survey."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pfwd_device.errors import RecordingError
from pfwd_device.recording import read_survey
from tests.campaigns.judge import ACKNOWLEDGED, WARNED, Outcome, Said, is_warning

DROPS = 7
"""Saved or refused, then the session is told to end."""

LONGEST = 60.0
"""s that a session of a few seconds may take on a busy machine."""

LAST_WORDS = 45.0
"""s that it may take to end when it was told to; one that waits for a publisher waits 30."""

_PFWD = "import sys; from tui.cli import main; sys.exit(main())"


class Command:
    """A running `pfwd`; what it says on both ways out comes in the order in which it was said.

    Parameters
    ----------
    arguments : list of str
    env : mapping
    before : sequence of str
        A program that starts it.
    """

    def __init__(
        self, arguments: list[str], env: Mapping[str, str], before: Sequence[str] = ()
    ) -> None:
        self.said: list[Said] = []
        self.tell: Callable[[Said], None] = self.said.append
        """Who else is told; by default it is kept here."""
        self.lines: list[str] = []
        self.dealt_with: set[str] = set()
        """Drops that were acknowledged, or named as not saved."""
        self._news = threading.Condition()
        self._process = subprocess.Popen(
            [*before, sys.executable, "-c", _PFWD, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            env=dict(env),
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._news:
                self._take(line.rstrip("\n"))
                self._news.notify_all()
        with self._news:
            self._news.notify_all()

    def _take(self, line: str) -> None:
        self.lines.append(line)
        drop: Any = None
        if line.startswith("{"):
            with contextlib.suppress(ValueError):  # the line that a kill cut in two
                drop = json.loads(line)
        # A second line of a drop says that it has no file of its own, and acknowledges nothing.
        if isinstance(drop, dict) and drop.get("saved") is True and "published" not in drop:
            name = f"drop {drop['point']}/{drop['drop']}"
            self.tell(Said(ACKNOWLEDGED, name))
            self.dealt_with.add(name)
        elif is_warning(line):
            self.tell(Said(WARNED, line))
        elif "NOT SAFE yet" in line:
            self.dealt_with.add(line.split(" is ")[0])

    def note(self, said: Said) -> None:
        """Put something between what it said until now and what it will say."""
        with self._news:
            self.said.append(said)

    def wait_for(self, drops: int, longest: float) -> bool:
        """Whether so many drops were dealt with before the process ended or the time was over."""
        until = time.monotonic() + longest
        with self._news:
            while len(self.dealt_with) < drops and self._reader.is_alive():
                if time.monotonic() > until:
                    return False
                self._news.wait(0.1)
            return len(self.dealt_with) >= drops

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def stop(self) -> None:
        """Tell it to end."""
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()

    def wait(self, longest: float = LAST_WORDS) -> int | None:
        """Exit status, None when it had to be killed."""
        status: int | None
        try:
            status = self._process.wait(longest)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            status = None
        self._reader.join(10.0)  # a publisher that lives on may hold the pipe
        return status

    @property
    def text(self) -> str:
        """Everything it said."""
        return "\n".join(self.lines) + "\n"


def own_places(folder: Path) -> dict[str, str]:
    """The environment with the platform's data folder, and so unsafe drops, below a folder."""
    here = {key: value for key, value in os.environ.items() if key != "PFWD_SPARE"}
    return {**here, "XDG_DATA_HOME": str(folder / "data")}


def look(outcome: Outcome, survey: Path, folder: Path) -> None:
    """Recover and check a survey by the commands, and read what is there and in second places."""
    env = own_places(folder)
    statuses = []
    for name in ("recover", "check"):
        command = Command([name, str(survey), "--json"], env)
        status = command.wait()
        statuses.append(-1 if status is None else status)
        outcome.output += f"--- {name}: {status}\n{command.text}"
    outcome.later_statuses = tuple(statuses)
    outcome.whole = statuses[1] == 0
    try:
        outcome.found = found_names(survey)
    except RecordingError as err:
        outcome.refusal, outcome.whole = str(err), None
    add_other_surveys(outcome.found, folder / "data")


def found_names(folder: Path) -> list[str]:
    """Return the name of each drop of a survey, for example ``drop 1/3``.

    Raises
    ------
    RecordingError
        If there is no survey, or a drop of it cannot be read.
    """
    names = []
    for drop in read_survey(folder).drops:
        drop.read()
        names.append(f"drop {drop.point}/{drop.drop}")
    return names


def add_other_surveys(names: list[str], folder: Path) -> None:
    """Add the names of drops that are only in surveys, or parts of surveys, below a folder."""
    for place in sorted({path.parent for path in folder.rglob("journal") if path.is_dir()}):
        with contextlib.suppress(RecordingError):  # drops that cannot be read are not found
            names += [name for name in found_names(place) if name not in names]
