"""Thousands of faults under `SurveyWriter`: recorded, killed or closed, continued, recovered."""

import contextlib
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pfwd_device.errors import RecordingError
from pfwd_device.recording import SpareFolder, Storage, check, recover
from pfwd_device.recording.publishing import InlinePublisher
from tests.campaigns.below.finding import add_second_places, found_names
from tests.campaigns.below.judge import ACKNOWLEDGED, WARNED, Outcome, Said, is_warning
from tests.campaigns.below.planted import VARIABLE
from tests.campaigns.below.shim import Counted, Fault, environment, read_state

DROPS = 4
"""Recorded with faults."""

AFTER = 2
"""Recorded by a second program that continues the survey on a disk that works again."""

PLANS = ("close", "kill", "continue", "faulted recovery")
"""What comes after the faults: the end in order, a kill, a second program; or the survey is
recorded without a fault and killed, and its recovery meets them."""


class Driver:
    """A process on the library that answers requests; see :mod:`tests.campaigns.below.driver`."""

    def __init__(self, library: Path, planted: str = "") -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.campaigns.below.driver"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**environment(library, ""), VARIABLE: planted},
        )

    def ask(self, request: dict[str, Any]) -> int | None:
        """Exit status, None when it hung."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        status: int | None = json.loads(self._process.stdout.readline())["status"]
        return status

    def close(self) -> None:
        """End it."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


@contextlib.contextmanager
def driver(library: Path, planted: str = "") -> Iterator[Driver]:
    """A driver for as long as it is needed."""
    process = Driver(library, planted)
    try:
        yield process
    finally:
        process.close()


def trial(
    process: Driver, folder: Path, fault: Fault, plan: str, seed: int
) -> tuple[Outcome, Counted]:
    """One survey with one fault, and what is found of it; the folder is empty before and after."""
    survey, out = folder / "survey", folder / "out"
    state, log = folder / "state", folder / "fired"
    # Without a spare folder, with one, and with one that is on the same bad disk.
    spare = folder / "spare" if seed % 3 else None
    roots = (survey, spare) if spare is not None and seed % 3 == 2 else (survey,)
    armed = fault.text(roots, state, log)
    request = {"do": "record", "survey": str(survey), "out": str(out), "seed": seed}
    request |= {"spare": "" if spare is None else str(spare)}
    first = {**request, "first": 1, "drops": DROPS, "killed": plan in ("kill", "faulted recovery")}
    outcome = Outcome(killed=bool(first["killed"]))
    if plan == "faulted recovery":
        outcome.status = process.ask({**first, "fault": ""})
        again = process.ask({**request, "do": "recover", "fault": armed})
        outcome.later_statuses = (-1 if again is None else again,)
    else:
        outcome.status = process.ask({**first, "fault": armed})
    if plan == "continue":
        more = {**request, "first": DROPS + 1, "drops": AFTER, "killed": False}
        again = process.ask({**more, "fault": ""})
        outcome.later_statuses = (-1 if again is None else again,)
    _listen(outcome, out)
    _look(outcome, survey, SpareFolder(spare) if spare is not None else None)
    counted = read_state(state)
    shutil.rmtree(folder)
    folder.mkdir()
    return outcome, counted


def _listen(outcome: Outcome, out: Path) -> None:
    text = out.read_text() if out.exists() else ""
    for line in text.splitlines():
        said = json.loads(line)
        if said["what"] == "acknowledged":
            outcome.said.append(Said(ACKNOWLEDGED, said["name"]))
        elif is_warning(said["name"]):
            outcome.said.append(Said(WARNED, said["name"]))
        outcome.output += f"{said['what']}: {said['name']}\n"


def _look(outcome: Outcome, survey: Path, spare: SpareFolder | None) -> None:
    try:
        report = recover(survey, publisher=InlinePublisher(Storage()), spare=spare)
        outcome.output += "".join(
            f"recovery: {text}\n" for text in (*report.actions, *report.damaged)
        )
        outcome.found = found_names(survey, with_content=True)
        found = check(survey, spare=spare)
        outcome.whole = found.ok
        outcome.output += "".join(f"check: {text}\n" for text in found.damaged)
    except RecordingError as err:
        outcome.refusal = str(err)
    if spare is not None:
        add_second_places(outcome.found, spare.root, with_content=True)
