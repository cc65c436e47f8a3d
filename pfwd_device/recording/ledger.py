"""The ledger of a survey, a text file that lists the records of its journal that reached the disk.

The journal contains the data; if it is damaged later, the ledger shows which records are lost. It
has a line for each record: ``sequence kind segment offset length check about crc``, separated by
single blanks. ``segment`` is the number of the file of the journal, ``check`` the CRC-32 in the
header of the record and ``crc`` the CRC-32 of the line before it, both as eight hexadecimal digits.
``about`` is ``-``, or for a drop ``number:point/drop`` with the name of the point percent-encoded.
The first line names the format and the survey.
"""

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

from pfwd_device.recording.framing import RecordKind
from pfwd_device.recording.storage import OpenFile, Storage, has_content
from pfwd_device.text import clean

MAX_LEDGER_BYTES = 24 * 2**20
"""Largest ledger, bytes: ten times that of a survey of 10,000 drops. Reading needs memory of ten to
twenty times its size."""

MAX_LEDGER_LINE_BYTES = 4096

_LINE = re.compile(
    rb"(0|[1-9]\d{0,17}) (0|[1-9]\d{0,8}) (0|[1-9]\d{0,8}) (0|[1-9]\d{0,17}) (0|[1-9]\d{0,8}) "
    rb"([0-9a-f]{8}) ([!-~]{1,999}) ([0-9a-f]{8})"
)
"""Pattern of the lines that :meth:`Entry.line` writes. Any other line counts as damaged."""

_ABOUT = re.compile(r"(\d{1,9}):([^/\s]+)/(\d{1,18})", re.ASCII)
_FIRST_LINE = re.compile(r"pfwd-ledger 1 ([0-9a-f]{32}) ([0-9a-f]{8})", re.ASCII)


class Entry(NamedTuple):
    """Line of the ledger (list of saved records): number, kind and place of one record."""

    sequence: int
    """Sequence number, from 1."""
    kind: int
    """One of `framing.Kind`."""
    segment: int
    """Number of the file of the journal."""
    offset: int
    """Position in the file, bytes."""
    length: int
    """Length of the record, bytes."""
    check: int
    """CRC-32 in the header of the record."""
    about: str = "-"
    """Numbers and point of a drop; "-" for any other record."""

    def line(self) -> bytes:
        """Return the line of the ledger for this record, with its checksum and line feed."""
        text = (
            f"{self.sequence} {self.kind} {self.segment} {self.offset} {self.length} "
            f"{self.check:08x} {self.about}"
        )
        return _closed(text)

    @property
    def drop(self) -> tuple[int, str, int] | None:
        """Survey-wide number, point and number within it of a drop; None: of another record."""
        match = _ABOUT.fullmatch(self.about) if self.kind == RecordKind.DROP else None
        return None if match is None else (int(match[1]), _unquoted(match[2]), int(match[3]))

    @property
    def name(self) -> str:
        """Name of the record for messages, such as "drop P 1/3" or "record 7 (event)"."""
        drop = self.drop
        if drop is not None:
            return f"drop {drop[1]}/{drop[2]}"
        try:
            kind = RecordKind(self.kind).name.lower()
        except ValueError:
            kind = f"type {self.kind}"
        return f"record {self.sequence} ({kind})"


@dataclass(frozen=True, slots=True)
class LedgerText:
    """Content of a ledger, the text file that lists the saved records of a survey."""

    survey: bytes | None
    """Identity of the survey; None if the first line is damaged."""
    entries: tuple[Entry, ...]
    """Records of the undamaged lines."""
    damaged: tuple[int, ...]
    """Numbers of the damaged lines, from 1."""
    missing: bool = False
    """True if the file does not exist."""
    unfinished: bool = False
    """True if the last line has no line feed, as while a program writes it."""
    data: bytes | None = field(default=None, compare=False, repr=False)
    """Bytes of the file if they consist of exactly these lines; None if unknown."""


def head_line(survey: bytes) -> bytes:
    """Return the first line of the ledger (list of saved records), with the survey's identity."""
    return _closed(f"pfwd-ledger 1 {survey.hex()}")


def about_drop(number: int, point: str, drop: int) -> str:
    """Return the text ``number:point/drop``, which describes a drop in the list of saved records.

    Parameters
    ----------
    number : int
        Survey-wide number.
    point : str
        Name of the test point.
    drop : int
        Number within the point.
    """
    return f"{number}:{_quoted(point)}/{drop}"


@lru_cache(maxsize=4096)  # all drops of a point have the same name
def _quoted(point: str) -> str:
    return quote(point, safe="")


@lru_cache(maxsize=4096)
def _unquoted(point: str) -> str:
    return clean(unquote(point))


def ledger_bytes(survey: bytes, entries: Iterable[Entry]) -> bytes:
    """Return the content of a ledger, the text file that lists these records as saved."""
    return head_line(survey) + b"".join(entry.line() for entry in entries)


def read_ledger(path: Path) -> LedgerText:
    """Read a ledger, the text file that lists the saved records of a survey.

    Damaged lines are part of the result and raise no error.
    """
    try:
        data = None if os.path.getsize(path) > MAX_LEDGER_BYTES else path.read_bytes()
    except FileNotFoundError:
        return LedgerText(None, (), (), missing=True)
    except OSError:
        data = None
    return LedgerText(None, (), (1,)) if data is None else parse_ledger(data)


def parse_ledger(data: bytes) -> LedgerText:
    """Parse the bytes of a ledger (list of saved records); damaged lines are part of the result."""
    survey = None
    entries: list[Entry] = []
    damaged: list[int] = []
    for number, line in enumerate(_lines(data), start=1):
        entry = _entry(line)
        if entry is not None:
            entries.append(entry)
            continue
        head = _FIRST_LINE.fullmatch(_text(line)) if number == 1 else None
        if head is not None and head_line(bytes.fromhex(head[1])) == line + b"\n":
            survey = bytes.fromhex(head[1])
        if number > 1 or survey is None:
            damaged.append(number)
    if not data:
        damaged.append(1)
    exact = survey is not None and not damaged
    return LedgerText(
        survey,
        tuple(entries),
        tuple(damaged),
        unfinished=not data.endswith(b"\n"),
        data=data if exact else None,
    )


class LedgerWriter:
    """Writer that appends lines to the ledger, the list of the saved records of a survey.

    After a failure the next append writes a complete new file first.

    Parameters
    ----------
    path : Path
        File of the ledger.
    survey : bytes
        Identity of the survey, 16 bytes.
    entries : list of Entry
        Records that the ledger lists; the writer appends to this list.
    storage : Storage
        Access to the files.
    data : bytes, optional
        Content of a ledger with these entries, so that it need not be formatted again.
    """

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
        self._file: OpenFile | None = None
        self.doubtful: Entry | None = None
        """Line of a failed append that may be on the disk until the ledger is rewritten."""
        self._in_place = True

    def append(self, entry: Entry) -> None:
        """Append the line of a saved record; return when the line is on the disk.

        Raises
        ------
        OSError
            If the disk fails or the ledger is too long; the record does not count then.
        """
        file = self._file if self._file is not None else self._reopen()
        line = entry.line()
        if file.end + len(line) > MAX_LEDGER_BYTES:  # a larger ledger could not be read
            raise OSError(errno.EFBIG, f"{self._path.name} is full: begin another survey")
        self.doubtful = entry
        try:
            file.write(line)
        except OSError:
            self.doubtful = None  # readers ignore an incomplete line
            try:
                file.cut()
            except OSError:
                self.close()
            raise
        try:
            self._storage.sync(file.descriptor)
        except OSError:
            # After a failed sync the state of the disk is unknown, and a second sync may report
            # success without having written the data.
            self.close()
            self._rewrite([*self._entries, entry])
        else:
            file.end += len(line)
        self._entries.append(entry)
        self.doubtful = None

    @property
    def entries(self) -> tuple[Entry, ...]:
        """Records that are listed as saved, in the order of the lines."""
        return tuple(self._entries)

    def problem(self) -> str | None:
        """Return a message if the file was deleted, replaced or changed by others; else None."""
        # Without an open file the next append writes a complete ledger.
        return self._file.problem(self._compare) if self._file is not None else None

    def _compare(self) -> str | None:
        """Return a text if the lines differ from the entries; else None."""
        assert self._file is not None
        content = ledger_bytes(self._survey, self._entries)
        try:
            actual = self._storage.read_at(self._file.descriptor, self._file.end, 0)
        except OSError as err:
            return f" ({err.strerror or err})"
        return None if actual == content else ""

    def replace(self, entries: list[Entry]) -> None:
        """Replace the file by one that lists exactly these records; raise OSError if that fails."""
        self.close()
        self._data = None
        self._rewrite(entries)
        self._entries = entries

    def close(self) -> None:
        """Close the file; the next append opens it again."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def forget(self, sequence: int) -> None:
        """Remove the lines of the records from a sequence number on.

        The file itself is rewritten by the next append.
        """
        self.close()
        self._data = None
        while self._entries and self._entries[-1].sequence >= sequence:
            self._entries.pop()

    def _reopen(self) -> OpenFile:
        # `_data` is the content at the start; it is valid until the first line is added.
        content, self._data = self._data or ledger_bytes(self._survey, self._entries), None
        if not (self._in_place and has_content(self._path, content)):
            self._rewrite(self._entries)
        descriptor = self._storage.open(self._path)
        self._file = OpenFile(self._storage, self._path, descriptor)
        self._file.end = len(content)
        return self._file

    def _rewrite(self, entries: list[Entry]) -> None:
        # Until the new name is on the disk, a power cut may restore an earlier ledger.
        self._in_place = False
        self._storage.write_file(self._path, ledger_bytes(self._survey, entries))
        self._in_place = True
        self.doubtful = None


def _closed(text: str) -> bytes:
    data = text.encode("ascii")
    return data + b" %08x\n" % zlib.crc32(data)


def _lines(data: bytes) -> Iterator[bytes]:
    """Yield the lines without line feeds; an unfinished last line gets a NUL, so it is invalid."""
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
