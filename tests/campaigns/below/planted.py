"""Bugs put into the recording, to see that the campaign notices them."""

import contextlib
import os
from collections.abc import Callable, Mapping

from pfwd_device.errors import RecordingError
from pfwd_device.recording import DropRecord, SurveyWriter
from pfwd_device.recording.journal import JournalWriter, Record
from pfwd_device.recording.ledger import Entry
from pfwd_device.recording.storage import Storage


def _look_at_no_times() -> None:
    """What a disk forgot would be seen by the times of the files, and be written again."""
    JournalWriter.stamps_changed = lambda self: {}  # type: ignore[method-assign]


def _ignore_sync_errors() -> None:
    """The error of a sync is taken for a success."""
    _look_at_no_times()
    real = Storage.sync

    def sync(self: Storage, descriptor: int) -> None:
        with contextlib.suppress(OSError):
            real(self, descriptor)

    Storage.sync = sync  # type: ignore[method-assign]


class _Lenient(Storage):
    def sync(self, descriptor: int) -> None:
        with contextlib.suppress(OSError):
            super().sync(descriptor)


def _ignore_journal_sync() -> None:
    """A record is acknowledged although the sync of the journal failed; the ledger is in order."""
    _look_at_no_times()
    real = JournalWriter.append

    def append(self: JournalWriter, record: Record) -> Entry:
        self._storage = _Lenient()
        return real(self, record)

    JournalWriter.append = append  # type: ignore[method-assign]


def _acknowledge_what_was_refused() -> None:
    """The answer of the disk is not waited for."""
    real = SurveyWriter.save_drop

    def save_drop(self: SurveyWriter, record: DropRecord) -> int:
        try:
            return real(self, record)
        except RecordingError:
            return 1

    SurveyWriter.save_drop = save_drop  # type: ignore[method-assign]


def _trust_paths() -> None:
    """Nobody looks whether the files that are written are those that others find."""
    from pfwd_device.recording.lock import SurveyLock
    from pfwd_device.recording.record_log import RecordFiles

    RecordFiles.problem = lambda self: None  # type: ignore[method-assign]
    SurveyLock.problem = lambda self: None  # type: ignore[method-assign]


PLANTED: Mapping[str, Callable[[], None]] = {
    "ignore-sync-errors": _ignore_sync_errors,
    "ignore-journal-sync": _ignore_journal_sync,
    "acknowledge-refused": _acknowledge_what_was_refused,
    "trust-paths": _trust_paths,
}

VARIABLE = "PFWD_BELOW_PLANT"
"""Of the environment: the bug to plant in the programs that are started."""


def plant() -> None:
    """Plant what the environment names."""
    if name := os.environ.get(VARIABLE):
        PLANTED[name]()
