"""What the promise of a recording cannot cover, done on purpose, and how it is noticed."""

import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.campaigns.below.command import DROPS, LONGEST, Command, look, own_places
from tests.campaigns.below.judge import ACKNOWLEDGED, WARNED, Outcome, judge

FIRST = 4
"""Drops before it happens."""


@dataclass(frozen=True, slots=True)
class Limit:
    """One way to lose what was acknowledged."""

    do: Callable[[Path, Path, np.random.Generator], None]
    """Given the survey, a copy of it from some drops ago, and chance."""
    killed: bool = False
    """The program is killed in the same moment."""
    afterwards: bool = False
    """It happens when the program has ended in order."""


@dataclass(frozen=True, slots=True)
class Met:
    """What came of it."""

    acknowledged: int
    lost: int
    """Drops that are nowhere after recovery."""
    said: bool
    """The program that recorded said NOT SAFE."""
    noticed: bool
    """Recovery or check, before or after it, did not call the survey whole."""


def _delete(survey: Path, _older: Path, _rng: np.random.Generator) -> None:
    while survey.exists():
        shutil.rmtree(survey, ignore_errors=True)


def _cut(survey: Path, _older: Path, rng: np.random.Generator) -> None:
    path = _segment(survey)
    os.truncate(path, int(path.stat().st_size * rng.uniform(0.2, 0.9)))


def _cut_all(survey: Path, older: Path, rng: np.random.Generator) -> None:
    """The journal is cut, and the drops' files are gone with it."""
    _cut(survey, older, rng)
    shutil.rmtree(survey / "drops", ignore_errors=True)


def _overwrite(survey: Path, _older: Path, rng: np.random.Generator) -> None:
    """Other bytes in the middle, the length as before."""
    path = _segment(survey)
    with path.open("r+b") as stream:
        stream.seek(int(path.stat().st_size * rng.uniform(0.2, 0.7)))
        stream.write(rng.bytes(2000))


def _overwrite_both(survey: Path, older: Path, rng: np.random.Generator) -> None:
    """The same, and the drops' files are gone."""
    _overwrite(survey, older, rng)
    for path in (survey / "drops").glob("*.h5"):
        path.unlink()


def _go_back(survey: Path, older: Path, _rng: np.random.Generator) -> None:
    """A backup of an earlier hour is put in place of all of it."""
    shutil.rmtree(survey)
    shutil.copytree(older, survey)


def _segment(survey: Path) -> Path:
    return sorted((survey / "journal").glob("*.pfwdj"))[-1]


LIMITS: Mapping[str, Limit] = {
    "survey deleted, program killed": Limit(_delete, killed=True),
    "journal cut, program killed": Limit(_cut, killed=True),
    "journal cut, drop files deleted, program killed": Limit(_cut_all, killed=True),
    "journal overwritten afterwards": Limit(_overwrite, afterwards=True),
    "journal overwritten, drop files deleted, afterwards": Limit(_overwrite_both, afterwards=True),
    "older copy of all afterwards": Limit(_go_back, afterwards=True),
}


def trial(url: str, folder: Path, name: str, seed: int) -> tuple[Met, str]:
    """One session that it happens to; what came of it, and everything that was said."""
    limit = LIMITS[name]
    rng = np.random.default_rng(seed)
    survey, older = folder / "survey", folder / "older"
    log = ["log", url, "-o", str(survey), "--no-invert", "--json"]
    command = Command(log, own_places(folder))
    command.wait_for(2, LONGEST)
    shutil.copytree(survey, older, ignore=shutil.ignore_patterns("*.tmp", "*.lock"))
    command.wait_for(FIRST, LONGEST)
    if limit.killed:
        command.kill()
        limit.do(survey, older, rng)
    elif not limit.afterwards:
        limit.do(survey, older, rng)
        command.wait_for(DROPS, LONGEST)
    command.stop()
    outcome = Outcome(status=command.wait(), killed=limit.killed, gone=True)
    if limit.afterwards:
        limit.do(survey, older, rng)
    check = Command(["check", str(survey), "--json"], own_places(folder))
    whole_before = check.wait() == 0
    outcome.said = command.said
    look(outcome, survey, folder)
    shutil.rmtree(folder)
    folder.mkdir()
    names = {said.name for said in command.said if said.what == ACKNOWLEDGED}
    met = Met(
        len(names),
        len(judge(outcome).lost),
        any(said.what == WARNED for said in command.said),
        not whole_before or max(outcome.later_statuses) != 0,
    )
    return met, command.text + check.text + outcome.output
