"""Sources of an archive: the files and surveys in folders, listed one at a time."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from pfwd.errors import OptionError, refusal
from pfwd.files.folders import SURVEY_FILE_SUFFIX, is_survey, is_survey_file
from pfwd.files.foreign.registry import foreign_suffixes
from pfwd.files.opening import survey_content

PFWD_SUFFIXES = (".csv", ".h5", SURVEY_FILE_SUFFIX)
"""Suffixes, in small letters, of this program's own files with drops."""

PIECE_DROPS = 500
"""Drops in a piece of a survey: half a minute of work, which an interruption loses."""

_CHUNK_BYTES = 1 << 20
_RECORD_FOLDERS = ("journal", "drops")
"""Folders of a survey with its recorded drops; other files in it do not change its content."""
_SURVEY_LEDGER = "acknowledged.txt"


@dataclass(frozen=True, slots=True)
class Source:
    """File or survey to be inverted, or a piece of a large survey: a range of its points."""

    path: str
    """Absolute path."""
    size: int
    """Size in bytes; for a survey the sum over its files."""
    mtime_ns: int
    """Time of the last change, ns since 1970; for a survey that of the file changed last."""
    survey: bool = False
    """True if the source is the folder of a survey."""
    digest: str = ""
    """SHA-256 of the content; empty: not computed yet."""
    piece: int = 0
    """Number of this piece of a survey, from 0."""
    pieces: int = 1
    """Number of pieces of the survey."""
    first_point: int = 0
    """Index of the first point in the piece."""
    end_point: int | None = None
    """Index after the last point in the piece; None: up to the last point of the survey."""

    @property
    def key(self) -> str:
        """Identity of content and piece; sources with the same key are inverted once."""
        return self.digest if self.pieces == 1 else f"{self.digest}:{self.piece}/{self.pieces}"


def find_sources(paths: Sequence[str], leave_out: str | None = None) -> Iterator[Source]:
    """Yield the named files and surveys, and those in named folders, sorted by name.

    A file in a folder is a source if its suffix is one of this program or of a format that it
    imports; a file that is named itself always is. Links to folders are not followed.

    Parameters
    ----------
    paths : sequence of str
        Files, surveys and folders.
    leave_out : str, optional
        Folder that is skipped: the one for the results.

    Raises
    ------
    OptionError
        If one of `paths` does not exist.
    """
    refuse_missing(paths)
    skipped = None if leave_out is None else os.path.realpath(leave_out)
    suffixes = (*PFWD_SUFFIXES, *foreign_suffixes())
    for path in paths:
        absolute = os.path.abspath(path)
        if os.path.isdir(absolute):
            yield from _sources_below(absolute, skipped, suffixes)
        else:
            yield _file(absolute)


def refuse_missing(paths: Sequence[str]) -> None:
    """Raise an error for the first path that does not exist.

    Raises
    ------
    OptionError
    """
    for path in paths:
        if not os.path.exists(path):
            raise OptionError(refusal(path, "a file or folder", "nothing of that name"))


def _sources_below(folder: str, skipped: str | None, suffixes: tuple[str, ...]) -> Iterator[Source]:
    if skipped is not None and os.path.realpath(folder) == skipped:
        return
    if is_survey(folder):
        yield _survey(folder)
        return
    try:
        with os.scandir(folder) as listing:
            entries = sorted(listing, key=lambda entry: entry.name)
    except OSError:
        # Reading it as a file fails with the reason, which is stored like any other failure.
        yield Source(folder, -1, 0)
        return
    for entry in entries:
        if entry.is_dir(follow_symlinks=False):
            yield from _sources_below(entry.path, skipped, suffixes)
        elif entry.name.lower().endswith(suffixes):
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
    names = [_SURVEY_LEDGER]
    for part in _RECORD_FOLDERS:
        with contextlib.suppress(OSError):
            listing = sorted(os.listdir(os.path.join(folder, part)))
            names += [os.path.join(part, name) for name in listing]
    return names


def is_unchanged(source: Source) -> bool:
    """Return whether the file or survey still has the size and time that the source records."""
    now = _survey(source.path) if source.survey else _file(source.path)
    return (now.size, now.mtime_ns) == (source.size, source.mtime_ns)


def content_digest(source: Source) -> str:
    """Return the SHA-256 of the content of a source, in hexadecimal digits.

    Raises
    ------
    OSError
        If a file cannot be read.
    """
    if not source.survey:
        with open(source.path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    digest = hashlib.sha256()
    for name in _survey_files(source.path):
        path = os.path.join(source.path, name)
        if not os.path.isfile(path):
            continue
        digest.update(f"{name.replace(os.sep, '/')}\0{os.path.getsize(path)}\0".encode())
        with open(path, "rb") as stream:
            while chunk := stream.read(_CHUNK_BYTES):
                digest.update(chunk)
    return digest.hexdigest()


def pieces_of(source: Source) -> list[Source]:
    """Divide a survey into pieces of complete points, with about `PIECE_DROPS` drops each.

    Other sources, and a survey that cannot be read, are one piece: its inversion then reports the
    reason.
    """
    # Any error is reported later, by the inversion of the source.
    try:
        if not (source.survey or is_survey_file(source.path)):
            return [source]
        points = survey_content(source.path).points
    except Exception:
        return [source]
    ends, drops = [0], 0
    for number, point in enumerate(points, start=1):
        drops += len(point.drops)
        if drops >= PIECE_DROPS:
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
