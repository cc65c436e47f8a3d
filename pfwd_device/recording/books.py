"""Journal and ledger together: a record counts when both hold it."""

import contextlib
import os
import threading
from collections.abc import Mapping
from typing import Any

from pfwd_device.errors import RecordingError, StorageFull
from pfwd_device.recording.journal import JournalWriter
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.ledger import Entry, LedgerWriter
from pfwd_device.recording.payload import Array, encode_payload
from pfwd_device.recording.storage import Storage, is_full

RESERVE_BYTES = 2 * 2**20
"""Held back for the drop in hand when the disk is full: several drops, and hardly missed."""


class Books:
    """Writes records: journal, then ledger, each on the disk before the next step."""

    def __init__(
        self,
        layout: Layout,
        survey: bytes,
        storage: Storage,
        *,
        entries: list[Entry],
        continued: int | None,
    ) -> None:
        self.layout = layout
        self.survey = survey
        self.storage = storage
        self.lock = threading.RLock()
        self._closed = False
        sequence = max((entry.sequence for entry in entries), default=0) + 1
        self._ledger = LedgerWriter(layout.ledger, survey, entries, storage)
        try:
            self._journal = JournalWriter(
                layout, survey, storage, sequence=sequence, continued=continued
            )
        except OSError as err:
            raise refused(err, "the journal") from err

    def append(
        self,
        kind: int,
        data: Mapping[str, Any],
        arrays: Mapping[str, Array] | None = None,
        about: str = "-",
    ) -> Entry:
        """The record's entry, once journal and ledger are on the disk.

        Raises
        ------
        StorageFull
            If there is no room, even with the reserve. Nothing is recorded; try again when there
            is.
        RecordingError
            If the disk fails otherwise, or the data cannot be written as JSON.
        """
        return self.append_payload(kind, encode_payload(data, arrays), about)

    def append_payload(self, kind: int, payload: bytes, about: str = "-") -> Entry:
        """As :meth:`append`, for a payload that is ready."""
        with self.lock:
            if self._closed:
                raise RecordingError(
                    f"{self.layout.folder}: expected an open survey, came a closed one; open it"
                )
            try:
                return self._append(kind, payload, about)
            except OSError as err:
                if not (is_full(err) and self.release_reserve()):
                    raise refused(err, str(self.layout.folder)) from err
            try:
                return self._append(kind, payload, about)
            except OSError as err:
                raise refused(err, str(self.layout.folder)) from err

    def make_reserve(self, size: int = RESERVE_BYTES) -> bool:
        """Whether the reserve is there; it is not when the disk is nearly full already."""
        path = self.layout.reserve
        with contextlib.suppress(OSError):
            if path.exists() and path.stat().st_size == size:
                return True
            if self.storage.free_bytes(self.layout.folder) < 4 * size:
                return False
            # Random bytes: a file system that compresses would keep nothing back for zeros.
            self.storage.write_file(path, os.urandom(size))
            return True
        return False

    def release_reserve(self) -> bool:
        """Give the reserve's room to the drop in hand; False when there was none."""
        try:
            self.storage.unlink(self.layout.reserve)
            self.storage.sync_directory(self.layout.folder)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Give the descriptors back."""
        with self.lock:
            self._closed = True
            self._journal.close()
            self._ledger.close()

    def _append(self, kind: int, payload: bytes, about: str) -> Entry:
        mark = self._journal.mark()
        entry: Entry | None = None
        try:
            entry = self._journal.append(kind, payload, about)
            self._ledger.append(entry)
        except BaseException as err:
            # A line that may be on the disk keeps its record: without it, it would read as a loss.
            listed = entry is not None and self._ledger.doubtful == entry
            self._journal.rewind(mark, cut=not listed)
            if not isinstance(err, OSError):  # an interrupt, anywhere
                self._ledger.forget(mark[-1])
            raise
        return entry


def refused(err: OSError, where: str) -> RecordingError:
    """The error of this package for what the system said."""
    reason = err.strerror or str(err)
    if is_full(err):
        return StorageFull(
            f"{where}: expected room to write, came {reason!r}; nothing is lost yet: free some "
            "space and save again"
        )
    return RecordingError(
        f"{where}: expected a disk that takes what is written, came {reason!r}; save to another one"
    )
