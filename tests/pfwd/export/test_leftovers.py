"""What a killed export leaves, and who takes it away."""

import errno
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from filelock import FileLock

from pfwd.errors import OptionError
from pfwd.export.export import export_survey
from pfwd.export.output import clear_leftovers, new_file, new_folder
from tests.tui.console import TOP

KILLED = """
import os, sys
from pathlib import Path
from pfwd.export import output
folder, kind, moment = Path(sys.argv[1]), sys.argv[2], sys.argv[3]
replace = os.replace
def stop_at(source, target):
    replace(source, target)
    if str(target).endswith(".old"):
        print("there", flush=True)
        sys.stdin.read()
if moment == "replacing":
    output.os.replace = stop_at
opened = (
    output.new_folder(folder / "out", ".csv", force=True) if kind == "folder"
    else output.new_file(folder / "out", force=True)
)
with opened as draft:
    if kind == "folder":
        (draft / "new.csv").write_text("half of it")
    else:
        draft.write_text("half of it")
    if moment == "writing":
        print("there", flush=True)
        sys.stdin.read()
"""


def started(folder: Path, kind: str, moment: str = "writing") -> "subprocess.Popen[str]":
    """A program that has come to this moment of an export and stays there."""
    program = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(folder), kind, moment],
        cwd=TOP,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert program.stdout is not None
    assert program.stdout.readline() == "there\n"
    return program


def end(program: "subprocess.Popen[str]") -> None:
    program.kill()
    program.communicate()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_what_a_killed_export_left_is_taken_away_by_the_next(kind: str, tmp_path: Path) -> None:
    end(started(tmp_path, kind))
    end(started(tmp_path, kind))
    assert [re.sub(r"[0-9a-f]{8}", "#", name) for name in names(tmp_path)].count("out.#.tmp") == 1
    with new_folder(tmp_path / "out", ".csv", force=False) as draft:
        (draft / "a.csv").write_text("whole")
    assert names(tmp_path) == ["out"]


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_what_somebody_is_writing_stays(kind: str, tmp_path: Path) -> None:
    program = started(tmp_path, kind)
    try:
        (draft,) = tmp_path.glob("out.*.tmp")
        with new_file(tmp_path / "out", force=False) as mine:
            mine.write_text("whole")
        assert draft.exists()
        assert (tmp_path / "out").read_text() == "whole"
    finally:
        end(program)
    with new_file(tmp_path / "out", force=True) as mine:
        mine.write_text("again")
    assert names(tmp_path) == ["out"]


def test_a_folder_that_was_about_to_be_replaced_is_put_back(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "old.csv").write_text("old")
    end(started(tmp_path, "folder", "replacing"))
    assert not (tmp_path / "out").exists()
    # Nobody said --force, so it is there again and stays.
    with (
        pytest.raises(OptionError, match="replace it with --force"),
        new_folder(tmp_path / "out", ".csv", force=False),
    ):
        pass
    assert names(tmp_path) == ["out"]
    assert (tmp_path / "out" / "old.csv").read_text() == "old"


def test_what_only_looks_alike_stays(tmp_path: Path) -> None:
    kept = ["out.123.tmp", "out.abcdef01.tmp", "outer.abcdef01.tmp", "outer.abcdef01.lock"]
    for name in kept:
        (tmp_path / name).write_text("mine")
    clear_leftovers(tmp_path / "out")
    assert names(tmp_path) == sorted(kept)


@pytest.mark.posix
def test_links_lead_nowhere(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "file").write_text("mine")
    (tmp_path / "out.00000001.lock").symlink_to(precious / "file")
    (tmp_path / "out.00000002.lock").write_text("")
    (tmp_path / "out.00000002.tmp").symlink_to(precious)
    (tmp_path / "out.00000002.old").symlink_to(precious)
    clear_leftovers(tmp_path / "out")
    assert (precious / "file").read_text() == "mine"
    assert names(tmp_path) == ["out.00000001.lock", "precious"]


def test_the_lock_of_the_dead_is_free_at_once(tmp_path: Path) -> None:
    program = started(tmp_path, "folder")
    (path,) = tmp_path.glob("out.*.lock")
    end(program)
    begun = time.monotonic()
    with FileLock(path, timeout=5):
        assert time.monotonic() - begun < 1


@pytest.mark.posix
@pytest.mark.filterwarnings("ignore:flock not supported")
@pytest.mark.parametrize("said_by", ["the system", "filelock"])
def test_a_disk_without_locks_takes_an_export_and_keeps_what_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said_by: str
) -> None:
    if said_by == "the system":

        def no_locks(*_: object) -> None:
            raise OSError(errno.ENOSYS, "Function not implemented")

        monkeypatch.setattr("fcntl.flock", no_locks)
    else:  # as it did in earlier versions

        def not_implemented(*_: object, **__: object) -> None:
            raise NotImplementedError

        monkeypatch.setattr(FileLock, "acquire", not_implemented)
    left = ["out.abcdef01.lock", "out.abcdef01.tmp"]
    for name in left:
        (tmp_path / name).write_text("somebody's")
    with new_file(tmp_path / "out", force=False) as draft:
        draft.write_text("all of it")
    assert (tmp_path / "out").read_text() == "all of it"
    assert names(tmp_path) == ["out", *left]
    assert (tmp_path / left[1]).read_text() == "somebody's"


def test_an_export_to_a_folder_leaves_nothing_beside_it(survey: Path, tmp_path: Path) -> None:
    place = tmp_path / "place"
    place.mkdir()
    export_survey(survey, "csv", place / "out")
    assert names(place) == ["out"]
    export_survey(survey, "csv", place / "out", force=True)
    export_survey(survey, "jsonl", place / "lines.jsonl")
    assert names(place) == ["lines.jsonl", "out"]
