"""Verdicts and replacements of the campaign of replaced files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.campaigns import replaced_files
from tests.campaigns.judge import ACKNOWLEDGED, REPLACED, WARNED, Event, Outcome, judge


def saved(*numbers: int) -> list[Event]:
    return [Event(ACKNOWLEDGED, f"drop 1/{number}") for number in numbers]


def names(*numbers: int) -> list[str]:
    return [f"drop 1/{number}" for number in numbers]


WARNING = Event(WARNED, "NOT SAFE: drop 1/1")
REPLACEMENT = Event(REPLACED, "")
SAVED_1 = Outcome(events=saved(1), recovered=names(1))


@pytest.mark.parametrize(
    ("outcome", "faults"),
    [
        (Outcome(events=saved(1, 2), recovered=names(1, 2), complete=True), ()),
        # Saved, and killed before the acknowledgement.
        (Outcome(events=saved(1), recovered=names(1, 2), complete=True), ()),
        (Outcome(events=saved(1, 2), recovered=names(2), complete=False), ("lost",)),
        (Outcome(events=[*saved(1), WARNING], complete=True), ("called complete",)),
        # A warning must precede the next drop.
        (Outcome(events=[*saved(1), WARNING, *saved(2)], recovered=names(2)), ()),
        (Outcome(events=[*saved(1, 2), WARNING], recovered=names(2)), ("lost",)),
        # After a replacement it may follow the drop in flight.
        (
            Outcome(
                events=[*saved(1, 2), REPLACEMENT, *saved(3), WARNING, *saved(4)],
                recovered=names(4),
            ),
            (),
        ),
        (
            Outcome(events=[*saved(1, 2), REPLACEMENT, *saved(3, 4), WARNING], recovered=names(4)),
            ("lost",),
        ),
        # Not so for drops that were acknowledged after the replacement.
        (
            Outcome(
                events=[*saved(1), REPLACEMENT, *saved(2, 3), WARNING, *saved(4)],
                recovered=names(1, 3, 4),
            ),
            ("lost",),
        ),
        (Outcome(events=[*saved(1, 2), REPLACEMENT], recovered=names(2)), ("lost",)),
        # A killed program cannot warn.
        (
            Outcome(events=[*saved(1, 2), REPLACEMENT], recovered=names(2), killed=True, status=-9),
            (),
        ),
        (replace(SAVED_1, recovered=names(1, 1)), ("twice",)),
        (replace(SAVED_1, complete=False), ("incomplete",)),
        (replace(SAVED_1, complete=False, removed=True), ()),
        (replace(SAVED_1, refusal="no survey"), ("unreadable",)),
        (replace(SAVED_1, refusal="no survey", removed=True), ()),
        (Outcome(refusal="no survey"), ()),
        (Outcome(status=None), ("hang",)),
        (Outcome(later_statuses=(0, -1)), ("hang",)),
        (Outcome(status=-11), ("status",)),
        (Outcome(later_statuses=(0, 4)), ("status",)),
        (Outcome(output="Traceback (most recent call last):\n  ...\nOSError"), ("traceback",)),
        (Outcome(output="pfwd: log: an error nobody foresaw, please"), ("traceback",)),
        (Outcome(events=[WARNING], harmless=True), ("warned without need",)),
    ],
)
def test_a_broken_promise_is_a_fault(outcome: Outcome, faults: tuple[str, ...]) -> None:
    assert judge(outcome).faults == faults


UNTESTED = {"second logger", *replaced_files.NEED_MOUNT}
"""Replacements that need a disk or an instrument."""


@pytest.mark.posix
@pytest.mark.parametrize("name", sorted(set(replaced_files.REPLACEMENTS) - UNTESTED))
def test_a_replacement_changes_the_survey(name: str, tmp_path: Path) -> None:
    survey = tmp_path / "work" / "survey"
    for path in ("journal/0001.pfwdj", "acknowledged.txt", "survey.lock", "drops/1.h5", "log/a"):
        (survey / path).parent.mkdir(parents=True, exist_ok=True)
        (survey / path).write_bytes(path.encode() * 20)
    older = tmp_path / "older"
    (older / "journal").mkdir(parents=True)
    (older / "journal" / "0001.pfwdj").write_bytes(b"old")
    rng = np.random.default_rng(0)
    scene = replaced_files.Scene(tmp_path, survey, older, rng, "no url")
    before = _state_of(survey)
    replaced_files.REPLACEMENTS[name].replace(scene)
    changed = _state_of(survey) != before
    for undo in scene.undo:
        undo()
    assert changed != replaced_files.REPLACEMENTS[name].harmless


def _state_of(folder: Path) -> object:
    paths = [folder.parent, folder, *sorted(folder.rglob("*"))] if folder.exists() else []
    states = [(path, path.stat(), _content(path)) for path in paths]
    return [(path, s.st_ino, s.st_size, s.st_mode, data) for path, s, data in states]


def _content(path: Path) -> bytes | None:
    try:
        return path.read_bytes() if path.is_file() else None
    except PermissionError:
        return None
