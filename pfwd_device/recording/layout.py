"""Names of the files of a survey."""

import os
import re
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pfwd_device.errors import RecordingError

ResultKind = Literal["drop", "trial", "diagnosis"]
"""Kind of a stored result, with which the name of its file begins: the result of a drop, a trial
with other settings, or a diagnosis of its point."""

FORMAT_VERSION = 1

PEAKS_FORMAT_VERSION = 2
"""Format version of a survey with drops without traces, which programs of version 1 refuse. A
survey without such drops stays one of version 1."""

_JUNCTION: int | None = getattr(stat, "IO_REPARSE_TAG_MOUNT_POINT", None)  # exists on Windows


@dataclass(frozen=True, slots=True)
class Layout:
    """Paths of the files of a survey."""

    folder: Path

    @property
    def journal(self) -> Path:
        return self.folder / "journal"

    @property
    def ledger(self) -> Path:
        return self.folder / "acknowledged.txt"

    @property
    def drops(self) -> Path:
        return self.folder / "drops"

    @property
    def results(self) -> Path:
        return self.folder / "results"

    @property
    def captures(self) -> Path:
        return self.folder / "captures"

    @property
    def damaged(self) -> Path:
        return self.folder / "damaged"

    @property
    def reserve(self) -> Path:
        return self.folder / "reserve"

    @property
    def lock(self) -> Path:
        return self.folder / "survey.lock"

    @property
    def publish_lock(self) -> Path:
        return self.folder / "publish.lock"

    @property
    def writer(self) -> Path:
        return self.folder / "writer.txt"

    @property
    def log(self) -> Path:
        return self.folder / "log"

    @property
    def folders(self) -> tuple[Path, ...]:
        return (self.journal, self.drops, self.results, self.captures, self.damaged)

    def segment(self, number: int) -> Path:
        return self.journal / f"{number:04d}.pfwdj"

    def drop_file(self, number: int) -> Path:
        return self.folder / self.drop_file_name(number)

    @staticmethod
    def drop_file_name(number: int) -> str:
        """Return the path of a drop's file within the survey, as in records."""
        return f"drops/drop-{number:06d}.h5"

    def result(self, number: int, count: int, kind: ResultKind) -> Path:
        """Return the file of the ``count``-th result of a kind for a drop."""
        return self.results / f"{kind}-{number:06d}-{count}.json"

    def segments(self) -> list[int]:
        """Return the numbers of the existing segments of the journal."""
        return sorted(_numbers(self.journal, r"(\d{4,})\.pfwdj"))

    def drop_files(self) -> list[int]:
        """Return the survey-wide numbers of the drops with a file."""
        return sorted(_numbers(self.drops, r"drop-(\d{6,})\.h5"))

    def relative(self, path: Path) -> str:
        """Return the path within the survey as in records, with ``/`` on every system."""
        return path.relative_to(self.folder).as_posix()

    def exists(self) -> bool:
        """Return True if the folder contains any part of a survey."""
        return bool(self.ledger.exists() or self.segments() or self.drop_files())


def refuse_links(layout: Layout) -> None:
    """Refuse a survey with links in it, through which a write would leave its folder.

    The folder itself may be a link, as the user has named it.

    Raises
    ------
    RecordingError
        If a part of the survey is a link, or no file where a file belongs; the message names it.
    """
    inner = (*layout.folders, layout.log)
    for folder in (layout.folder, *inner):
        for entry in _entries(folder):
            if entry.is_symlink() or _is_junction(entry):
                path = Path(entry.path)
                expected = "a folder" if path in inner else "a file"
                raise RecordingError(
                    f"{path}: expected {expected} of the survey, got a link; move it away, and "
                    "put in its place what it leads to if that belongs to the survey"
                )
    refuse_special_files(layout)


def refuse_special_files(layout: Layout) -> None:
    """Refuse a survey with named pipes or devices in it, whose reading may never end.

    Raises
    ------
    RecordingError
        If there is one; the message names the first.
    """
    for folder in (layout.folder, *layout.folders):
        for entry in _entries(folder):
            special = not (entry.is_file() or entry.is_dir() or entry.is_symlink())
            if special or (entry.is_symlink() and _leads_to_special(entry)):
                raise RecordingError(
                    f"{entry.path}: expected a file of the survey, got something else (a named "
                    "pipe or a device); move it away"
                )


def _leads_to_special(entry: os.DirEntry[str]) -> bool:
    try:
        mode = entry.stat().st_mode
    except OSError:  # a link without a target
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _entries(folder: Path) -> list[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as iterator:
            return list(iterator)
    except OSError:
        return []


def _is_junction(entry: os.DirEntry[str]) -> bool:
    """Return True for a junction of Windows, which is no symbolic link."""
    if _JUNCTION is None:  # on other systems the test would only cost a system call
        return False
    return getattr(entry.stat(follow_symlinks=False), "st_reparse_tag", 0) == _JUNCTION


def names_in(folder: Path) -> list[str]:
    """Return the names in a folder, sorted; an empty list if it does not exist."""
    try:
        return sorted(os.listdir(folder))
    except OSError:
        return []


def _numbers(folder: Path, pattern: str) -> set[int]:
    matches = map(re.compile(pattern, re.ASCII).fullmatch, names_in(folder))
    return {int(match[1][:18]) for match in matches if match}
