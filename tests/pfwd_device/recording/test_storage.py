"""How data reach the disk on macOS, whose fsync ends at the cache of the drive."""

import errno
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from pfwd.files.output_path import replaced_durably
from pfwd_device.recording import SurveyNotSafe, storage
from pfwd_device.recording.storage import OpenFile, Storage

FULL_SYNC = 51
"""Number of F_FULLFSYNC on macOS."""


class FakeMac:
    """Disk of macOS that counts the files and folders that were flushed to it."""

    def __init__(self) -> None:
        self.refusal: int | None = None
        """Number of the error of F_FULLFSYNC; None: it succeeds."""
        self.flushed: list[int] = []
        """Inodes of what reached the disk by F_FULLFSYNC."""
        self.synced: list[int] = []
        """Inodes of what reached the cache of the drive by fsync."""

    def fcntl(self, descriptor: int, command: int) -> None:
        assert command == FULL_SYNC
        if self.refusal is not None:
            raise OSError(self.refusal, os.strerror(self.refusal))
        self.flushed.append(os.fstat(descriptor).st_ino)

    def fsync(self, descriptor: int) -> None:
        self.synced.append(os.fstat(descriptor).st_ino)


@pytest.fixture
def mac(monkeypatch: pytest.MonkeyPatch) -> FakeMac:
    disk = FakeMac()
    fake_os = {name: value for name, value in vars(os).items() if name != "fdatasync"}
    monkeypatch.setattr(storage, "os", SimpleNamespace(**{**fake_os, "fsync": disk.fsync}))
    monkeypatch.setattr(storage, "sys", SimpleNamespace(platform="darwin"))
    monkeypatch.setitem(
        sys.modules, "fcntl", SimpleNamespace(F_FULLFSYNC=FULL_SYNC, fcntl=disk.fcntl)
    )
    return disk


@pytest.mark.posix
def test_a_file_and_its_name_reach_the_disk(mac: FakeMac, tmp_path: Path) -> None:
    path = tmp_path / "acknowledged.txt"
    Storage().write_file(path, b"1\n")
    assert mac.flushed == [path.stat().st_ino, tmp_path.stat().st_ino]
    assert mac.synced == []


@pytest.mark.posix
def test_a_photo_and_its_name_reach_the_disk(mac: FakeMac, tmp_path: Path) -> None:
    path = tmp_path / "photo.jpg"
    with replaced_durably(path) as draft:
        draft.write_bytes(b"photo")
    assert mac.flushed == [path.stat().st_ino, tmp_path.stat().st_ino]


@pytest.mark.posix
@pytest.mark.parametrize("number", [errno.ENOTSUP, errno.EINVAL, errno.ENOTTY])
def test_a_share_without_that_call_is_used(number: int, mac: FakeMac, tmp_path: Path) -> None:
    mac.refusal = number
    path = tmp_path / "acknowledged.txt"
    Storage().write_file(path, b"1\n")
    assert mac.synced == [path.stat().st_ino, tmp_path.stat().st_ino]


@pytest.mark.posix
def test_an_error_of_the_disk_is_not_taken_for_a_missing_call(mac: FakeMac, tmp_path: Path) -> None:
    mac.refusal = errno.EIO
    with pytest.raises(OSError, match="Input/output error"):
        Storage().write_file(tmp_path / "acknowledged.txt", b"1\n")


@pytest.mark.parametrize(
    ("drops", "lost", "text"),
    [
        (0, (), "further drops; pfwd recover moves them"),
        (4, (), "4 earlier drops and all further ones; pfwd recover moves them"),
        (
            0,
            tuple(f"drop 1/{n}" for n in range(1, 13)),
            "further drops; pfwd recover moves them. 12 records could not be read "
            f"({', '.join(f'drop 1/{n}' for n in range(1, 11))}, ...); pfwd recover restores drops "
            "that have a file",
        ),
    ],
)
def test_spare_folder_and_losses_are_named(drops: int, lost: tuple[str, ...], text: str) -> None:
    report = SurveyNotSafe("site 1: no space left", Path("spare"), drops, lost)
    assert report.text == f"NOT SAFE: site 1: no space left. Written to spare: {text}"


def test_without_a_spare_folder_the_reason_is_named() -> None:
    assert SurveyNotSafe("site 1: no space left").text == "NOT SAFE: site 1: no space left"


@pytest.mark.parametrize("has_times", [True, False])
def test_a_file_whose_times_are_known_and_equal_is_not_compared(
    has_times: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compared: list[str] = []
    disk, path = Storage(), tmp_path / "journal"
    if not has_times:
        monkeypatch.setattr(disk, "stamp", lambda descriptor: None)
    file = OpenFile(disk, path, disk.open(path, create=True))
    assert file.problem(lambda: compared.append("journal")) is None
    assert compared == ([] if has_times else ["journal"])
    file.close()
