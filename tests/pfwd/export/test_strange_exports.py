"""Exported surveys with things in them that this version does not know: the rest is imported."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import pytest

from pfwd.export.export import export_survey
from pfwd.files.importing import MAX_EDIT_CHARACTERS, Imported, import_files
from pfwd_device.errors import RecordingError
from pfwd_device.recording import SurveyWriter, check, read_survey
from pfwd_device.recording.drop_file import DIGEST
from pfwd_device.recording.hdf5_tree import (
    Dataset,
    Group,
    digest,
    opened,
    read_attributes,
    write_attributes,
    write_dataset,
)

Change = Callable[[dict[str, Any]], object]


def strange(survey: Path, path: Path, change: Change) -> Path:
    """The survey exported, with what is said in it changed and its digest right."""
    export_survey(survey, "h5", path)
    with h5py.File(path, "r+") as file:
        said = json.loads(file["survey"][()])
        change(said)
        text = json.dumps(said)
        del file["survey"]
        attributes = {
            "units": "JSON",
            "sha256": hashlib.sha256(text.encode("ascii")).hexdigest(),
        }
        write_dataset(file, "survey", Dataset(text, attributes))
    with opened(path) as file:
        known = read_attributes(file, str(path))
        known.pop(DIGEST)
        right = digest(Group({"survey": Dataset(text, attributes)}, known))
    with h5py.File(path, "r+") as file:
        del file.attrs[DIGEST]
        write_attributes(file, {DIGEST: right})
    return path


def imported(path: Path, folder: Path) -> tuple[list[Imported], list[str]]:
    """The drops, and the remarks; nothing was refused."""
    found = list(import_files([str(path)], folder))
    assert [one.error for one in found if one.error is not None] == []
    assert check(folder).ok
    return (
        [one for one in found if one.remark is None],
        [one.remark for one in found if one.remark is not None],
    )


def test_unknown_edits_are_left_out_and_said_once(survey: Path, tmp_path: Path) -> None:
    def change(said: dict[str, Any]) -> None:
        for number in range(50):
            edit = {"what": "colour", "value": number, "time_utc": "2026-01-01T00:00:00+00:00"}
            said["points"][0]["edits"].insert(0, edit)
            said["drops"][0]["edits"].insert(0, edit | {"what": "\x1b[31mred"})

    path = strange(survey, tmp_path / "strange.h5", change)
    drops, remarks = imported(path, tmp_path / "new")
    assert len(drops) == 4
    (remark,) = remarks
    assert "not imported: 100," in remark
    assert "edit 'colour' (50)" in remark
    assert r"edit '\x1b[31mred' (50)" in remark
    # What is known is there all the same, of points and of drops, and what comes after edits too.
    new = read_survey(tmp_path / "new")
    assert new.points[0].title == "north, end"
    assert new.points[0].target == 45e6
    assert [bool(drop.notes) for drop in new.drops] == [True, False, False, False]
    assert [drop.discarded for drop in new.drops] == [False, False, True, False]
    assert [event["event"] for event in new.events] == ["gap"]
    assert len(new.checks) == 1


def test_the_same_file_again_adds_nothing(survey: Path, tmp_path: Path) -> None:
    edit = {"what": "colour", "value": 1}
    path = strange(survey, tmp_path / "s.h5", lambda said: said["drops"][0]["edits"].append(edit))
    imported(path, tmp_path / "new")
    before = [dict(one) for one in read_survey(tmp_path / "new").points[0].edits]
    drops, remarks = imported(path, tmp_path / "new")
    assert all(one.before for one in drops)
    assert len(remarks) == 1
    assert [dict(one) for one in read_survey(tmp_path / "new").points[0].edits] == before


def test_many_kinds_are_one_line_of_bounded_length(survey: Path, tmp_path: Path) -> None:
    def change(said: dict[str, Any]) -> None:
        said["points"][0]["edits"] += [{"what": f"{n} " + "x" * 1000} for n in range(500)]

    _, (remark,) = imported(strange(survey, tmp_path / "s.h5", change), tmp_path / "new")
    assert "497 other kinds" in remark
    assert len(remark) < 1000


@pytest.mark.parametrize("name", ["events", "checks"])
@pytest.mark.parametrize("thing", ["text", 7, None, [1], {"event": "x", "details": "text"}])
def test_what_is_no_event_or_check_is_left_out(
    name: str, thing: Any, survey: Path, tmp_path: Path
) -> None:
    path = strange(survey, tmp_path / "s.h5", lambda said: said[name].insert(0, thing))
    drops, (remark,) = imported(path, tmp_path / "new")
    assert len(drops) == 4
    assert f"{name[:-1]} of unknown layout (1)" in remark
    assert len(read_survey(tmp_path / "new").checks) == 1


def test_an_edit_that_is_too_long_is_left_out(survey: Path, tmp_path: Path) -> None:
    too_long, longest = (
        "x" * (MAX_EDIT_CHARACTERS - 1),
        "x" * (MAX_EDIT_CHARACTERS - 2),
    )  # and the marks around

    def change(said: dict[str, Any]) -> None:
        said["points"][0]["edits"] += [
            {"what": "note", "value": too_long}, {"what": "note", "value": longest}
        ]  # fmt: skip

    _, (remark,) = imported(strange(survey, tmp_path / "s.h5", change), tmp_path / "new")
    assert "not imported: 1," in remark
    edits = read_survey(tmp_path / "new").points[0].edits
    assert sum(edit["value"] == longest for edit in edits) == 1
    # The limit is the survey's own.
    with (
        SurveyWriter.open(tmp_path / "new", publish=False) as writer,
        pytest.raises(RecordingError, match="expected at most"),
    ):
        writer.edit("note", too_long, point="A/1")


def test_the_command_says_it_and_is_done(
    survey: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from tui.cli import main

    edit = {"what": "colour", "value": 1}
    path = strange(survey, tmp_path / "s.h5", lambda said: said["drops"][0]["edits"].append(edit))
    assert main(["import", str(path), "-o", str(tmp_path / "new")]) == 0
    output = capsys.readouterr()
    lines = output.out.splitlines()
    assert lines[:2] == ["s.h5, point A/1: 3 drops saved", "s.h5, point CON: 1 drop saved"]
    assert lines[2].endswith("new: 4 drops at 2 points")
    assert output.err.count("\n") == 1
    assert "not imported: 1, namely edit 'colour' (1)" in output.err
