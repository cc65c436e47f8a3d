"""Writing of the records of a survey so that none is lost, even if files are deleted meanwhile.

The journal contains the records; the ledger is a text file with a line for each record that reached
the disk. A record is acknowledged, reported as saved, when both contain it.

A record is written to the folder of the survey, called home. Before it counts, the open files are
compared with the files at their paths. If journal, ledger or lock file was deleted, replaced, cut
or written to by another program, new files are created there, and the records that the folder has
lost are written again. If home fails, the record is written to the spare folder, if there is one,
with the same number. It is merged into home as soon as home works again.
"""

import contextlib
import errno
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from pfwd_device.errors import RecordingError, StorageFull
from pfwd_device.recording.framing import Kind, encode_frame
from pfwd_device.recording.index import Index, build_index
from pfwd_device.recording.journal import JournalWriter, Record
from pfwd_device.recording.layout import Layout, refuse_links
from pfwd_device.recording.ledger import Entry, LedgerWriter, read_about
from pfwd_device.recording.lock import SurveyLock
from pfwd_device.recording.payload import Array, encode_payload
from pfwd_device.recording.spare import SpareFolder, SparePart
from pfwd_device.recording.storage import Storage, is_full
from pfwd_device.recording.storage_reports import (
    FallbackMerged,
    FilesRewritten,
    SpareUsed,
    StorageReport,
    SurveyFilesRemoved,
    SurveyMovedAway,
)

RESERVE_BYTES = 2 * 2**20
"""Disk space that is reserved for the present drop when the disk is full, bytes: enough for several
drops."""

RECENT_BYTES = 32 * 2**20
"""Memory for the latest records, bytes, some 300 drops: they are written again if the journal is
cut while it is open."""

HOME_RETRY_INTERVAL_S = 2.0
"""Time between attempts to write to the survey's folder while the spare folder is used, s."""

MAX_REPAIRS = 3
"""Largest number of times that new files are created for one record, if they are deleted again."""


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

    def append(self, record: Record) -> Entry:
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

    def append_all(self, records: Iterable[Record]) -> dict[int, Entry]:
        """Write records; return their entries in the list of saved records by sequence number.

        When it returns, all of it is on the disk. Raise OSError if the disk fails.
        """
        new = self._journal.append_all(records)
        entries_by_number = {entry.sequence: entry for entry in self._ledger.entries} | new
        self._ledger.replace([entry for _, entry in sorted(entries_by_number.items())])
        return new

    def forget(self, sequence: int) -> None:
        """Remove the records from a sequence number on from the list of saved records."""
        self._ledger.forget(sequence)

    def problem(self) -> str | None:
        """Return a message if a file was deleted, replaced or changed by others; else None."""
        return self._journal.problem() or self._overwritten() or self._ledger.problem()

    def _overwritten(self) -> str | None:
        """Return a message if another program changed records and not the file size; else None."""
        changed = self._journal.stamps_changed()
        if not changed:
            return None
        for entry in self._ledger.entries:
            if entry.segment not in changed or entry.sequence in self.lost:
                continue
            if self._journal.read(entry) is None:
                name = self._journal.name_of(entry.segment)
                return f"{name} was overwritten by another program ({_name_of(entry)})"
        self._journal.accept_stamps(changed)
        return None

    def has_names(self) -> bool:
        """Return True if no open file of the journal was deleted; it may have been moved."""
        return self._journal.has_names()

    def read(self, entry: Entry) -> Record | None:
        """Read a record from the open files, also if they were deleted; None if unreadable."""
        return self._journal.read(entry)

    def close(self) -> None:
        """Close the files of journal and ledger."""
        self._journal.close()
        self._ledger.close()


class RecordLog:
    """Writer of the records of a survey, to its folder or while that fails to the spare folder.

    Parameters
    ----------
    layout : Layout
        Paths of the survey.
    survey : bytes
        Identity of the survey, 16 bytes.
    storage : Storage
        Access to the files.
    entries : list of Entry
        Records that the ledger lists.
    ledger : bytes, optional
        Content of a ledger with these entries, so that it need not be formatted again.
    lost : iterable of int
        Sequence numbers of listed records that the journal no longer contains.
    continued : (int, int), optional
        Number and descriptor of the file of the journal to continue; by default a new one begins.
    lock : SurveyLock
        Lock that excludes other programs.
    """

    def __init__(
        self,
        layout: Layout,
        survey: bytes,
        storage: Storage,
        *,
        entries: list[Entry],
        ledger: bytes | None = None,
        lost: Iterable[int] = (),
        continued: tuple[int, int] | None,
        lock: SurveyLock,
    ) -> None:
        self.layout = layout
        self.survey = survey
        self.storage = storage
        self.lock = threading.RLock()
        self.report: Callable[[StorageReport], None] = lambda _: None
        """Function that receives reports for the operator on the state of the files."""
        self.moved: Callable[[Mapping[int, Entry]], None] = lambda _: None
        """Function that receives the new places of records, by sequence number."""
        self.spare: SpareFolder | None = None
        """Folder for records while home cannot be written; None: an error is raised instead."""
        self._closed = False
        self._ending = False
        self.is_abandoned = False
        """True if the survey was moved away and is not written again in its old place."""
        self._survey_lock = lock
        self._sequence = max((entry.sequence for entry in entries), default=0) + 1
        self._recent: dict[int, Record] = {}
        self._recent_bytes = 0
        self._disk = _disk_of(layout.folder.parent)
        self._spare_part: SparePart | None = None
        self._spare_files: RecordFiles | None = None
        self._spare_holds_home = False
        self._away: dict[int, Entry] = {}
        self._refused_records: set[tuple[int, int]] = set()
        self._home_failure: RecordingError | None = None
        self._next_try = 0.0
        self._reported_problem: str | None = None
        try:
            self._home = RecordFiles(
                layout,
                survey,
                storage,
                entries=entries,
                ledger=ledger,
                continued=continued,
                lost=lost,
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
        """Write a record; return its entry in the list of saved records when both are on the disk.

        Parameters
        ----------
        kind : int
            One of `Kind`.
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
            record = Record(self._sequence, kind, data, about)
            self._remember(record)  # before the write, during which the journal may be cut
            try:
                entry = self._append(record)
            except BaseException:
                self._forget(record)
                raise
            self._sequence += 1
            return entry

    def append_record(self, record: Record) -> Entry:
        """Write a record from the spare folder with its sequence number, which must be free."""
        with self.lock:
            self._refuse_closed()
            self._remember(record)
            entry = self._append(record)
            self._sequence = max(self._sequence, record.sequence + 1)
            return entry

    def spare_folder_of(self, entry: Entry) -> Path | None:
        """Return the spare folder that contains a record; None if it is in the survey's folder."""
        with self.lock:
            if entry.sequence in self._away and self._spare_part is not None:
                return self._spare_part.layout.folder
            return None

    def maintain(self) -> None:
        """Verify that the files of the survey are in place, and restore them if they are not.

        No error is raised; problems are passed to `report`. The caller should call it about every
        second, because files may be deleted while no drop is recorded.
        """
        with self.lock:
            if self._closed or (self._home_failure is not None and not self._try_home()):
                return
            if not self._away and self._problem() is None:
                return
            try:
                self._settle(for_drop=False)
            except (OSError, RecordingError) as err:
                self._home_refused(_as_recording_error(err, self.layout))
                if self.spare is not None and not self.is_abandoned:
                    # The next drop reports an error of the spare folder.
                    with contextlib.suppress(OSError, RecordingError):
                        self._open_spare()
            else:
                self._home_failure = None

    def expect_end(self) -> None:
        """Announce the end of the session.

        If the survey is moved to another place from now on, that is only reported. Before, and for
        a late drop, its files are written again in the old place.
        """
        with self.lock:
            self._ending = True

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
        """Close all files; no record can be written after that."""
        with self.lock:
            self._closed = True
            self._home.close()
            self._close_spare()

    def _refuse_closed(self) -> None:
        if self._closed:
            raise RecordingError(
                f"{self.layout.folder}: expected an open survey, got a closed one; open it again"
            )

    def _remember(self, record: Record) -> None:
        self._recent[record.sequence] = record
        self._recent_bytes += len(record.data)
        while self._recent_bytes > RECENT_BYTES and len(self._recent) > 1:
            self._forget(next(iter(self._recent.values())))

    def _forget(self, record: Record) -> None:
        if self._recent.pop(record.sequence, None) is not None:
            self._recent_bytes -= len(record.data)

    def _try_home(self) -> bool:
        return self._home_failure is None or time.monotonic() >= self._next_try

    def _append(self, record: Record) -> Entry:
        if self._try_home() or self.is_abandoned:
            try:
                entry = self._append_home(record)
            except RecordingError as err:
                self._home_refused(err)
                self._refused_records.add((record.sequence, record.check))
                if self.spare is None or self.is_abandoned:
                    raise
            else:
                self._home_failure = None
                return entry
        return self._append_spare(record)

    def _home_refused(self, err: RecordingError) -> None:
        self._home_failure = err
        # Without a spare folder the write of every record tries the survey's folder again.
        self._next_try = time.monotonic() + (
            HOME_RETRY_INTERVAL_S if self.spare is not None else 0.0
        )

    def _append_home(self, record: Record) -> Entry:
        for_drop = record.kind in (Kind.DROP, Kind.REBOUND)
        try:
            self._settle(for_drop=for_drop)
            try:
                entry = self._home.append(record)
            except OSError as err:
                if not (is_full(err) and self.release_reserve()):
                    raise
                entry = self._home.append(record)
            try:
                # Verify after the write: the files may have been deleted during it.
                moved = self._settle(for_drop=for_drop)
            except BaseException:
                self._home.forget(record.sequence)
                raise
        except (OSError, RecordingError) as err:
            raise _as_recording_error(err, self.layout) from err
        return moved.get(record.sequence, entry)

    def _problem(self) -> str | None:
        if not self.layout.folder.is_dir():
            return f"{self.layout.folder.name}, the folder of the survey, was deleted or moved"
        return self._survey_lock.problem() or self._home.problem()

    def _is_moved_away(self) -> bool:
        """Return True if the folder of the survey was moved and not deleted."""
        return not self.layout.folder.is_dir() and self._home.has_names()

    def _settle(self, *, for_drop: bool) -> dict[int, Entry]:
        """Write lost records, and those of the spare folder, to the survey's folder.

        Return their new places by sequence number.
        """
        moved: dict[int, Entry] = {}
        repairs = 0
        while (problem := self._problem()) is not None:
            if self._ending and not for_drop and self._is_moved_away():
                report = SurveyMovedAway(self.layout.folder)
                if not self.is_abandoned:
                    self.is_abandoned = True
                    self.report(report)
                raise RecordingError(report.text)
            if repairs == MAX_REPAIRS:
                raise OSError(errno.EBUSY, f"{problem}, also after {MAX_REPAIRS} repairs")
            repairs += 1
            moved |= self._rewrite_files(problem)
        self._reported_problem, self.is_abandoned = None, False
        if self._away:
            moved |= self._bring_home()
        return moved

    def _rewrite_files(self, problem: str) -> dict[int, Entry]:
        """Create new files in the survey's folder and write the lost records to them.

        Return the places of all records by sequence number.
        """
        if problem != self._reported_problem:
            self._reported_problem = problem
            self.report(SurveyFilesRemoved(self.layout.folder, problem))
        self._prepare_folder()
        index = build_index(self.layout)
        acknowledged = {entry.sequence: entry for entry in self._home.entries}
        self._refuse_strangers(index, acknowledged)
        present = {
            number: index.entries[number]
            for number, entry in acknowledged.items()
            if number in index.entries and index.entries[number].check == entry.check
        }
        entries = [present.get(number, entry) for number, entry in sorted(acknowledged.items())]
        files = RecordFiles(self.layout, self.survey, self.storage, entries=entries)
        lost: list[Entry] = []
        missing = [entry for number, entry in sorted(acknowledged.items()) if number not in present]
        try:
            rewritten = files.append_all(self._still_readable(missing, lost))
        except BaseException:
            files.close()
            raise
        files.lost = {entry.sequence for entry in lost}
        self._home.close()
        self._home = files
        moved = present | rewritten
        self.moved(moved)
        drops = sum(entry.kind == Kind.DROP for entry in rewritten.values())
        self.report(
            FilesRewritten(
                self.layout.folder, len(rewritten), drops, tuple(_name_of(entry) for entry in lost)
            )
        )
        return moved

    def _refuse_strangers(self, index: Index, acknowledged: dict[int, Entry]) -> None:
        """Raise RecordingError if the folder contains records of another program."""
        mine = {(number, entry.check) for number, entry in (acknowledged | self._away).items()}
        mine |= self._refused_records
        theirs = {(line.sequence, line.check) for line in index.ledger.entries} - mine
        if theirs or index.survey not in (None, self.survey):
            raise RecordingError(
                f"{self.layout.folder}: expected the survey that is being written, got one with "
                "records of another program; move it away, or name another folder"
            )

    def _prepare_folder(self) -> None:
        folder = self.layout.folder
        if not folder.is_dir() and _disk_of(folder.parent) != self._disk:
            # A new folder would be on the disk below the mount point, and hidden when the right
            # disk is connected again.
            raise OSError(errno.ENOENT, f"{folder.parent} is on another disk than before")
        self.storage.make_folder(folder)
        if self._survey_lock.problem() is not None:
            self._survey_lock.reacquire()
        refuse_links(self.layout)
        for path in self.layout.folders:
            self.storage.make_folder(path)

    def _still_readable(self, entries: Iterable[Entry], lost: list[Entry]) -> Iterator[Record]:
        """Yield records from the open files or from memory; append unreadable ones to `lost`."""
        for entry in entries:
            record = self._home.read(entry) or self._recent.get(entry.sequence)
            if record is not None:
                yield record
            else:
                lost.append(entry)

    def _bring_home(self) -> dict[int, Entry]:
        assert self._spare_part is not None
        assert self._spare_files is not None
        folder = self._spare_part.layout.folder
        records = []
        for number, entry in sorted(self._away.items()):
            record = self._spare_files.read(entry) or self._recent.get(number)
            if record is None:
                raise OSError(errno.EIO, f"the spare folder {folder} cannot be read")
            records.append(record)
        moved = self._home.append_all(records)
        problem = self._problem()
        if problem is not None:
            raise OSError(errno.EBUSY, problem)
        self._away.clear()
        self._close_spare()
        self.moved(moved)
        drops = sum(entry.kind == Kind.DROP for entry in moved.values())
        self.report(FallbackMerged(self.layout.folder, folder, len(moved), drops))
        return moved

    def _append_spare(self, record: Record) -> Entry:
        assert self._home_failure is not None
        try:
            files = self._open_spare()
            entry = files.append(record)
            try:
                problem = files.problem()
                if problem is not None:
                    raise OSError(errno.EBUSY, problem)
            except BaseException:
                # The next record gets the same number.
                files.forget(record.sequence)
                raise
        except (OSError, RecordingError) as err:
            reason = None if isinstance(err, RecordingError) else err.strerror
            error = type(self._home_failure)
            raise error(
                f"{self._home_failure}; the spare folder refuses it too: {reason or err}"
            ) from err
        self._away[record.sequence] = entry
        return entry

    def _open_spare(self) -> RecordFiles:
        """Return the journal and ledger in the spare folder, open for writing.

        They also receive the records that the survey's folder has lost.
        """
        assert self.spare is not None
        if self._spare_files is not None and self._spare_files.problem() is not None:
            self._replace_spare()
        if self._spare_files is None:
            files = self._begin_spare()
            try:
                self._copy_to_spare(files)
            except BaseException:
                self._close_spare()
                raise
            folder = self._spare_part.layout.folder if self._spare_part else self.spare.root
            self.report(SpareUsed(self.layout.folder, folder, str(self._home_failure)))
        else:
            files = self._spare_files
            self._copy_to_spare(files)
        return files

    def _begin_spare(self) -> RecordFiles:
        assert self.spare is not None
        part = self.spare.open(self.layout.folder, self.survey, self.storage)
        try:
            files = RecordFiles(part.layout, self.survey, self.storage, entries=part.entries)
        except BaseException:
            part.lock.release()
            raise
        self._spare_part, self._spare_files, self._spare_holds_home = part, files, False
        return files

    def _replace_spare(self) -> None:
        """Open the spare folder again after its files were deleted, and write them again."""
        assert self._spare_files is not None
        records = []
        for number, entry in self._away.items():
            record = self._spare_files.read(entry) or self._recent.get(number)
            if record is not None:
                records.append(record)
        self._close_spare()
        self._away |= self._begin_spare().append_all(records)

    def _copy_to_spare(self, spare: RecordFiles) -> None:
        """Copy the records of survey and points to the spare folder.

        If the survey's folder is damaged, all records are copied.
        """
        home_is_damaged = self._home.problem() is not None
        if self._spare_holds_home and home_is_damaged:
            return
        entries_by_number = {entry.sequence for entry in spare.entries}
        missing = [
            entry
            for entry in self._home.entries
            if (home_is_damaged or entry.kind in (Kind.SURVEY, Kind.POINT))
            and entry.sequence not in entries_by_number
        ]
        if missing:
            spare.append_all(self._still_readable(missing, []))
        self._spare_holds_home = home_is_damaged

    def _close_spare(self) -> None:
        files, self._spare_files = self._spare_files, None
        if files is not None:
            files.close()
        if self._spare_part is not None:
            self._spare_part.lock.release()


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


def _name_of(entry: Entry) -> str:
    about = read_about(entry.about) if entry.kind == Kind.DROP else None
    return f"drop {about[1]}/{about[2]}" if about is not None else f"record {entry.sequence}"


def _disk_of(folder: Path) -> int | None:
    try:
        return os.stat(folder).st_dev
    except OSError:
        return None
