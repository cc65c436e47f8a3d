"""Bugs put into the recording, to see that the campaign notices them."""

import contextlib
from collections.abc import Callable, Mapping

from pfwd_device.recording import journal
from pfwd_device.recording.storage import Storage


def _ignore_sync_errors() -> None:
    """The error of a sync is taken for a success."""
    real = Storage.sync

    def sync(self: Storage, descriptor: int) -> None:
        with contextlib.suppress(OSError):
            real(self, descriptor)

    Storage.sync = sync  # type: ignore[method-assign]


def _skip_journal_sync() -> None:
    """A record is acknowledged although the sync of the journal failed."""
    real = journal.JournalWriter._sync

    def sync(self: journal.JournalWriter) -> None:
        with contextlib.suppress(OSError):
            real(self)

    journal.JournalWriter._sync = sync  # type: ignore[method-assign]


def _trust_short_writes() -> None:
    """What a write says of how much it wrote is not looked at."""

    def write_at(self: Storage, descriptor: int, data: bytes, offset: int) -> None:
        self.pwrite(descriptor, memoryview(data), offset)

    Storage.write_at = write_at  # type: ignore[method-assign]


PLANTED: Mapping[str, Callable[[], None]] = {
    "ignore-sync-errors": _ignore_sync_errors,
    "ignore-journal-sync": _skip_journal_sync,
    "trust-short-writes": _trust_short_writes,
}
