"""The ledger: one line of text per acknowledged record, so that what is lost is known by number.

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

from pfwd_device.recording.storage import Stamp, Storage
from pfwd_device.text import clean

LARGEST_LEDGER = 24 * 2**20
"""Bytes; ten times what a survey of 10,000 drops takes. A line takes ten times its length when
it is read, so that more would not fit into 500 MB; a larger file is none of ours."""

LONGEST_LINE = 4096

_LINE = re.compile(
    rb"(0|[1-9]\d{0,17}) (0|[1-9]\d{0,8}) (0|[1-9]\d{0,8}) (0|[1-9]\d{0,17}) (0|[1-9]\d{0,8}) "
    rb"([0-9a-f]{8}) ([!-~]{1,999}) ([0-9a-f]{8})"
)
"""Exactly what :meth:`Entry.line` writes: a number in another form is damage."""

_ABOUT = re.compile(r"(\d{1,9}):([^/\s]+)/(\d{1,18})", re.ASCII)
_HEAD = re.compile(r"pfwd-ledger 1 ([0-9a-f]{32}) ([0-9a-f]{8})", re.ASCII)


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
        """The line of the ledger, with its end."""
        text = (
            f"{self.sequence} {self.kind} {self.segment} {self.offset} {self.length} "
            f"{self.check:08x} {self.about}"
        )
        return _closed(text)


@dataclass(frozen=True, slots=True)
class LedgerText:
    """What is in a ledger."""

    survey: bytes | None
    """Identity of the survey; None when the first line is damaged."""
    entries: tuple[Entry, ...]
    """The lines that are whole."""
    damaged: tuple[int, ...]
    """Numbers of the lines that are not, from 1."""
    missing: bool = False
    """There is no ledger."""
    data: bytes | None = field(default=None, compare=False, repr=False)
    """Its bytes, where they are known to be exactly these lines."""


def head_line(survey: bytes) -> bytes:
    """First line of the ledger of a survey."""
    return _closed(f"pfwd-ledger 1 {survey.hex()}")


def about_drop(number: int, point: str, drop: int) -> str:
    """What the ledger says of a drop."""
    return f"{number}:{_quoted(point)}/{drop}"


@lru_cache(maxsize=4096)  # the same for all drops of a point
def _quoted(point: str) -> str:
    return quote(point, safe="")


def read_about(about: str) -> tuple[int, str, int] | None:
    """Survey-wide number, point and number within it; None when it is no drop."""
    match = _ABOUT.fullmatch(about)
    if match is None:
        return None
    return int(match[1]), _unquoted(match[2]), int(match[3])


@lru_cache(maxsize=4096)
def _unquoted(point: str) -> str:
    return clean(unquote(point))


def ledger_bytes(survey: bytes, entries: Iterable[Entry]) -> bytes:
    """A whole ledger."""
    return head_line(survey) + b"".join(entry.line() for entry in entries)


def read_ledger(path: Path) -> LedgerText:
    """The ledger at `path`; damage is told, never raised."""
    try:
        data = ledger_data(path)
    except FileNotFoundError:
        return LedgerText(None, (), (), missing=True)
    except OSError:
        data = None
    return LedgerText(None, (), (1,)) if data is None else parse_ledger(data)


def ledger_data(path: Path) -> bytes | None:
    """The bytes of a ledger; None: more than a ledger has. Raises OSError."""
    return None if os.path.getsize(path) > LARGEST_LEDGER else path.read_bytes()


def head_survey(line: bytes) -> bytes | None:
    """Identity of the survey in the first line, without its end; None when that is damaged."""
    head = _HEAD.fullmatch(_text(line))
    if head is None or head_line(bytes.fromhex(head[1])) != line + b"\n":
        return None
    return bytes.fromhex(head[1])


def parse_ledger(data: bytes) -> LedgerText:
    """What the bytes of a ledger say, whatever they are."""
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
    """Appends lines; after a failure the next one first puts a whole new ledger in place."""

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
        """The line of a failed append that the disk may hold, until the ledger is rewritten."""
        self._in_place = True

    def append(self, entry: Entry) -> None:
        """Return when the line is on the disk; on OSError the ledger is as it was, or redone."""
        if self._descriptor is None:
            self._reopen()
        assert self._descriptor is not None
        line = entry.line()
        if self._end + len(line) > LARGEST_LEDGER:  # what is not read again is not written
            raise OSError(errno.EFBIG, f"{self._path.name} is full: begin another survey")
        self.doubtful = entry
        try:
            # What others wrote since would be covered by the stamp of this write.
            known = self._storage.stamp(self._descriptor) == self._stamp
            self._storage.write_at(self._descriptor, line, self._end)
            stamp = self._storage.stamp_own_write(self._descriptor)
            self._stamp = stamp if known else None
        except OSError:
            self.doubtful = None  # a line in part is none
            self._cut()
            raise
        try:
            self._storage.sync(self._descriptor)
        except OSError:
            # What a failed sync leaves on the disk is not known, and a second one may lie.
            self.close()
            self._rewrite([*self._entries, entry])
        else:
            self._end += len(line)
        self._entries.append(entry)
        self.doubtful = None

    @property
    def entries(self) -> tuple[Entry, ...]:
        """What is acknowledged, in the order of the lines."""
        return tuple(self._entries)

    def problem(self) -> str | None:
        """Why others do not find in the ledger's place what was written; None: they do."""
        if self._descriptor is None:  # the next line puts a whole ledger in place
            return None
        why = self._storage.misplaced(self._descriptor, self._path, self._end)
        return why if why is not None else self._changed()

    def _changed(self) -> str | None:
        """Why the lines are not those that were written, though their length is the same."""
        assert self._descriptor is not None
        stamp = self._storage.stamp(self._descriptor)
        if stamp is not None and stamp == self._stamp:
            return None
        whole = ledger_bytes(self._survey, self._entries)
        try:
            there = self._storage.read_at(self._descriptor, self._end, 0)
        except OSError as err:
            return f"{self._path.name} cannot be read any more ({err.strerror or err})"
        if there != whole:
            return f"{self._path.name} was written over by another program"
        self._stamp = stamp
        return None

    def replace(self, entries: list[Entry]) -> None:
        """Put a whole ledger of these entries in place; raises OSError."""
        self.close()
        self._data = None
        self._rewrite(entries)
        self._entries = entries

    def close(self) -> None:
        """Give the descriptor back."""
        if self._descriptor is not None:
            descriptor, self._descriptor = self._descriptor, None
            with contextlib.suppress(OSError):  # every line in it was synced
                self._storage.close(descriptor)

    def forget(self, sequence: int) -> None:
        """Take no line of this number or later for written; the next one rewrites the ledger."""
        self.close()
        self._data = None
        while self._entries and self._entries[-1].sequence >= sequence:
            self._entries.pop()

    def _reopen(self) -> None:
        # What is known of the beginning holds until the first line is added.
        whole, self._data = self._data or ledger_bytes(self._survey, self._entries), None
        if not (self._in_place and self._holds(whole)):
            self._rewrite(self._entries)
        self._descriptor = self._storage.open(self._path)
        self._end = len(whole)
        self._stamp = None  # compared when it is looked at next

    def _holds(self, whole: bytes) -> bool:
        """Whether the file has these bytes; one of another size is not read."""
        there = self._path.exists() and self._path.stat().st_size == len(whole)
        return there and self._path.read_bytes() == whole

    def _rewrite(self, entries: list[Entry]) -> None:
        # Until its name is on the disk, an earlier ledger may come back, whatever can be read now.
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
    """Lines without their end; the last one, when it has no end, with a mark that spoils it."""
    *lines, rest = data.split(b"\n")
    yield from lines
    if rest:
        yield rest + b"\0"


def _text(line: bytes) -> str:
    return line.decode("latin-1") if len(line) <= LONGEST_LINE else ""


def _entry(line: bytes) -> Entry | None:
    match = _LINE.fullmatch(line) if len(line) <= LONGEST_LINE else None
    if match is None:
        return None
    sequence, kind, segment, offset, length, check, about, crc = match.groups()
    if zlib.crc32(line[: -len(crc) - 1]) != int(crc, 16):
        return None
    numbers = int(sequence), int(kind), int(segment), int(offset), int(length)
    return Entry(*numbers, int(check, 16), about.decode("ascii"))
