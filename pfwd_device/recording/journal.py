"""The journal's segments: records are appended, and are on the disk when the append returns."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pfwd_device.errors import RecordingError
from pfwd_device.recording.framing import Damage, Frame, encode_frame, read_frame, scan
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.ledger import Entry
from pfwd_device.recording.storage import Storage

LARGEST_SEGMENT = 256 * 2**20
"""Bytes after which a new segment begins: copies and looks at a segment stay quick."""


class JournalWriter:
    """Appends to the last segment, at an offset of its own.

    After a failed write the segment is cut back to its last good end; where that fails, or a sync
    failed, the segment is left alone from then on and a new one begins.
    """

    def __init__(
        self,
        layout: Layout,
        survey: bytes,
        storage: Storage,
        *,
        sequence: int = 1,
        continued: int | None = None,
    ) -> None:
        self._layout = layout
        self._survey = survey
        self._storage = storage
        self._sequence = sequence
        self._segment = 0
        self._descriptor: int | None = None
        self._end = 0
        if continued is not None:
            path = layout.segment(continued)
            self._descriptor = storage.open(path)
            self._segment, self._end = continued, path.stat().st_size

    @property
    def sequence(self) -> int:
        """Number of the next record."""
        return self._sequence

    def append(self, kind: int, payload: bytes, about: str = "-") -> Entry:
        """The record's entry for the ledger, once the record is on the disk.

        Raises
        ------
        OSError
            If the disk refuses; the journal is then as it was before.
        """
        data = encode_frame(kind, self._survey, self._sequence, payload)
        if self._descriptor is None or self._end + len(data) > LARGEST_SEGMENT:
            self._begin_segment()
        self._write(data)
        try:
            self._sync()
        except OSError:
            # The system may have dropped what it could not write and call the next sync a success.
            self._cut()
            self._leave_segment()
            self._begin_segment()
            self._write(data)
            try:
                self._sync()
            except OSError:
                self._cut()
                self._leave_segment()
                raise
        check = int.from_bytes(data[44:48], "little")
        entry = Entry(self._sequence, kind, self._segment, self._end, len(data), check, about)
        self._end += len(data)
        self._sequence += 1
        return entry

    def mark(self) -> tuple[int, int, int]:
        """The state to go back to when the next record cannot be acknowledged."""
        return self._segment, self._end, self._sequence

    def rewind(self, mark: tuple[int, int, int], *, cut: bool = True) -> None:
        """Go back to a mark; the number of the record after it is used again.

        Parameters
        ----------
        cut : bool
            Take the record away; else it stays where it is, and the next one comes after it.
        """
        segment, end, self._sequence = mark
        if cut and self._descriptor is not None:
            self._end = end if segment == self._segment else 0
            self._cut()

    def close(self) -> None:
        """Give the descriptor back."""
        self._leave_segment()

    def _write(self, data: bytes) -> None:
        assert self._descriptor is not None
        try:
            self._storage.write_at(self._descriptor, data, self._end)
        except OSError:
            self._cut()
            raise

    def _sync(self) -> None:
        assert self._descriptor is not None
        self._storage.sync(self._descriptor)

    def _cut(self) -> None:
        assert self._descriptor is not None
        try:
            self._storage.truncate(self._descriptor, self._end)
        except OSError:
            self._leave_segment()

    def _leave_segment(self) -> None:
        if self._descriptor is not None:
            descriptor, self._descriptor = self._descriptor, None
            with contextlib.suppress(OSError):
                self._storage.close(descriptor)

    def _begin_segment(self) -> None:
        self._leave_segment()
        number = max([self._segment, *self._layout.segments()]) + 1
        self._descriptor = self._storage.open(self._layout.segment(number), create=True)
        self._segment, self._end = number, 0
        try:
            self._storage.sync_directory(self._layout.journal)
        except OSError:
            self._leave_segment()  # a file without a name is no place for a record
            raise


@dataclass(frozen=True, slots=True)
class Located:
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
            raise RecordingError(f"{path}: expected a readable journal, came {err}") from err


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
        raise RecordingError(f"{path}: expected a readable journal, came {err}") from err
    if frame is None:
        raise RecordingError(
            f"{path}, byte {offset}: expected a record, came damage; try pfwd recover"
        )
    return frame
