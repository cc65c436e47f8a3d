"""Names of the files of a survey."""

import os
import re
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pfwd_device.errors import RecordingError

ResultKind = Literal["drop", "trial", "diagnosis"]
"""What is kept with a drop: its result, what somebody tried with other settings, or what was found
of its point. The names of the files begin with it."""

FORMAT_VERSION = 1

PEAKS_FORMAT_VERSION = 2
"""Of a survey with drops that have no traces. Programs that know version 1 alone refuse it, and say
that a newer one reads it; a survey without such drops stays one of version 1."""

_JUNCTION: int | None = getattr(stat, "IO_REPARSE_TAG_MOUNT_POINT", None)  # of Windows alone


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the files of a survey are."""

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
        """Path of a drop's file within the survey, as it is written down."""
        return f"drops/drop-{number:06d}.h5"

    def result(self, number: int, count: int, kind: ResultKind) -> Path:
        """File of the ``count``-th result of a kind that is kept with a drop."""
        return self.results / f"{kind}-{number:06d}-{count}.json"

    def segments(self) -> list[int]:
        """Numbers of the journal's segments that exist."""
        return sorted(_numbers(self.journal, r"(\d{4,})\.pfwdj"))

    def drop_files(self) -> list[int]:
        """Survey-wide numbers of the drops that have a file."""
        return sorted(_numbers(self.drops, r"drop-(\d{6,})\.h5"))

    def relative(self, path: Path) -> str:
        """Path within the survey as it is written down, with ``/`` on every system."""
        return path.relative_to(self.folder).as_posix()

    def exists(self) -> bool:
        """Whether anything of a survey is in the folder."""
        return bool(self.ledger.exists() or self.segments() or self.drop_files())


def refuse_links(layout: Layout) -> None:
    """Refuse a survey that leads out of its folder; nothing is written through a link in it.

    The folder itself may be reached by a link: that is the will of whoever named it.

    Raises
    ------
    RecordingError
        If something in the survey is a link, or no file where one belongs. Naming it.
    """
    inner = (*layout.folders, layout.log)
    for folder in (layout.folder, *inner):
        for entry in _entries(folder):
            if entry.is_symlink() or _is_junction(entry):
                path = Path(entry.path)
                expected = "a folder" if path in inner else "a file"
                raise RecordingError(
                    f"{path}: expected {expected} of the survey, got a link; take it away, and "
                    "put in its place what it leads to if that belongs to the survey"
                )
    refuse_special_files(layout)


def refuse_special_files(layout: Layout) -> None:
    """Refuse a survey that holds named pipes, devices and the like: reading them may never end.

    Raises
    ------
    RecordingError
        Naming the first.
    """
    for folder in (layout.folder, *layout.folders):
        for entry in _entries(folder):
            special = not (entry.is_file() or entry.is_dir() or entry.is_symlink())
            if special or (entry.is_symlink() and _leads_to_special(entry)):
                raise RecordingError(
                    f"{entry.path}: expected a file of the survey, got something else (a named "
                    "pipe or a device); take it away"
                )


def _leads_to_special(entry: os.DirEntry[str]) -> bool:
    try:
        mode = entry.stat().st_mode
    except OSError:  # it leads nowhere
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _entries(folder: Path) -> list[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as found:
            return list(found)
    except OSError:
        return []


def _is_junction(entry: os.DirEntry[str]) -> bool:
    """Whether it is a folder's link of Windows, which does not count as a symbolic one."""
    if _JUNCTION is None:  # elsewhere every look is a call to the system
        return False
    return getattr(entry.stat(follow_symlinks=False), "st_reparse_tag", 0) == _JUNCTION


def names_in(folder: Path) -> list[str]:
    """Names in a folder, sorted; none when it does not exist."""
    try:
        return sorted(os.listdir(folder))
    except OSError:
        return []


def _numbers(folder: Path, pattern: str) -> set[int]:
    matches = map(re.compile(pattern, re.ASCII).fullmatch, names_in(folder))
    return {int(match[1][:18]) for match in matches if match}
