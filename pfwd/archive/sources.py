"""What there is to invert: the surveys and files below folders, found one after the other."""

from __future__ import annotations

import hashlib
import itertools
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from pfwd.errors import OptionError, refusal
from pfwd.files.folders import is_survey
from pfwd.files.foreign.registry import foreign_suffixes
from pfwd.files.reading import survey_content
from pfwd.files.survey_file import is_survey_file

OWN_SUFFIXES = (".csv", ".h5", ".hdf5")
"""Ends of the names, in small letters, of this program's own files with drops."""

SURVEY_SLICE = 500
"""Drops of a survey that are inverted in one go: half a minute of work, lost when it is cut off."""

_CHUNK = 1 << 20
_RECORDED = ("journal", "drops")
"""Folders of a survey with what was measured; results and captures change nothing."""
_LEDGER = "acknowledged.txt"


@dataclass(frozen=True, slots=True)
class Source:
    """A file or survey to be inverted, or the points of a large survey that are one piece."""

    path: str
    """Absolute."""
    size: int
    """Bytes; of a survey those of all its files."""
    mtime_ns: int
    """When it was written last; of a survey the latest of its files."""
    survey: bool = False
    """Whether it is the folder of a survey."""
    digest: str = ""
    """SHA-256 of the content; empty: not computed."""
    piece: int = 0
    """Which piece of a survey, from 0."""
    pieces: int = 1
    """Pieces of the survey."""
    first_point: int = 0
    """First point of the piece, counted from 0."""
    end_point: int | None = None
    """The point behind the last; None: all."""

    @property
    def key(self) -> str:
        """What is inverted once: the content and the piece of it."""
        return self.digest if self.pieces == 1 else f"{self.digest}:{self.piece}/{self.pieces}"


def find_sources(paths: Sequence[str], leave_out: str | None = None) -> Iterator[Source]:
    """The sources that are named or lie below a folder, in the order of their names.

    A file in a folder counts when its name ends like those of this program or of a format that it
    imports; one that is named itself always does. Links to folders are not followed.

    Parameters
    ----------
    paths : sequence of str
        Files, surveys, folders.
    leave_out : str, optional
        A folder that is not looked into: where the results go.

    Raises
    ------
    OptionError
        If one of `paths` does not exist.
    """
    refuse_missing(paths)
    skipped = None if leave_out is None else os.path.realpath(leave_out)
    endings = (*OWN_SUFFIXES, *foreign_suffixes())
    for path in paths:
        whole = os.path.abspath(path)
        if os.path.isdir(whole):
            yield from _below(whole, skipped, endings)
        else:
            yield _file(whole)


def refuse_missing(paths: Sequence[str]) -> None:
    """Refuse what does not exist, before anything is begun.

    Raises
    ------
    OptionError
    """
    for path in paths:
        if not os.path.exists(path):
            raise OptionError(refusal(path, "a file or folder", "nothing of that name"))


def count_sources(paths: Sequence[str], leave_out: str | None = None) -> int:
    """How many sources :func:`find_sources` will find, as long as nothing changes."""
    return sum(1 for _ in find_sources(paths, leave_out))


def _below(folder: str, skipped: str | None, endings: tuple[str, ...]) -> Iterator[Source]:
    if skipped is not None and os.path.realpath(folder) == skipped:
        return
    if is_survey(folder):
        yield _survey(folder)
        return
    try:
        with os.scandir(folder) as listing:
            entries = sorted(listing, key=lambda entry: entry.name)
    except OSError:
        # Reading it as a file gives the reason, and the failure is kept like any other.
        yield Source(folder, -1, 0)
        return
    for entry in entries:
        if entry.is_dir(follow_symlinks=False):
            yield from _below(entry.path, skipped, endings)
        elif entry.name.lower().endswith(endings):
            yield _file(entry.path)


def _file(path: str) -> Source:
    try:
        status = os.stat(path)
    except OSError:
        return Source(path, -1, 0)
    return Source(path, status.st_size, status.st_mtime_ns)


def _survey(folder: str) -> Source:
    size = latest = 0
    for name in _survey_files(folder):
        try:
            status = os.stat(os.path.join(folder, name))
        except OSError:
            continue
        size, latest = size + status.st_size, max(latest, status.st_mtime_ns)
    return Source(folder, size, latest, survey=True)


def _survey_files(folder: str) -> list[str]:
    names = [_LEDGER]
    for part in _RECORDED:
        try:
            found = sorted(os.listdir(os.path.join(folder, part)))
        except OSError:
            continue
        names += [os.path.join(part, name) for name in found]
    return names


def unchanged(source: Source) -> bool:
    """Whether size and time are still those that were found."""
    now = _survey(source.path) if source.survey else _file(source.path)
    return (now.size, now.mtime_ns) == (source.size, source.mtime_ns)


def content_digest(source: Source) -> str:
    """SHA-256 of the content, as hexadecimal digits.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    if not source.survey:
        with open(source.path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    whole = hashlib.sha256()
    for name in _survey_files(source.path):
        path = os.path.join(source.path, name)
        if not os.path.isfile(path):
            continue
        whole.update(f"{name.replace(os.sep, '/')}\0{os.path.getsize(path)}\0".encode())
        with open(path, "rb") as stream:
            while chunk := stream.read(_CHUNK):
                whole.update(chunk)
    return whole.hexdigest()


def pieces_of(source: Source, largest: int = SURVEY_SLICE) -> list[Source]:
    """A survey in pieces of whole points, about `largest` drops each; anything else as it is.

    A survey that cannot be read stays whole: inverting it gives the reason.
    """
    # The survey's own errors, and those of a file that is no HDF5 although its name says so.
    try:
        if not (source.survey or is_survey_file(source.path)):
            return [source]
        points = survey_content(source.path).points
    except Exception:
        return [source]
    ends, drops = [0], 0
    for number, point in enumerate(points, start=1):
        drops += len(point.drops)
        if drops >= largest:
            ends.append(number)
            drops = 0
    if ends[-1] < len(points):
        ends.append(len(points))
    if len(ends) <= 2:
        return [source]
    bounds = list(itertools.pairwise(ends))
    return [
        replace(source, piece=n, pieces=len(bounds), first_point=first, end_point=end)
        for n, (first, end) in enumerate(bounds)
    ]
