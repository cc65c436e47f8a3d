"""The campaign of replaced files: its judge, and that each replacement changes the survey."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from tests.campaigns import replaced_files
from tests.campaigns.judge import ACKNOWLEDGED, REPLACED, WARNED, Outcome, Said, judge


def saved(*numbers: int) -> list[Said]:
    return [Said(ACKNOWLEDGED, f"drop 1/{number}") for number in numbers]


def names(*numbers: int) -> list[str]:
    return [f"drop 1/{number}" for number in numbers]


WARNING = Said(WARNED, "NOT SAFE: drop 1/1")
OTHERS = Said(REPLACED, "")


class TestJudge:
    def test_all_found_is_good(self) -> None:
        assert judge(Outcome(said=saved(1, 2), found=names(1, 2), whole=True)).good

    def test_more_found_than_acknowledged_is_good(self) -> None:
        # Saved, and killed before it was said.
        assert judge(Outcome(said=saved(1), found=names(1, 2), whole=True)).good

    def test_a_loss_without_a_word(self) -> None:
        verdict = judge(Outcome(said=saved(1, 2), found=names(2), whole=False))
        assert verdict.faults == ("lost",)
        assert verdict.lost == ("drop 1/1",)

    def test_a_loss_that_is_called_whole(self) -> None:
        verdict = judge(Outcome(said=[*saved(1), WARNING], found=[], whole=True))
        assert verdict.faults == ("called whole",)

    def test_a_note_counts_like_a_drop(self) -> None:
        said = [*saved(1), Said(ACKNOWLEDGED, "note 1")]
        assert judge(Outcome(said=said, found=names(1), whole=False)).lost == ("note 1",)

    def test_a_warning_has_to_come_before_the_next_drop(self) -> None:
        assert judge(Outcome(said=[*saved(1), WARNING, *saved(2)], found=names(2))).good
        late = Outcome(said=[*saved(1, 2), WARNING], found=names(2))
        assert judge(late).faults == ("lost",)

    def test_after_a_replacement_the_drop_in_flight_may_still_come(self) -> None:
        early = [*saved(1, 2), OTHERS, *saved(3), WARNING, *saved(4)]
        assert judge(Outcome(said=early, found=names(4))).good
        late = [*saved(1, 2), OTHERS, *saved(3, 4), WARNING]
        assert judge(Outcome(said=late, found=names(4))).faults == ("lost",)

    def test_what_was_acknowledged_after_a_replacement_has_no_such_grace(self) -> None:
        said = [*saved(1), OTHERS, *saved(2, 3), WARNING, *saved(4)]
        assert "drop 1/2" in judge(Outcome(said=said, found=names(1, 3, 4))).details[0]
        assert judge(Outcome(said=said, found=names(1, 2, 4))).good

    def test_the_end_of_the_program_is_time_enough_to_warn(self) -> None:
        said = [*saved(1, 2), OTHERS]
        assert judge(Outcome(said=said, found=names(2))).faults == ("lost",)
        assert judge(Outcome(said=said, found=names(2), killed=True, status=-9)).good

    def test_twice(self) -> None:
        assert judge(Outcome(said=saved(1), found=names(1, 1))).faults == ("twice",)

    def test_not_whole_although_nothing_is_missing(self) -> None:
        outcome = Outcome(said=saved(1), found=names(1), whole=False)
        assert judge(outcome).faults == ("not whole",)
        assert judge(dataclasses.replace(outcome, gone=True)).good

    def test_a_survey_that_cannot_be_read(self) -> None:
        outcome = Outcome(said=saved(1), found=names(1), refusal="no survey")
        assert judge(outcome).faults == ("unreadable",)
        assert judge(dataclasses.replace(outcome, gone=True)).good
        assert judge(Outcome(refusal="no survey")).good

    @pytest.mark.parametrize(
        ("outcome", "fault"),
        [
            (Outcome(status=None), "hang"),
            (Outcome(later_statuses=(0, -1)), "hang"),
            (Outcome(status=-11), "status"),
            (Outcome(later_statuses=(0, 4)), "status"),
            (Outcome(output="Traceback (most recent call last):\n  ...\nOSError: x"), "traceback"),
            (Outcome(output="pfwd: log: an error nobody foresaw, please"), "traceback"),
            (Outcome(output="escaped: OSError: x"), "escaped"),
            (Outcome(said=[WARNING], harmless=True), "warned without need"),
        ],
    )
    def test_how_a_program_may_not_end(self, outcome: Outcome, fault: str) -> None:
        assert judge(outcome).faults == (fault,)

    def test_a_kill_is_no_status_of_the_program(self) -> None:
        assert judge(Outcome(status=-9, killed=True)).good


OTHERS_NEEDED = {"second logger", *replaced_files.NEED_MOUNT}
"""These need a disk or an instrument; the campaign itself fails when they cannot be made."""


@pytest.mark.posix
@pytest.mark.parametrize("name", sorted(set(replaced_files.REPLACEMENTS) - OTHERS_NEEDED))
def test_a_replacement_can_be_made(name: str, tmp_path: Path) -> None:
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
    replaced_files.REPLACEMENTS[name].do(scene)
    changed = _state_of(survey) != before
    for undo in scene.undo:
        undo()
    assert changed != replaced_files.REPLACEMENTS[name].harmless


def _state_of(folder: Path) -> object:
    paths = [folder.parent, folder, *sorted(folder.rglob("*"))] if folder.exists() else []
    found = [(path, path.stat(), _content(path)) for path in paths]
    return [(path, said.st_ino, said.st_size, said.st_mode, data) for path, said, data in found]


def _content(path: Path) -> bytes | None:
    try:
        return path.read_bytes() if path.is_file() else None
    except PermissionError:
        return None
