"""`pfwd log` as a process whose lines are stored in their order, and the drops of its survey."""

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
from tests.campaigns.judge import ACKNOWLEDGED, WARNED, Event, Outcome, is_warning

N_DROPS = 7
"""Number of drops, saved or refused, after which the session is ended."""

MAX_SESSION_S = 60.0
"""Duration of a session of a few seconds on a busy machine, s."""

MAX_END_S = 45.0
"""Time for the end after a signal, s; a session that waits for a publisher waits 30 s."""

_PFWD = "import sys; from tui.cli import main; sys.exit(main())"
_LIMIT_FILES = "import resource as r; r.setrlimit(r.RLIMIT_FSIZE, ({0}, {0})); "


class Command:
    """A running `pfwd`, with its standard output and standard error in a common order.

    Parameters
    ----------
    arguments : list of str
    env : mapping, optional
        Environment; by default that of this process.
    before : sequence of str
        Command that starts the program.
    largest_file : int, optional
        Number of bytes beyond which no file can grow; not on Windows.
    """

    def __init__(
        self,
        arguments: list[str],
        env: Mapping[str, str] | None = None,
        before: Sequence[str] = (),
        largest_file: int | None = None,
    ) -> None:
        self.events: list[Event] = []
        self.report: Callable[[Event], None] = self.events.append
        """Function that receives the events; by default they are stored here."""
        self.lines: list[str] = []
        self.handled: set[str] = set()
        """Names of the drops that were acknowledged, or named as not saved."""
        self._changed = threading.Condition()
        is_limited = largest_file is not None and sys.platform != "win32"
        code = f"{_LIMIT_FILES.format(largest_file) if is_limited else ''}{_PFWD}"
        self._process = subprocess.Popen(
            [*before, sys.executable, "-c", code, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            env=None if env is None else dict(env),
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._changed:
                self._interpret(line.rstrip("\n"))
                self._changed.notify_all()
        with self._changed:
            self._changed.notify_all()

    def _interpret(self, line: str) -> None:
        self.lines.append(line)
        drop: Any = None
        if line.startswith("{"):
            with contextlib.suppress(ValueError):  # a line that a kill has cut
                drop = json.loads(line)
        # A second line of a drop states that it has no separate file, and acknowledges nothing.
        if isinstance(drop, dict) and drop.get("saved") is True and "published" not in drop:
            name = f"drop {drop['point']}/{drop['drop']}"
            self.report(Event(ACKNOWLEDGED, name))
            self.handled.add(name)
        elif is_warning(line):
            self.report(Event(WARNED, line))
        elif "NOT SAFE yet" in line:
            self.handled.add(line.split(" is ")[0])

    @property
    def acknowledged(self) -> set[str]:
        """Names of the acknowledged drops."""
        return {event.name for event in self.events if event.kind == ACKNOWLEDGED}

    def insert(self, event: Event) -> None:
        """Insert an event after those that the program has reported until now."""
        with self._changed:
            self.events.append(event)

    def wait_for(self, drops: int, timeout: float) -> bool:
        """Wait until a number of drops is handled; return False at the end or after a time (s)."""
        until = time.monotonic() + timeout
        with self._changed:
            while len(self.handled) < drops and self._reader.is_alive():
                if time.monotonic() > until:
                    return False
                self._changed.wait(0.1)
            return len(self.handled) >= drops

    @property
    def running(self) -> bool:
        """True until the process has ended."""
        return self._process.poll() is None

    def stop(self) -> None:
        """Request the end of the session."""
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Kill the process."""
        self._process.kill()

    def wait(self, timeout: float = MAX_END_S) -> int | None:
        """Wait for the end and return the exit status; None: it was killed after a time (s)."""
        status: int | None
        try:
            status = self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            status = None
        self._reader.join(10.0)  # a publisher that lives on may hold the pipe
        return status

    @property
    def text(self) -> str:
        """Text of all lines."""
        return "\n".join(self.lines) + "\n"


def log_command(url: str, survey: Path, *options: str) -> list[str]:
    """Return the arguments of `pfwd log` without inversion."""
    return ["log", url, "-o", str(survey), *options, "--no-invert", "--json"]


def separate_environment(folder: Path) -> dict[str, str]:
    """Return the environment with the data folder, and so the fallback records, in a folder."""
    inherited = {key: value for key, value in os.environ.items() if key != "PFWD_SPARE"}
    return {**inherited, "XDG_DATA_HOME": str(folder / "data")}


def recover_and_check(outcome: Outcome, survey: Path, folder: Path) -> None:
    """Recover and check a survey by the commands, and store its drops and fallback records."""
    env = separate_environment(folder)
    statuses = []
    for name in ("recover", "check"):
        command = Command([name, str(survey), "--json"], env)
        status = command.wait()
        statuses.append(-1 if status is None else status)
        outcome.output += f"--- {name}: {status}\n{command.text}"
    outcome.later_statuses += tuple(statuses)
    outcome.complete = statuses[1] == 0
    try:
        outcome.recovered = drop_names(survey)
    except RecordingError as err:
        outcome.refusal, outcome.complete = str(err), None
    add_other_surveys(outcome.recovered, folder / "data")


def drop_names(folder: Path) -> list[str]:
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
        with contextlib.suppress(RecordingError):  # drops that cannot be read do not count
            names += [name for name in drop_names(place) if name not in names]
