"""Paths of outputs: names that Windows does not permit, and files that another program has open."""

import builtins
import errno
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pfwd.errors import OptionError, SurveyError
from pfwd.export.output import new_text_file
from pfwd.files import output_path
from pfwd.files.output_path import refuse_bad_place, replaced_at_once, require_writable
from pfwd_device.recording import storage


class FakeWindows:
    """Functions of the system as Windows has them while another program has files open."""

    def __init__(self) -> None:
        self.blocked: dict[str, int] = {}
        """Number of attempts to replace a file that fail, by the file's path."""

    def module(self) -> SimpleNamespace:
        return SimpleNamespace(**{**vars(os), "name": "nt", "replace": self.replace})

    def open(self, path: Any, mode: str = "r", *_: Any, **more: Any) -> Any:
        if mode == "rb+" and self.blocked.get(os.fspath(path)):
            raise PermissionError(errno.EACCES, "Permission denied", os.fspath(path))
        return builtins.open(path, mode, **more)

    def replace(self, source: Any, target: Any) -> None:
        if self.blocked.get(os.fspath(target), 0) > 0:
            self.blocked[os.fspath(target)] -= 1
            raise PermissionError(errno.EACCES, "Access is denied", os.fspath(source))
        os.replace(source, target)


@pytest.fixture
def windows(monkeypatch: pytest.MonkeyPatch) -> FakeWindows:
    system = FakeWindows()
    for module in (output_path, storage):
        monkeypatch.setattr(module, "os", system.module())
    monkeypatch.setattr(output_path, "open", system.open, raising=False)
    monkeypatch.setattr(storage, "REPLACE_RETRY_S", 0.2)
    return system


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "table.csv"
    path.write_text("old", encoding="utf-8")
    return path


def test_an_output_that_another_program_has_open_is_refused_first(
    windows: FakeWindows, table: Path
) -> None:
    windows.blocked[str(table)] = 1
    with pytest.raises(OptionError, match=r"got open in another program; close it there or name"):
        require_writable(table, "--output")


def test_an_export_to_a_file_that_is_open_elsewhere_names_the_reason(
    windows: FakeWindows, table: Path
) -> None:
    windows.blocked[str(table)] = 10**6
    reason = r"table\.csv: expected a file to write, got open in another program; close it there"
    with pytest.raises(SurveyError, match=reason), new_text_file(table, force=True) as stream:
        stream.write("new")
    assert table.read_text(encoding="utf-8") == "old"
    assert [path.name for path in table.parent.iterdir()] == ["table.csv"]


def test_a_file_that_a_virus_scanner_reads_for_a_moment_is_replaced(
    windows: FakeWindows, table: Path
) -> None:
    windows.blocked[str(table)] = 3
    with replaced_at_once(table) as draft:
        draft.write_text("new", encoding="utf-8")
    assert table.read_text(encoding="utf-8") == "new"


def test_a_file_without_rights_is_not_said_to_be_open(
    windows: FakeWindows, table: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    windows.blocked[str(table)] = 10**6
    denied = {**vars(windows.module()), "access": lambda *_: False}
    monkeypatch.setattr(storage, "os", SimpleNamespace(**denied))
    with pytest.raises(PermissionError, match="Access is denied"), replaced_at_once(table) as draft:
        draft.write_text("new", encoding="utf-8")


@pytest.mark.usefixtures("windows")
@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("Ring road: km 12?", r"got : \?; leave it out"),
        ("points\t7", r"got '\\t'; leave it out"),
        ("con.csv", "got con.csv, which means a device"),
        ("COM3", "got COM3, which means a device"),
    ],
)
def test_what_windows_does_not_permit_in_a_name_is_named(
    tmp_path: Path, name: str, problem: str
) -> None:
    with pytest.raises(OptionError, match=f"a name that Windows permits, {problem}"):
        require_writable(tmp_path / name, "--output")
    for permitted in ("Straße km 12 (Süd) & Ost", "..", "a.b.csv", "console.csv"):
        refuse_bad_place(tmp_path / permitted, "--output")


@pytest.mark.posix
def test_other_systems_permit_these_names(tmp_path: Path) -> None:
    assert require_writable(tmp_path / "con: ?.csv", "--output").name == "con: ?.csv"
