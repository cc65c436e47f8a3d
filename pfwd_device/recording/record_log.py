"""Writing of the records of a survey so that none is lost, even if files are deleted meanwhile.

The journal contains the records; the ledger is a text file with a line for each record that reached
the disk. A record is acknowledged, reported as saved, when both contain it.

A record is written to the folder of the survey, called home. Before it counts, the open files are
compared with the files at their paths. If home refuses it, or journal, ledger or folder were
deleted, replaced, cut or written to by another program, this and all later records are written to
the spare folder, with the records that home no longer contains. Nothing is written at home any
more; the next recovery merges the spare folder into it.
"""

import contextlib
import errno
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from pfwd_device.errors import RecordingError, StorageFull
from pfwd_device.recording.framing import RecordKind, encode_frame
from pfwd_device.recording.index import FileStates, build_index, file_states
from pfwd_device.recording.journal import JournalRecord, JournalWriter
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.ledger import Entry, LedgerWriter
from pfwd_device.recording.lock import SurveyLock
from pfwd_device.recording.payload import Array, encode_payload
from pfwd_device.recording.spare import SpareFolder, SparePart
from pfwd_device.recording.storage import Storage, is_full
from pfwd_device.recording.storage_reports import StorageReport, SurveyNotSafe

RESERVE_BYTES = 2 * 2**20
"""Disk space that is reserved for the present drop when the disk is full, bytes: enough for several
drops."""

RECENT_BYTES = 32 * 2**20
"""Memory for the latest records, bytes, some 300 drops: they are written to the spare folder if the
journal is cut while it is open."""


class RecordFiles:
    """Journal (all records) and ledger (list of saved records) of a folder, open for writing.

    Parameters
    ----------
    layout : Layout
        Paths of the folder.
    survey : bytes
        Identity of the survey, 16 bytes.
    storage : Storage
        Access to the files.
    entries : list of Entry
        Records that the ledger lists.
    ledger : bytes, optional
        Content of a ledger with these entries, so that it need not be formatted again.
    continued : (int, int), optional
        Number and descriptor of the file of the journal to continue; by default a new one begins.
    lost : iterable of int
        Sequence numbers of listed records that the journal no longer contains.
    """

    def __init__(
        self,
        layout: Layout,
        survey: bytes,
        storage: Storage,
        *,
        entries: list[Entry],
        ledger: bytes | None = None,
        continued: tuple[int, int] | None = None,
        lost: Iterable[int] = (),
    ) -> None:
        self.lost = set(lost)
        """Sequence numbers of listed records that the journal no longer contains."""
        self._journal = JournalWriter(layout, storage, continued=continued)
        self._ledger = LedgerWriter(layout.ledger, survey, entries, storage, ledger)

    @property
    def entries(self) -> tuple[Entry, ...]:
        """Records that are listed as saved in this folder."""
        return self._ledger.entries

    def append(self, record: JournalRecord) -> Entry:
        """Write a record; return its entry in the list of saved records when both are on the disk.

        Raises
        ------
        OSError
            If the disk fails; the record does not count then.
        """
        mark = self._journal.mark()
        entry: Entry | None = None
        try:
            entry = self._journal.append(record)
            self._ledger.append(entry)
        except BaseException as err:
            # The record stays in the journal if the ledger may list it on the disk. Otherwise the
            # line would be the line of a lost record.
            listed = entry is not None and self._ledger.doubtful == entry
            self._journal.rewind(mark, cut=not listed)
            if not isinstance(err, OSError):  # an interrupt, for example Ctrl+C
                self._ledger.forget(record.sequence)
            raise
        return entry

    def append_all(self, records: Iterable[JournalRecord]) -> dict[int, Entry]:
        """Write records; return their entries in the list of saved records by sequence number.

        When it returns, all of it is on the disk. Raise OSError if the disk fails.
        """
        new = self._journal.append_all(records)
        self.lost -= new.keys()
        entries_by_number = {entry.sequence: entry for entry in self._ledger.entries} | new
        if new:
            self._ledger.replace([entry for _, entry in sorted(entries_by_number.items())])
        return new

    def forget(self, sequence: int) -> None:
        """Remove the records from a sequence number on from the list of saved records."""
        self._ledger.forget(sequence)

    def problem(self) -> str | None:
        """Return a message if a file was deleted, replaced or changed by others; else None."""
        return self._journal.problem(self._first_damaged) or self._ledger.problem()

    def _first_damaged(self, segment: int) -> str | None:
        """Return the first unreadable record of a file of the journal in parentheses, or None."""
        for entry in self._ledger.entries:
            is_expected = entry.segment == segment and entry.sequence not in self.lost
            if is_expected and self._journal.read(entry) is None:
                return f" ({entry.name})"
        return None

    def read(self, entry: Entry) -> JournalRecord | None:
        """Read a record from the open files, also if they were deleted; None if unreadable."""
        return self._journal.read(entry)

    def close(self) -> None:
        """Close the files of journal and ledger."""
        self._journal.close()
        self._ledger.close()


class RecordLog:
    """Writer of the records of a survey to its folder (home), and after any trouble to the spare.

    Parameters
    ----------
    layout : Layout
        Paths of the survey.
    survey : bytes
        Identity of the survey, 16 bytes.
    storage : Storage
        Access to the files.
    home : RecordFiles
        Files of the survey's folder.
    lock : SurveyLock
        Lock that excludes other programs; `close` releases it.
    """

    def __init__(
        self,
        layout: Layout,
        survey: bytes,
        storage: Storage,
        home: RecordFiles,
        lock: SurveyLock,
    ) -> None:
        self.layout = layout
        self.survey = survey
        self.storage = storage
        self.lock = threading.RLock()
        self.report: Callable[[StorageReport], None] = lambda _: None
        """Function that receives reports for the operator on the state of the files."""
        self.moved: Callable[[Mapping[int, Entry], Layout], None] = lambda _, __: None
        """Function that receives the places of records in the spare folder, by sequence number, and
        the paths of the spare folder."""
        self.spare: SpareFolder | None = None
        """Folder for records when home has failed; None: an error is raised instead."""
        self.part: SparePart | None = None
        """Subfolder of the spare folder that receives all records since home has failed."""
        self._closed = False
        self._survey_lock = lock
        self._sequence = max((entry.sequence for entry in home.entries), default=0) + 1
        self._recent: dict[int, JournalRecord] = {}
        self._recent_bytes = 0
        self._failure: RecordingError | None = None
        self._home_states: FileStates | None = ()
        self._has_moved = False
        self._last_report: SurveyNotSafe | None = None
        self._files = [home]
        """Home and the files in the spare folder, also deleted ones; the last are written."""

    def append(
        self,
        kind: int,
        data: Mapping[str, Any],
        arrays: Mapping[str, Array] | None = None,
        about: str = "-",
    ) -> Entry:
        """Write a record; return its entry in the list of saved records when both are on the disk.

        Parameters
        ----------
        kind : int
            One of `RecordKind`.
        data : mapping
            Values that JSON can express.
        arrays : mapping of str to ndarray, optional
            Arrays of the record by name.
        about : str
            Description for the ledger.

        Raises
        ------
        StorageFull
            If the disk has no room, even with the reserved space. Nothing is recorded; the caller
            may try again when there is room.
        RecordingError
            If the disk fails for another reason, or the data cannot be expressed in JSON.
        """
        return self.append_payload(kind, encode_payload(data, arrays), about)

    def append_payload(self, kind: int, payload: bytes, about: str = "-") -> Entry:
        """Write a record whose content is encoded already; otherwise as :meth:`append`."""
        with self.lock:
            self._refuse_closed()
            data = encode_frame(kind, self.survey, self._sequence, payload)
            record = JournalRecord(self._sequence, kind, data, about)
            self._remember(record)  # before the write, during which the journal may be cut
            try:
                entry = self._append(record)
            except BaseException:
                self._forget(record)
                raise
            self._sequence += 1
            return entry

    def append_records(self, records: Iterable[JournalRecord]) -> dict[int, Entry]:
        """Write records of the spare folder with their sequence numbers to the survey's folder.

        Return their entries in the list of saved records. Raise RecordingError if that fails.
        """
        with self.lock:
            self._refuse_closed()
            try:
                self._require_home()
                entries = self._files[0].append_all(records)
            except OSError as err:
                raise refused(err, str(self.layout.folder)) from err
            self._sequence = max([self._sequence, *(number + 1 for number in entries)])
            return entries

    def maintain(self) -> None:
        """Verify that the files of the survey are in place, and use the spare folder if not.

        No error is raised; problems are passed to `report`. The caller should call it about every
        second, because files may be deleted while no drop is recorded.
        """
        with self.lock:
            if self._closed:
                return
            failure: RecordingError | None = None
            try:
                if self.part is None:
                    self._require_home()
                    return
            except (OSError, RecordingError) as err:
                failure = _as_recording_error(err, self.layout)
            try:
                self._use_spare(failure)
            except RecordingError as err:
                self._report(SurveyNotSafe(str(err)))

    def make_reserve(self, size: int = RESERVE_BYTES) -> bool:
        """Create the file that reserves disk space; return False if the disk is nearly full.

        Parameters
        ----------
        size : int
            Space to reserve, bytes.
        """
        path = self.layout.reserve
        with contextlib.suppress(OSError):
            if path.exists() and path.stat().st_size == size:
                return True
            if self.storage.free_bytes(self.layout.folder) < 4 * size:
                return False
            # Random bytes: a compressing file system would reserve no space for zeros.
            self.storage.write_file(path, os.urandom(size))
            return True
        return False

    def release_reserve(self) -> bool:
        """Delete the file that reserves disk space; return False if there is none."""
        try:
            self.storage.unlink(self.layout.reserve)
            self.storage.sync_directory(self.layout.folder)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Close all files and release the lock; no record can be written after that."""
        with self.lock:
            self._closed = True
            if self.part is not None:
                self._leave_part()
            for files in self._files:
                files.close()
            self._survey_lock.release()

    def _refuse_closed(self) -> None:
        if self._closed:
            raise RecordingError(
                f"{self.layout.folder}: expected an open survey, got a closed one; open it again"
            )

    def _remember(self, record: JournalRecord) -> None:
        self._recent[record.sequence] = record
        self._recent_bytes += len(record.data)
        while self._recent_bytes > RECENT_BYTES and len(self._recent) > 1:
            self._forget(next(iter(self._recent.values())))

    def _forget(self, record: JournalRecord) -> None:
        if self._recent.pop(record.sequence, None) is not None:
            self._recent_bytes -= len(record.data)

    def _append(self, record: JournalRecord) -> Entry:
        if self.part is None:
            try:
                return self._append_home(record)
            except (OSError, RecordingError) as err:
                failure = _as_recording_error(err, self.layout)
                self._use_spare(failure)
        else:
            self._use_spare()
        return self._append_spare(record)

    def _append_home(self, record: JournalRecord) -> Entry:
        self._require_home()
        home = self._files[0]
        try:
            entry = home.append(record)
        except OSError as err:
            if not (is_full(err) and self.release_reserve()):
                raise
            entry = home.append(record)
        try:
            self._require_home()  # the files may have been deleted during the write
        except BaseException:
            home.forget(record.sequence)
            raise
        return entry

    def _require_home(self) -> None:
        """Raise RecordingError if the survey's folder is not as this program left it."""
        folder = self.layout.folder
        problem = self._files[0].problem()
        if not folder.is_dir():
            problem = f"{folder.name}, the folder of the survey, was deleted or moved"
        if problem is not None:
            raise RecordingError(f"{folder}: {problem}")
        if self._survey_lock.problem() is not None:
            self._survey_lock.reacquire()

    def _append_spare(self, record: JournalRecord) -> Entry:
        assert self.part is not None
        files = self._files[-1]
        try:
            entry = files.append(record)
            try:
                problem = files.problem()
                if problem is not None:
                    raise OSError(errno.EBUSY, problem)
            except BaseException:
                files.forget(record.sequence)  # the next record gets the same number
                raise
        except OSError as err:
            if not self._has_moved:
                self._leave_part()  # home may accept the record when it is saved again
            raise self._refused_twice(err) from err
        self._has_moved = True
        self.moved({record.sequence: entry}, self.part.layout)
        return entry

    def _use_spare(self, failure: RecordingError | None = None) -> None:
        """Write to the spare folder what home no longer contains; later records follow there.

        Parameters
        ----------
        failure : RecordingError, optional
            Failure of home, if the spare folder is not used yet.

        Raises
        ------
        RecordingError
            `failure` if there is no spare folder, or an error that names both failures.
        """
        self._failure = failure or self._failure
        assert self._failure is not None
        if self.spare is None:
            raise self._failure
        states: FileStates | None = None
        with contextlib.suppress(OSError):
            states = file_states(self.layout)
        try:
            is_open = self.part is not None and self._files[-1].problem() is None
            if is_open and states == self._home_states:
                return
            self._home_states = ()
            if is_open:
                copied, lost = self._copy_missing(self._files[:-1], self._files[-1])
            else:
                copied, lost = self._open_part(self.spare)
        except (OSError, RecordingError) as err:
            raise self._refused_twice(err) from err
        assert self.part is not None
        self._home_states = states
        if copied:
            self.moved(copied, self.part.layout)
        drops = sum(entry.kind == RecordKind.DROP for entry in copied.values())
        self._report(SurveyNotSafe(str(self._failure), self.part.layout.folder, drops, lost))

    def _open_part(self, spare: SpareFolder) -> tuple[dict[int, Entry], tuple[str, ...]]:
        """Open the spare folder and copy to it what home no longer contains.

        Return the places of the copies, and the names of unreadable records.
        """
        if self.part is not None:  # its files were deleted; they stay open for reading
            self.part.lock.release()
        part = spare.open(self.layout.folder, self.survey, self.storage)
        try:
            entries, lost = part.entries, part.lost
            files = RecordFiles(part.layout, self.survey, self.storage, entries=entries, lost=lost)
            try:
                result = self._copy_missing(self._files, files)
            except BaseException:
                files.close()
                raise
        except BaseException:
            part.lock.release()
            raise
        self.part = part
        self._files.append(files)
        return result

    def _leave_part(self) -> None:
        assert self.part is not None
        self._files.pop().close()
        self.part.lock.release()
        self.part = None

    def _copy_missing(
        self, sources: list[RecordFiles], target: RecordFiles
    ) -> tuple[dict[int, Entry], tuple[str, ...]]:
        """Copy the records that are no longer intact at home, and those of survey and points.

        They are read from the open files, also if they were deleted, or from memory. Return the
        places of the copies, and the names of unreadable records.
        """
        intact = self._intact_at_home()
        present = {(e.sequence, e.check) for e in target.entries if e.sequence not in target.lost}
        unreadable: dict[tuple[int, int], Entry] = {}

        def missing() -> Iterator[JournalRecord]:
            for files in sources:
                for entry in files.entries:
                    key = entry.sequence, entry.check
                    if key in present or entry.sequence in files.lost:
                        continue
                    if key in intact and entry.kind not in (RecordKind.SURVEY, RecordKind.POINT):
                        continue
                    record = files.read(entry) or self._recent.get(entry.sequence)
                    if record is not None and record.check == entry.check:
                        present.add(key)
                        yield record
                    elif key not in intact:
                        unreadable[key] = entry

        copied = target.append_all(missing())
        lost = [entry.name for key, entry in unreadable.items() if key not in present]
        return copied, tuple(lost)

    def _intact_at_home(self) -> set[tuple[int, int]]:
        """Return number and check of the records that a reader finds in the survey's folder."""
        try:
            index = build_index(self.layout, parse_drops=False)
        except (OSError, RecordingError):
            return set()
        if index.survey != self.survey:
            return set()
        return {(number, entry.check) for number, entry in index.entries.items()}

    def _refused_twice(self, err: OSError | RecordingError) -> RecordingError:
        assert self._failure is not None
        reason = None if isinstance(err, RecordingError) else err.strerror
        return type(self._failure)(
            f"{self._failure}; the spare folder refuses it too: {reason or err}"
        )

    def _report(self, report: SurveyNotSafe) -> None:
        if report != self._last_report:
            self._last_report = report
            self.report(report)


def refused(err: OSError, where: str) -> RecordingError:
    """Return the error to raise for an error of the system: `StorageFull` or `RecordingError`.

    Parameters
    ----------
    err : OSError
        Error of the system.
    where : str
        File or folder, for the message.
    """
    reason = err.strerror or str(err)
    if is_full(err):
        return StorageFull(
            f"{where}: expected free space on the disk, got {reason!r}; nothing is lost yet: free "
            "some space and save again"
        )
    return RecordingError(
        f"{where}: expected a disk that can be written, got {reason!r}; save to another disk"
    )


def _as_recording_error(err: Exception, layout: Layout) -> RecordingError:
    if isinstance(err, RecordingError):
        return err
    assert isinstance(err, OSError)
    return refused(err, str(layout.folder))
