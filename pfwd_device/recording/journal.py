"""Writing and reading of the journal, the files with all records of a survey.

A file of the journal is called a segment. An appended record is on the disk when the append
returns. The ledger is a text file with a line for each record that reached the disk.
"""

import contextlib
import io
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from pfwd_device.errors import RecordingError, SurveyLocked
from pfwd_device.recording.framing import Damage, Frame, read_frame, scan
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.ledger import Entry
from pfwd_device.recording.storage import LOCK_TEST_S, OpenFile, Storage

MAX_SEGMENT_BYTES = 256 * 2**20
"""Largest segment, bytes, so that copying and reading one stay fast."""

MAX_OPEN_SEGMENTS = 64
"""Number of segments that stay open, so that they can be read if their files are deleted; together
they have 16 GB."""


@dataclass(frozen=True, slots=True)
class JournalRecord:
    """Record that is to be written to the journal."""

    sequence: int
    """Sequence number, from 1."""
    kind: int
    """One of `framing.Kind`."""
    data: bytes
    """Header and content."""
    about: str = "-"
    """Description for the ledger."""

    @property
    def check(self) -> int:
        """CRC-32 in the header, which covers the CRC-32 of the content."""
        return int.from_bytes(self.data[44:48], "little")

    def at(self, segment: int, offset: int) -> Entry:
        """Return the entry of this record for the ledger (list of saved records).

        Parameters
        ----------
        segment : int
            Number of the file of the journal in which the record is.
        offset : int
            Position in this file, bytes.
        """
        return Entry(
            self.sequence, self.kind, segment, offset, len(self.data), self.check, self.about
        )


def open_segment(layout: Layout, number: int, storage: Storage) -> int:
    """Open and lock an existing file of the journal, and return its descriptor.

    Parameters
    ----------
    layout : Layout
        Paths of the survey.
    number : int
        Number of the file (segment).
    storage : Storage
        Access to the files.

    Raises
    ------
    SurveyLocked
        If another program has locked it.
    OSError
        If it cannot be opened.
    """
    descriptor = storage.open(layout.segment(number))
    try:
        if not storage.wait_for_lock(descriptor, LOCK_TEST_S):
            raise SurveyLocked(
                f"{layout.segment(number)}: expected to be the only program that writes, got "
                "another program that has the journal open; end it first, or name another folder"
            )
    except BaseException:
        storage.close(descriptor)
        raise
    return descriptor


class JournalWriter:
    """Writer that appends records to the last file (segment) of a journal.

    After a failed write the segment is cut back to its last good end. A new segment begins if that
    fails, if a sync fails, if another program wrote to the segment, or if the file has a second
    name. Segments stay open, so that they can be read if their files are deleted.

    Parameters
    ----------
    layout : Layout
        Paths of the survey.
    storage : Storage
        Access to the files.
    continued : (int, int), optional
        Number and descriptor of the segment to continue; by default a new one begins.
    """

    def __init__(
        self, layout: Layout, storage: Storage, *, continued: tuple[int, int] | None = None
    ) -> None:
        self._layout = layout
        self._storage = storage
        self._number = 0
        self._current: OpenFile | None = None
        self._earlier: dict[int, OpenFile] = {}
        last = continued[0] if continued is not None else None
        for number in layout.segments()[-MAX_OPEN_SEGMENTS:]:
            if number != last:
                with contextlib.suppress(OSError):  # it only cannot be read after a deletion
                    descriptor = storage.open(layout.segment(number))
                    self._earlier[number] = self._segment(number, descriptor)
        if continued is not None:
            self._number, descriptor = continued
            self._current = self._segment(self._number, descriptor)

    def append(self, record: JournalRecord) -> Entry:
        """Append a record; return its entry for the list of saved records when it is on the disk.

        Raises
        ------
        OSError
            If the disk fails; the journal is then unchanged.
        """
        segment = self._ready(len(record.data))
        self._write(segment, record.data)
        try:
            self._storage.sync(segment.descriptor)
        except OSError:
            # After a failed sync the system may discard the data and report the next sync as good.
            self._cut(segment)
            segment = self._begin_segment()
            self._write(segment, record.data)
            try:
                self._storage.sync(segment.descriptor)
            except OSError:
                self._cut(segment)
                self._leave()
                raise
        entry = record.at(self._number, segment.end)
        segment.end += len(record.data)
        return entry

    def append_all(self, records: Iterable[JournalRecord]) -> dict[int, Entry]:
        """Append records; return their entries by sequence number when all are on the disk.

        Raises
        ------
        OSError
            If the disk fails. Some records may be written then. They do not count, because the list
            of saved records (ledger) lacks them, and the caller writes all again.
        """
        entries: dict[int, Entry] = {}
        for record in records:
            before = self._current
            segment = self._ready(len(record.data))
            if before is not None and segment is not before and entries:
                self._storage.sync(before.descriptor)
            self._write(segment, record.data)
            entries[record.sequence] = record.at(self._number, segment.end)
            segment.end += len(record.data)
        if entries and self._current is not None:
            self._storage.sync(self._current.descriptor)
        return entries

    def mark(self) -> tuple[int, int]:
        """Return the present end of the journal, to which `rewind` can go back."""
        return self._number, self._current.end if self._current is not None else 0

    def rewind(self, mark: tuple[int, int], *, cut: bool = True) -> None:
        """Remove the record that was appended since `mark` was called.

        Parameters
        ----------
        mark : (int, int)
            Result of `mark`.
        cut : bool
            False: leave the record in the journal; the next one follows it.
        """
        if cut and self._current is not None:
            number, end = mark
            self._current.end = end if number == self._number else 0
            self._cut(self._current)

    def problem(self, compare: Callable[[int], str | None]) -> str | None:
        """Return a message if a file of the journal was deleted, replaced or changed; else None.

        Parameters
        ----------
        compare : callable
            Function that reads the records of the file with a number, and returns a text about the
            first damaged one.
        """
        for number, segment in sorted(self._open().items()):
            why = segment.problem(partial(compare, number))
            if why is not None:
                return f"journal/{why}"
        return None

    def read(self, entry: Entry) -> JournalRecord | None:
        """Read a record of the journal, also if its file was deleted; None if it is damaged."""
        segment = self._earlier.get(entry.segment)
        if segment is None and entry.segment == self._number:
            segment = self._current
        if segment is None:
            return None
        try:
            data = self._storage.read_at(segment.descriptor, entry.length, entry.offset)
        except OSError:
            return None
        frame = read_frame(io.BytesIO(data), 0)
        if frame is None or (frame.sequence, frame.check) != (entry.sequence, entry.check):
            return None
        return JournalRecord(entry.sequence, entry.kind, data, entry.about)

    def close(self) -> None:
        """Close all files of the journal."""
        self._leave()
        for segment in self._earlier.values():
            segment.close()
        self._earlier.clear()

    def _segment(self, number: int, descriptor: int) -> OpenFile:
        return OpenFile(self._storage, self._layout.segment(number), descriptor)

    def _open(self) -> dict[int, OpenFile]:
        """Return the open files of the journal by number."""
        if self._current is None:
            return self._earlier
        return {**self._earlier, self._number: self._current}

    def _ready(self, length: int) -> OpenFile:
        """Return the file for a record of `length` bytes; begin a new file if necessary."""
        segment = self._current
        if segment is not None and (
            segment.end + length > MAX_SEGMENT_BYTES
            # Data of other programs must not be overwritten.
            or self._storage.size(segment.descriptor) != segment.end
            # A file with a second name may belong to a backup made of links, which must not change.
            or self._storage.names(segment.descriptor) > 1
        ):
            segment = None
        return segment if segment is not None else self._begin_segment()

    def _write(self, segment: OpenFile, data: bytes) -> None:
        try:
            segment.write(data)
        except OSError:
            self._cut(segment)
            raise

    def _cut(self, segment: OpenFile) -> None:
        try:
            segment.cut()
        except OSError:
            self._leave(keeps_length=False)

    def _leave(self, *, keeps_length: bool = True) -> None:
        """End writing to the present file of the journal, which stays open for reading.

        `keeps_length` is False if its length may differ from the one that this program wrote.
        """
        segment, self._current = self._current, None
        if segment is None:
            return
        if not keeps_length:
            with contextlib.suppress(OSError):
                segment.end = self._storage.size(segment.descriptor)
        self._earlier[self._number] = segment
        while len(self._earlier) > MAX_OPEN_SEGMENTS:
            self._earlier.pop(min(self._earlier)).close()

    def _begin_segment(self) -> OpenFile:
        self._leave(keeps_length=False)
        number = max([self._number, *self._layout.segments()]) + 1
        descriptor = self._storage.open(self._layout.segment(number), create=True)
        self._storage.lock(descriptor)  # no other program can have locked a new file
        self._number, self._current = number, self._segment(number, descriptor)
        try:
            self._storage.sync_directory(self._layout.journal)
        except OSError:
            # A record in a file without a name on the disk would be lost.
            self._leave()
            raise
        return self._current


def scan_journal(layout: Layout) -> Iterator[tuple[int, Frame | Damage]]:
    """Yield the records and the damaged parts of a journal in order, with the file (segment).

    One record is in memory at a time.

    Raises
    ------
    RecordingError
        If a file of the journal exists and cannot be read.
    """
    for segment in layout.segments():
        path = layout.segment(segment)
        try:
            with path.open("rb") as stream:
                for item in scan(stream):
                    yield segment, item
        except FileNotFoundError:
            continue
        except OSError as err:
            raise RecordingError(f"{path}: expected a readable journal, got {err}") from err


def read_record(layout: Layout, segment: int, offset: int) -> Frame:
    """Read the record at a place of the journal.

    Parameters
    ----------
    layout : Layout
        Paths of the survey.
    segment : int
        Number of the file of the journal.
    offset : int
        Position in the file, bytes.

    Raises
    ------
    RecordingError
        If there is no undamaged record.
    """
    path: Path = layout.segment(segment)
    try:
        with path.open("rb") as stream:
            frame = read_frame(stream, offset)
    except OSError as err:
        raise RecordingError(f"{path}: expected a readable journal, got {err}") from err
    if frame is None:
        raise RecordingError(
            f"{path}, byte {offset}: expected a record, got damage; try pfwd recover"
        )
    return frame
