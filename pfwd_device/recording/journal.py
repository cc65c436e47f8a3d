"""The journal's segments: records are appended, and are on the disk when the append returns."""

import contextlib
import io
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from pfwd_device.errors import RecordingError, SurveyLocked
from pfwd_device.recording.framing import Damage, Frame, read_frame, scan
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.ledger import Entry
from pfwd_device.recording.storage import Stamp, Storage

LARGEST_SEGMENT = 256 * 2**20
"""Bytes after which a new segment begins: copies and looks at a segment stay quick."""

MOST_OPEN = 64
"""Segments that stay open, to be read should their files be taken away: 16 GB."""

_LOCK_TRIES = 5
_LOCK_PAUSE = 0.02  # s; a check that looks whether somebody writes holds the lock for microseconds


@dataclass(frozen=True, slots=True)
class Record:
    """A record that is to be written."""

    sequence: int
    kind: int
    data: bytes
    """Header and payload."""
    about: str = "-"

    @property
    def check(self) -> int:
        """CRC-32 in its header."""
        return int.from_bytes(self.data[44:48], "little")

    def at(self, segment: int, offset: int) -> Entry:
        """Its entry for the ledger."""
        return Entry(
            self.sequence, self.kind, segment, offset, len(self.data), self.check, self.about
        )


@dataclass(slots=True)
class _Segment:
    descriptor: int
    end: int
    """Bytes that it holds as far as this program knows."""
    stamp: Stamp
    """When this program has last written to it, or seen that its records are whole."""
    doubtful: bool = False
    """Somebody else may have written to it since its records were seen to be whole."""


def open_segment(layout: Layout, number: int, storage: Storage) -> int:
    """A descriptor of a segment that exists, locked.

    Raises
    ------
    SurveyLocked
        If another program has locked it.
    OSError
    """
    descriptor = storage.open(layout.segment(number))
    try:
        for _ in range(_LOCK_TRIES):
            if storage.lock(descriptor):
                break
            time.sleep(_LOCK_PAUSE)
        else:
            raise SurveyLocked(
                f"{layout.segment(number)}: expected to be the only program that writes, got "
                "another that has the journal open; end it first, or name another folder"
            )
    except BaseException:
        storage.close(descriptor)
        raise
    return descriptor


class JournalWriter:
    """Appends to the last segment, at an offset of its own.

    After a failed write the segment is cut back to its last good end; where that fails, a sync
    failed, somebody else wrote to it or it got a second name, the segment is left alone from then
    on and a new one begins. Segments stay open, so that they can be read when their files are gone.

    Parameters
    ----------
    layout : Layout
    storage : Storage
    continued : (int, int), optional
        Number and descriptor of the segment to go on with.
    """

    def __init__(
        self, layout: Layout, storage: Storage, *, continued: tuple[int, int] | None = None
    ) -> None:
        self._layout = layout
        self._storage = storage
        self._number = 0
        self._current: _Segment | None = None
        self._earlier: dict[int, _Segment] = {}
        last = continued[0] if continued is not None else None
        for number in layout.segments()[-MOST_OPEN:]:
            if number != last:
                with contextlib.suppress(OSError):  # then it cannot be read should it be deleted
                    descriptor = storage.open(layout.segment(number))
                    self._earlier[number] = self._segment(descriptor)
        if continued is not None:
            self._number, descriptor = continued
            self._current = self._segment(descriptor)

    def append(self, record: Record) -> Entry:
        """The record's entry for the ledger, once the record is on the disk.

        Raises
        ------
        OSError
            If the disk refuses; the journal is then as it was before.
        """
        segment = self._ready(len(record.data))
        self._write(segment, record.data)
        try:
            self._storage.sync(segment.descriptor)
        except OSError:
            # The system may have dropped what it could not write and call the next sync a success.
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

    def append_all(self, records: Iterable[Record]) -> dict[int, Entry]:
        """Entries of many records by sequence number, once all are on the disk.

        Raises
        ------
        OSError
            If the disk refuses. Some may be there then; without a line in the ledger they count
            when they are written again.
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
        """The state to go back to when the next record cannot be acknowledged."""
        return self._number, self._current.end if self._current is not None else 0

    def rewind(self, mark: tuple[int, int], *, cut: bool = True) -> None:
        """Go back to a mark.

        Parameters
        ----------
        cut : bool
            Take the record away; else it stays where it is, and the next one comes after it.
        """
        if cut and self._current is not None:
            number, end = mark
            self._current.end = end if number == self._number else 0
            self._cut(self._current)

    def problem(self) -> str | None:
        """Why others do not find in the journal's folder what was written; None: they do."""
        for number, segment in sorted(self._open().items()):
            path = self._layout.segment(number)
            why = self._storage.misplaced(segment.descriptor, path, segment.end)
            if why is not None:
                return f"journal/{why}"
        return None

    def has_names(self) -> bool:
        """Whether every open segment has a path somewhere; none has when it was deleted."""
        return all(self._storage.names(each.descriptor) for each in self._open().values())

    def name_of(self, number: int) -> str:
        """Path of a segment within the survey."""
        return self._layout.relative(self._layout.segment(number))

    def stamps_changed(self) -> dict[int, Stamp]:
        """Segments whose stamp is another since this program has written to them, and which."""
        found = {}
        for number, segment in self._open().items():
            stamp = self._storage.stamp(segment.descriptor)
            if segment.doubtful or stamp is None or stamp != segment.stamp:
                found[number] = stamp
        return found

    def accept_stamps(self, stamps: Mapping[int, Stamp]) -> None:
        """Take these stamps of segments for this program's own: their records are whole."""
        for number, segment in self._open().items():
            if number in stamps:
                segment.stamp, segment.doubtful = stamps[number], False

    def read(self, entry: Entry) -> Record | None:
        """A record from a segment that is still open, whatever its path leads to; None: damaged."""
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
        return Record(entry.sequence, entry.kind, data, entry.about)

    def close(self) -> None:
        """Give the descriptors back."""
        self._leave()
        for segment in self._earlier.values():
            with contextlib.suppress(OSError):  # everything in it was synced
                self._storage.close(segment.descriptor)
        self._earlier.clear()

    def _segment(self, descriptor: int) -> _Segment:
        storage = self._storage
        return _Segment(descriptor, storage.size(descriptor), storage.stamp(descriptor))

    def _open(self) -> dict[int, _Segment]:
        """The segments that are open, by number."""
        if self._current is None:
            return self._earlier
        return {**self._earlier, self._number: self._current}

    def _ready(self, length: int) -> _Segment:
        """The segment that takes a record of this length."""
        segment = self._current
        if segment is not None and (
            segment.end + length > LARGEST_SEGMENT
            # Others wrote to it: what they wrote must not be written over.
            or self._storage.size(segment.descriptor) != segment.end
            # It has another name, as in a backup made of links: that must stay as it is.
            or self._storage.names(segment.descriptor) > 1
        ):
            segment = None
        return segment if segment is not None else self._begin_segment()

    def _write(self, segment: _Segment, data: bytes) -> None:
        # What others wrote since it was looked at last would be covered by the stamp of this write.
        segment.doubtful |= self._storage.stamp(segment.descriptor) != segment.stamp
        try:
            self._storage.write_at(segment.descriptor, data, segment.end)
        except OSError:
            self._cut(segment)
            raise
        # Before it waits for the disk: who writes meanwhile changes the stamp once more.
        segment.stamp = self._storage.stamp_own_write(segment.descriptor)

    def _cut(self, segment: _Segment) -> None:
        try:
            self._storage.truncate(segment.descriptor, segment.end)
            segment.stamp = self._storage.stamp_own_write(segment.descriptor)
        except OSError:
            self._leave(whole=False)

    def _leave(self, *, whole: bool = True) -> None:
        """Write no more to the segment; `whole`: its length is as known, and watched."""
        segment, self._current = self._current, None
        if segment is None:
            return
        if not whole:
            with contextlib.suppress(OSError):
                segment.end = self._storage.size(segment.descriptor)
        self._earlier[self._number] = segment
        while len(self._earlier) > MOST_OPEN:
            oldest = self._earlier.pop(min(self._earlier))
            with contextlib.suppress(OSError):
                self._storage.close(oldest.descriptor)

    def _begin_segment(self) -> _Segment:
        self._leave(whole=False)
        number = max([self._number, *self._layout.segments()]) + 1
        descriptor = self._storage.open(self._layout.segment(number), create=True)
        self._storage.lock(descriptor)  # nobody else can have a file that was made just now
        self._number, self._current = number, self._segment(descriptor)
        try:
            self._storage.sync_directory(self._layout.journal)
        except OSError:
            # A file without a name is no place for a record.
            self._leave()
            raise
        return self._current


class Located(NamedTuple):
    """A record with the segment that it is in."""

    segment: int
    frame: Frame


@dataclass(frozen=True, slots=True)
class Stretch:
    """A damaged stretch with the segment that it is in."""

    segment: int
    damage: Damage


def scan_journal(layout: Layout) -> Iterator[Located | Stretch]:
    """Records and damaged stretches of all segments; one record is in memory at a time.

    Raises
    ------
    RecordingError
        If a segment exists and cannot be read.
    """
    for segment in layout.segments():
        path = layout.segment(segment)
        try:
            with path.open("rb") as stream:
                for found in scan(stream):
                    if isinstance(found, Frame):
                        yield Located(segment, found)
                    else:
                        yield Stretch(segment, found)
        except FileNotFoundError:
            continue
        except OSError as err:
            raise RecordingError(f"{path}: expected a readable journal, got {err}") from err


def read_record(layout: Layout, segment: int, offset: int) -> Frame:
    """The record at a place of the journal.

    Raises
    ------
    RecordingError
        If there is none that is whole.
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
