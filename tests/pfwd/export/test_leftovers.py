"""Files that a killed export leaves, and their removal."""

import errno
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pfwd.errors import OptionError
from pfwd.export.output import clear_leftovers, new_file, new_folder
from tests.records import known
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
    assert known(program.stdout).readline() == "there\n"
    return program


def end(program: "subprocess.Popen[str]") -> None:
    program.kill()
    program.communicate()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_files_of_a_killed_export_are_removed_by_the_next(kind: str, tmp_path: Path) -> None:
    end(started(tmp_path, kind))
    assert [re.sub(r"[0-9a-f]{8}", "#", name) for name in names(tmp_path)].count("out.#.tmp") == 1
    with new_folder(tmp_path / "out", ".csv", force=False) as draft:
        (draft / "a.csv").write_text("whole")
    assert names(tmp_path) == ["out"]


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_files_of_a_running_export_stay(kind: str, tmp_path: Path) -> None:
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


def test_files_with_similar_names_stay(tmp_path: Path) -> None:
    similar = ["out.123.tmp", "out.abcdef01.tmp", "outer.abcdef01.tmp", "outer.abcdef01.lock"]
    for name in similar:
        (tmp_path / name).write_text("mine")
    clear_leftovers(tmp_path / "out")
    assert names(tmp_path) == sorted(similar)


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


@pytest.mark.posix
@pytest.mark.filterwarnings("ignore:flock not supported")
def test_a_disk_without_locks_keeps_existing_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_locks(*_: object) -> None:
        raise OSError(errno.ENOSYS, "Function not implemented")

    monkeypatch.setattr("fcntl.flock", no_locks)
    leftovers = ["out.abcdef01.lock", "out.abcdef01.tmp"]
    for name in leftovers:
        (tmp_path / name).write_text("somebody's")
    with new_file(tmp_path / "out", force=False) as draft:
        draft.write_text("all of it")
    assert (tmp_path / "out").read_text() == "all of it"
    assert names(tmp_path) == ["out", *leftovers]
    assert (tmp_path / leftovers[1]).read_text() == "somebody's"
