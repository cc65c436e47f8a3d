"""Names of the files and folders of a survey."""

import os
import re
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pfwd_device.errors import RecordingError

ResultKind = Literal["drop", "trial", "diagnosis"]
"""Kind of a stored result, with which the name of its file begins: the result that counts for a
drop, a trial of its analysis with other settings, or a diagnosis of its point."""

FORMAT_VERSION = 2
"""Format version of a survey."""

_JUNCTION: int | None = getattr(stat, "IO_REPARSE_TAG_MOUNT_POINT", None)  # exists on Windows


@dataclass(frozen=True, slots=True)
class Layout:
    """Paths of the files of a survey within its folder."""

    folder: Path
    """Folder of the survey."""

    @property
    def journal(self) -> Path:
        """Folder of the journal, the files with all records."""
        return self.folder / "journal"

    @property
    def ledger(self) -> Path:
        """Text file with a line for each record that reached the disk."""
        return self.folder / "acknowledged.txt"

    @property
    def drops(self) -> Path:
        """Folder of the HDF5 files, one for each drop."""
        return self.folder / "drops"

    @property
    def results(self) -> Path:
        """Folder of the stored results of analyses."""
        return self.folder / "results"

    @property
    def captures(self) -> Path:
        """Folder of the raw captures, which contain every byte of a link."""
        return self.folder / "captures"

    @property
    def damaged(self) -> Path:
        """Folder to which recovery moves damaged and unfinished files."""
        return self.folder / "damaged"

    @property
    def reserve(self) -> Path:
        """File that reserves space, which is freed when the disk is full."""
        return self.folder / "reserve"

    @property
    def lock(self) -> Path:
        """Lock file, by which only one program writes the survey at a time."""
        return self.folder / "survey.lock"

    @property
    def publish_lock(self) -> Path:
        """Lock file, by which only one process makes the HDF5 files of drops at a time."""
        return self.folder / "publish.lock"

    @property
    def writer(self) -> Path:
        """Text file that names the program that writes the survey."""
        return self.folder / "writer.txt"

    @property
    def log(self) -> Path:
        """Folder of the log files of programs."""
        return self.folder / "log"

    @property
    def folders(self) -> tuple[Path, ...]:
        """Folders that are created in every survey."""
        return (self.journal, self.drops, self.results, self.captures, self.damaged)

    def segment(self, number: int) -> Path:
        """Return the file of the journal (segment) with a number."""
        return self.journal / f"{number:04d}.pfwdj"

    def drop_file(self, number: int) -> Path:
        """Return the HDF5 file of the drop with a survey-wide number."""
        return self.folder / self.drop_file_name(number)

    @staticmethod
    def drop_file_name(number: int) -> str:
        """Return the path within the survey of the HDF5 file of a drop, with ``/``."""
        return f"drops/drop-{number:06d}.h5"

    def result(self, number: int, count: int, kind: ResultKind) -> Path:
        """Return the file of a result.

        Parameters
        ----------
        number : int
            Survey-wide number of the drop.
        count : int
            Number of the result among those of this kind for the drop, from 1.
        kind : "drop", "trial" or "diagnosis"
        """
        return self.results / f"{kind}-{number:06d}-{count}.json"

    def segments(self) -> list[int]:
        """Return the sorted numbers of the existing files of the journal."""
        return sorted(_numbers(self.journal, r"(\d{4,})\.pfwdj"))

    def drop_files(self) -> list[int]:
        """Return the sorted survey-wide numbers of the drops with an HDF5 file."""
        return sorted(_numbers(self.drops, r"drop-(\d{6,})\.h5"))

    def relative(self, path: Path) -> str:
        """Return the path of a file within the survey, with ``/`` on every system."""
        return path.relative_to(self.folder).as_posix()

    def exists(self) -> bool:
        """Return True if the folder contains records or the HDF5 file of a drop."""
        return bool(self.ledger.exists() or self.segments() or self.drop_files())


def refuse_links(layout: Layout) -> None:
    """Raise an error if a part of a survey is a link, so that a write could leave its folder.

    The folder itself may be a link, because the user has named it.

    Raises
    ------
    RecordingError
        If a part of the survey is a link, a pipe or a device; the message names the first.
    """
    inner = (*layout.folders, layout.log)
    for folder in (layout.folder, *inner):
        for entry in _entries(folder):
            if entry.is_symlink() or _is_junction(entry):
                path = Path(entry.path)
                expected = "a folder" if path in inner else "a file"
                raise RecordingError(
                    f"{path}: expected {expected} of the survey, got a link; move the link away, "
                    "and copy its target to this place if it belongs to the survey"
                )
    refuse_special_files(layout)


def refuse_special_files(layout: Layout) -> None:
    """Raise an error if a survey contains named pipes or devices, whose reading may never end.

    Raises
    ------
    RecordingError
        If there is a pipe or a device; the message names the first.
    """
    for folder in (layout.folder, *layout.folders):
        for entry in _entries(folder):
            special = not (entry.is_file() or entry.is_dir() or entry.is_symlink())
            if special or (entry.is_symlink() and _leads_to_special(entry)):
                raise RecordingError(
                    f"{entry.path}: expected a file of the survey, got a named pipe or a device; "
                    "move it away"
                )


def no_survey(folder: Path) -> RecordingError:
    """Return the error to raise for a folder without a survey."""
    return RecordingError(
        f"{folder}: expected the folder of a survey, got no survey; check the path"
    )


def find_survey(folder: str | os.PathLike[str]) -> Layout:
    """Return the paths of the survey in a folder.

    Raises
    ------
    RecordingError
        If the folder contains no survey, or a pipe or a device.
    """
    layout = Layout(Path(folder).absolute())
    if not layout.exists():
        raise no_survey(layout.folder)
    refuse_special_files(layout)
    return layout


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
    """Return True for a junction, a link of Windows that Python does not report as a link."""
    if _JUNCTION is None:  # on other systems the test would only cost a system call
        return False
    return getattr(entry.stat(follow_symlinks=False), "st_reparse_tag", 0) == _JUNCTION


def names_in(folder: Path) -> list[str]:
    """Return the sorted names in a folder; an empty list if the folder cannot be read."""
    try:
        return sorted(os.listdir(folder))
    except OSError:
        return []


def _numbers(folder: Path, pattern: str) -> set[int]:
    matches = map(re.compile(pattern, re.ASCII).fullmatch, names_in(folder))
    return {int(match[1][:18]) for match in matches if match}
