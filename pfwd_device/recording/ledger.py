"""The ledger: one line of text for each acknowledged record, which identifies lost records.

A line is ``sequence kind segment offset length check about crc``, separated by single blanks;
``check`` is the CRC of the record's header, ``crc`` the CRC-32 of the line before it, both as eight
hexadecimal digits. ``about`` is ``-`` or for a drop ``number:point/drop`` with the point's name
percent-encoded. The first line names the format and the survey.
"""

import contextlib
import errno
import os
import re
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote, unquote

from pfwd_device.recording.storage import Stamp, Storage, has_content
from pfwd_device.text import clean

MAX_LEDGER_BYTES = 24 * 2**20
"""Largest ledger: ten times that of a survey of 10,000 drops. Reading takes ten times its size in
memory, so that a larger one would need more than 500 MB."""

MAX_LEDGER_LINE_BYTES = 4096

_LINE = re.compile(
    rb"(0|[1-9]\d{0,17}) (0|[1-9]\d{0,8}) (0|[1-9]\d{0,8}) (0|[1-9]\d{0,17}) (0|[1-9]\d{0,8}) "
    rb"([0-9a-f]{8}) ([!-~]{1,999}) ([0-9a-f]{8})"
)
"""Pattern of the lines that :meth:`Entry.line` writes: a number in another form is damage."""

_ABOUT = re.compile(r"(\d{1,9}):([^/\s]+)/(\d{1,18})", re.ASCII)
_FIRST_LINE = re.compile(r"pfwd-ledger 1 ([0-9a-f]{32}) ([0-9a-f]{8})", re.ASCII)


class Entry(NamedTuple):
    """One acknowledged record; a tuple, because a survey has many."""

    sequence: int
    kind: int
    segment: int
    offset: int
    length: int
    check: int
    about: str = "-"

    def line(self) -> bytes:
        """Return the line of the ledger, including its end."""
        text = (
            f"{self.sequence} {self.kind} {self.segment} {self.offset} {self.length} "
            f"{self.check:08x} {self.about}"
        )
        return _closed(text)


@dataclass(frozen=True, slots=True)
class LedgerText:
    """Content of a ledger."""

    survey: bytes | None
    """Identity of the survey; None if the first line is damaged."""
    entries: tuple[Entry, ...]
    """Undamaged lines."""
    damaged: tuple[int, ...]
    """Numbers of the damaged lines, from 1."""
    missing: bool = False
    """True if there is no ledger."""
    data: bytes | None = field(default=None, compare=False, repr=False)
    """Bytes of the ledger, if they are known to be exactly these lines."""


def head_line(survey: bytes) -> bytes:
    """Return the first line of the ledger of a survey."""
    return _closed(f"pfwd-ledger 1 {survey.hex()}")


def about_drop(number: int, point: str, drop: int) -> str:
    """Return the description of a drop in the ledger."""
    return f"{number}:{_quoted(point)}/{drop}"


@lru_cache(maxsize=4096)  # all drops of a point have the same name
def _quoted(point: str) -> str:
    return quote(point, safe="")


def read_about(about: str) -> tuple[int, str, int] | None:
    """Return survey-wide number, point and number within it; None if it is no drop."""
    match = _ABOUT.fullmatch(about)
    if match is None:
        return None
    return int(match[1]), _unquoted(match[2]), int(match[3])


@lru_cache(maxsize=4096)
def _unquoted(point: str) -> str:
    return clean(unquote(point))


def ledger_bytes(survey: bytes, entries: Iterable[Entry]) -> bytes:
    """Return the bytes of a complete ledger."""
    return head_line(survey) + b"".join(entry.line() for entry in entries)


def read_ledger(path: Path) -> LedgerText:
    """Read the ledger at `path`; damage is part of the result and never raised."""
    try:
        data = ledger_data(path)
    except FileNotFoundError:
        return LedgerText(None, (), (), missing=True)
    except OSError:
        data = None
    return LedgerText(None, (), (1,)) if data is None else parse_ledger(data)


def ledger_data(path: Path) -> bytes | None:
    """Return the bytes of a ledger, or None if the file is too large; raise OSError."""
    return None if os.path.getsize(path) > MAX_LEDGER_BYTES else path.read_bytes()


def head_survey(line: bytes) -> bytes | None:
    """Return the identity of the survey in the first line, without its end; None if damaged."""
    head = _FIRST_LINE.fullmatch(_text(line))
    if head is None or head_line(bytes.fromhex(head[1])) != line + b"\n":
        return None
    return bytes.fromhex(head[1])


def parse_ledger(data: bytes) -> LedgerText:
    """Parse the bytes of a ledger, with any damage."""
    survey = None
    entries: list[Entry] = []
    damaged: list[int] = []
    for number, line in enumerate(_lines(data), start=1):
        entry = _entry(line)
        if entry is not None:
            entries.append(entry)
            continue
        if number == 1:
            survey = head_survey(line)
        if number > 1 or survey is None:
            damaged.append(number)
    if not data:
        damaged.append(1)
    return LedgerText(survey, tuple(entries), tuple(damaged))


class LedgerWriter:
    """Writer that appends lines; after a failure it first writes a complete new ledger."""

    def __init__(
        self,
        path: Path,
        survey: bytes,
        entries: list[Entry],
        storage: Storage,
        data: bytes | None = None,
    ) -> None:
        self._path = path
        self._data = data
        self._survey = survey
        self._storage = storage
        self._entries = entries
        self._descriptor: int | None = None
        self._end = 0
        self._stamp: Stamp | None = None
        self.doubtful: Entry | None = None
        """Line of a failed append that may be on the disk until the ledger is rewritten."""
        self._in_place = True

    def append(self, entry: Entry) -> None:
        """Append a line and wait for the disk; on OSError the ledger is unchanged or rewritten."""
        if self._descriptor is None:
            self._reopen()
        assert self._descriptor is not None
        line = entry.line()
        if self._end + len(line) > MAX_LEDGER_BYTES:  # a larger ledger could not be read
            raise OSError(errno.EFBIG, f"{self._path.name} is full: begin another survey")
        self.doubtful = entry
        try:
            # The stamp of this write would hide earlier writes of other programs.
            unchanged = self._storage.stamp(self._descriptor) == self._stamp
            self._storage.write_at(self._descriptor, line, self._end)
            stamp = self._storage.stamp_after_write(self._descriptor)
            self._stamp = stamp if unchanged else None
        except OSError:
            self.doubtful = None  # an incomplete line does not count
            self._cut()
            raise
        try:
            self._storage.sync(self._descriptor)
        except OSError:
            # After a failed sync the disk is unknown, and a second sync may falsely succeed.
            self.close()
            self._rewrite([*self._entries, entry])
        else:
            self._end += len(line)
        self._entries.append(entry)
        self.doubtful = None

    @property
    def entries(self) -> tuple[Entry, ...]:
        """Acknowledged records, in the order of the lines."""
        return tuple(self._entries)

    def problem(self) -> str | None:
        """Return the difference between the written ledger and the file; None without one."""
        if self._descriptor is None:  # the next append writes a complete ledger
            return None
        why = self._storage.misplaced(self._descriptor, self._path, self._end)
        return why if why is not None else self._changed()

    def _changed(self) -> str | None:
        """Return the problem if the lines were changed at the same length; None otherwise."""
        assert self._descriptor is not None
        stamp = self._storage.stamp(self._descriptor)
        if stamp is not None and stamp == self._stamp:
            return None
        content = ledger_bytes(self._survey, self._entries)
        try:
            actual = self._storage.read_at(self._descriptor, self._end, 0)
        except OSError as err:
            return f"{self._path.name} cannot be read any more ({err.strerror or err})"
        if actual != content:
            return f"{self._path.name} was written over by another program"
        self._stamp = stamp
        return None

    def replace(self, entries: list[Entry]) -> None:
        """Write a complete ledger of these entries; raise OSError."""
        self.close()
        self._data = None
        self._rewrite(entries)
        self._entries = entries

    def close(self) -> None:
        """Close the file."""
        if self._descriptor is not None:
            descriptor, self._descriptor = self._descriptor, None
            with contextlib.suppress(OSError):  # all its lines were synced
                self._storage.close(descriptor)

    def forget(self, sequence: int) -> None:
        """Remove the lines from this number on; the next append rewrites the ledger."""
        self.close()
        self._data = None
        while self._entries and self._entries[-1].sequence >= sequence:
            self._entries.pop()

    def _reopen(self) -> None:
        # The bytes from the start of the program are valid until the first line is added.
        content, self._data = self._data or ledger_bytes(self._survey, self._entries), None
        if not (self._in_place and has_content(self._path, content)):
            self._rewrite(self._entries)
        self._descriptor = self._storage.open(self._path)
        self._end = len(content)
        self._stamp = None  # the next call of `problem` compares the content

    def _rewrite(self, entries: list[Entry]) -> None:
        # Until its name is on the disk, a power cut may bring back an earlier ledger.
        self._in_place = False
        self._storage.write_file(self._path, ledger_bytes(self._survey, entries))
        self._in_place = True
        self.doubtful = None

    def _cut(self) -> None:
        assert self._descriptor is not None
        try:
            self._storage.truncate(self._descriptor, self._end)
            self._stamp = None
        except OSError:
            self.close()


def _closed(text: str) -> bytes:
    data = text.encode("ascii")
    return data + b" %08x\n" % zlib.crc32(data)


def _lines(data: bytes) -> Iterator[bytes]:
    """Yield the lines without their ends; an unfinished last line is made invalid."""
    *lines, rest = data.split(b"\n")
    yield from lines
    if rest:
        yield rest + b"\0"


def _text(line: bytes) -> str:
    return line.decode("latin-1") if len(line) <= MAX_LEDGER_LINE_BYTES else ""


def _entry(line: bytes) -> Entry | None:
    match = _LINE.fullmatch(line) if len(line) <= MAX_LEDGER_LINE_BYTES else None
    if match is None:
        return None
    sequence, kind, segment, offset, length, check, about, crc = match.groups()
    if zlib.crc32(line[: -len(crc) - 1]) != int(crc, 16):
        return None
    numbers = int(sequence), int(kind), int(segment), int(offset), int(length)
    return Entry(*numbers, int(check, 16), about.decode("ascii"))
