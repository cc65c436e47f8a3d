"""Writing of a survey: a drop is safe on the disk when :meth:`SurveyWriter.save_drop` returns.

All data are appended to the journal of the survey. A child process makes an HDF5 file of each drop
from the journal ("publishing"). After the folder of the survey (home) could not be written or was
changed by others, all records go to the spare folder, and a recovery merges them.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import queue
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from pfwd_device.errors import RecordingError, StorageFull
from pfwd_device.recording.capture import CaptureWriter
from pfwd_device.recording.drop_payload import (
    drop_parts,
    peaks_data,
    rebound_payload,
)
from pfwd_device.recording.files import file_facts, now
from pfwd_device.recording.framing import RecordKind
from pfwd_device.recording.index import EDITS, DropEntry, Index, about_of, complete_keys, read_index
from pfwd_device.recording.layout import Layout, ResultKind
from pfwd_device.recording.payload import decode_json, encode_json
from pfwd_device.recording.publishing import publish, publishing_process, result_of
from pfwd_device.recording.record import COPY_OF, DropRecord, ReboundRecord, point_name
from pfwd_device.recording.record_log import RESERVE_BYTES, RecordLog, refused
from pfwd_device.recording.recovery import RecoveryReport, begin, prepare, repair
from pfwd_device.recording.spare import SpareFolder
from pfwd_device.recording.storage import Storage
from pfwd_device.recording.storage_reports import PublishingFailed, StorageReport
from pfwd_device.recording.survey_reader import Survey

if TYPE_CHECKING:
    from pfwd_device.jobs import Jobs, Task

WARNING_FREE_BYTES = 200 * 10**6
"""Free space of the disk below which the operator is warned, bytes."""

WARNING_FREE_DROPS = 500
"""Number of drops that the disk must have room for, else the operator is warned: a long day."""

MIN_FREE_DROPS = 20
"""Number of drops that the disk must have room for, else no drop is started. It suffices to
complete the present point."""

DEFAULT_DROP_BYTES = 250_000
"""Size of a drop in journal and file that is assumed until a drop has been saved, bytes."""

_MAX_EDIT_BYTES = 65_536

_log = logging.getLogger(__name__)


class SurveyWriter:
    """Writer of one survey; create it by :meth:`open` and use it as a context manager.

    Its methods may be called from several threads. When a method that saves data returns, they are
    on the disk.
    """

    def __init__(
        self,
        layout: Layout,
        storage: Storage,
        log: RecordLog,
        index: Index,
        report: RecoveryReport,
        jobs: Jobs | None,
    ) -> None:
        self.folder = layout.folder
        self.recovery = report
        """Result of the recovery when the survey was opened."""
        self._layout = layout
        self._storage = storage
        self._records = log
        self._index = index
        self._lock = log.lock
        self._jobs = jobs
        self._requested: set[int] = set()
        self._unlisted: list[dict[str, Any]] = []
        self._captures: list[CaptureWriter] = []
        self._drop_bytes = DEFAULT_DROP_BYTES
        self._closed = False
        self._reports: queue.SimpleQueue[StorageReport] = queue.SimpleQueue()
        log.report = self._reports.put

    @classmethod
    def open(
        cls,
        folder: str | os.PathLike[str],
        *,
        storage: Storage | None = None,
        publish: bool = True,
        jobs: Jobs | None = None,
        reserve_bytes: int = RESERVE_BYTES,
        spare: SpareFolder | None = None,
        fall_back: bool = True,
        edits_only: bool = False,
        already_read: Survey | None = None,
    ) -> Self:
        """Begin a survey in a folder, or continue an existing one after repairing it.

        All new files and their names are on the disk when the method returns.

        Parameters
        ----------
        folder : path
            Folder of the survey; it is created with its parents if it is missing.
        storage : Storage, optional
            Access to the files; by default that of the system.
        publish : bool
            True: make the HDF5 file of each drop in another process. False: a recovery makes them.
        jobs : Jobs, optional
            Process that makes the files; it is closed with the survey.
        reserve_bytes : int
            Disk space reserved for the present drop when the disk is full, bytes.
        spare : SpareFolder, optional
            Folder whose records of the survey are merged.
        fall_back : bool
            True: write records to the spare folder after the survey's folder could not be written.
            False: raise an error.
        edits_only : bool
            True: no drops will be saved. The keys of drops, by which a drop that is sent twice is
            recognised, are not read beforehand then.
        already_read : Survey, optional
            The survey as it was read before. It is read again only if it has changed since, and
            must not be used afterwards.

        Raises
        ------
        SurveyLocked
            If another program writes this survey; the message names it.
        StorageFull, RecordingError
            If the folder cannot be created or written.
        """
        storage = storage or Storage()
        layout = Layout(Path(folder).absolute())
        prepare(layout)
        jobs = jobs or publishing_process()
        log: RecordLog | None = None

        def read(layout: Layout) -> Index:
            index = None
            if already_read is not None and already_read.folder == layout.folder:
                index = already_read.index_if_unchanged()
            return read_index(layout) if index is None else index

        try:
            log, index, actions = begin(
                layout, storage, jobs, spare, fall_back=fall_back, read=read
            )
            if reserve_bytes:
                log.make_reserve(reserve_bytes)
            report = repair(log, index, jobs, publish=publish)
            report = replace(report, actions=(*actions, *report.actions))
            if not publish:
                jobs.close()
            writer = cls(layout, storage, log, index, report, jobs if publish else None)
            if not edits_only:  # read the keys now, so that saving a drop is fast
                complete_keys(layout, index)
        except BaseException as err:
            if log is not None:
                log.close()
            jobs.close()
            if isinstance(err, OSError) and not isinstance(err, RecordingError):
                raise refused(err, str(layout.folder)) from err
            raise
        return writer

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def points(self) -> tuple[str, ...]:
        """Names of the test points in their order."""
        with self._lock:
            ordered = sorted(self._index.points.values(), key=lambda point: int(point["order"]))
            return tuple(str(point["name"]) for point in ordered)

    def contents(self) -> Survey:
        """Return the content of the survey as saved so far, without reading it again."""
        with self._lock:
            return Survey(self._layout, self._index)

    @property
    def survey_id(self) -> str:
        """Identity of the survey, 32 hexadecimal digits."""
        return self._records.survey.hex()

    @property
    def drops_acknowledged(self) -> int:
        """Number of drops that are saved in the survey."""
        with self._lock:
            return len(self._index.drops)

    def take_reports(self) -> list[StorageReport]:
        """Return the reports on the safety of the data since the last call, in order."""
        reports = []
        with contextlib.suppress(queue.Empty):
            while True:
                reports.append(self._reports.get_nowait())
        return reports

    def maintain(self) -> None:
        """Verify that the survey's folder has all saved data, and use the spare folder if not.

        The caller should call it about every second; :meth:`take_reports` returns reports on the
        result.
        """
        self._records.maintain()

    def spare_folder_of(self, number: int) -> Path | None:
        """Return the spare folder that contains a drop, given its survey-wide number.

        None if the drop is in the survey's folder.
        """
        with self._lock:
            layout = self._index.elsewhere.get(self._drop(number).entry.sequence)
            return None if layout is None else layout.folder

    def drops_in_spare(self) -> dict[int, Path]:
        """Return the spare folder of each drop that is not in the survey's folder.

        The keys are survey-wide numbers.
        """
        with self._lock:
            places = {number: self.spare_folder_of(number) for number in self._index.drops}
        return {number: place for number, place in places.items() if place is not None}

    def next_number(self, point: str) -> int:
        """Return the number within the point for its next drop, from 1."""
        with self._lock:
            return self._index.next_drop(point_name(point))

    def find_key(self, key: str) -> int | None:
        """Return the survey-wide number of the drop with a key; None if no drop has it.

        A key, ``metadata["key"]``, is the text that identifies a drop on its instrument.
        """
        with self._lock:
            complete_keys(self._layout, self._index)
            return self._index.keys.get(key)

    def add_point(self, name: str, declared: Mapping[str, Any] | None = None) -> str:
        """Add a test point, or change its declarations; return its name as it is recorded.

        Parameters
        ----------
        name : str
            Name of the point; control characters, leading and trailing blanks are removed.
        declared : mapping, optional
            Declared values with the keys of a trace file's header.
        """
        name = point_name(name)
        plain = decode_json(encode_json(declared or {}))
        with self._lock:
            point = self._index.points.get(name)
            if point is not None and encode_json(point["declared"]) == encode_json(plain):
                return name
            order = int(point["order"]) if point else len(self._index.points) + 1
            self._write(RecordKind.POINT, {"name": name, "order": order, "declared": plain})
            return name

    def with_copy_mark(self, record: DropRecord) -> DropRecord:
        """Return a drop, with `COPY_OF` in its metadata if a drop of another point has its samples.

        Discarded drops, and drops with missing samples or without traces, are not compared.
        """
        metadata = {key: value for key, value in record.metadata.items() if key != COPY_OF}
        with self._lock:
            same_peaks = self._index.with_peaks(peaks_data(record.drop))
            points = self.contents().points if same_peaks else ()
        for point in points:
            if point.name == record.point or point.discarded:
                continue
            for drop in point.drops:
                if drop.number not in same_peaks or drop.discarded:
                    continue
                with contextlib.suppress(RecordingError):  # a damaged drop does not count
                    if drop.read_traces().drop.has_samples_of(record.drop):
                        place = {"point": point.name, "drop": drop.drop}
                        return replace(record, metadata={**metadata, COPY_OF: place})
        return replace(record, metadata=metadata)

    def save_drop(self, record: DropRecord) -> int:
        """Save a drop; return its survey-wide number when it is on the disk.

        An instrument may send a drop twice. If a drop with the same ``metadata["key"]`` is saved
        already, it is not recorded again, and its number is returned.

        Raises
        ------
        StorageFull, RecordingError
            If the drop is not on the disk, or its number within the point is used. The caller still
            has the drop and may try again.
        """
        key = record.metadata.get("key")
        if key is not None and not isinstance(key, str):
            raise RecordingError(f"key of a drop: expected text, got {type(key).__name__}")
        with self._lock:
            if key is not None and (number := self.find_key(key)) is not None:
                return number
            self._check_number(record)
            if record.point not in self._index.points:
                self.add_point(record.point, record.declared)
            number = self._index.next_number()
            data, arrays = drop_parts(record)
            data |= {"number": number, "key": key, "restored_from": None}
            if (peaks := peaks_data(record.drop)) is not None:
                data["peaks"] = peaks
            entry = self._records.append(
                RecordKind.DROP, data, arrays, about_of(RecordKind.DROP, data)
            )
            self._index.add(entry, data)
            # The file is about as large as the record.
            self._drop_bytes = max(2 * entry.length, 4096)
            return number

    def save_rebound(self, number: int, rebound: ReboundRecord) -> None:
        """Save a rebound of a saved drop.

        Parameters
        ----------
        number : int
            Survey-wide number of the drop.
        rebound : Rebound
        """
        with self._lock:
            self._drop(number)
            payload = rebound_payload(number, rebound)
            entry = self._records.append_payload(RecordKind.REBOUND, payload)
            self._index.add(entry, {"number": number})

    def edit(
        self, kind: str, value: Any = None, *, point: str | None = None, number: int | None = None
    ) -> None:
        """Save an edit of a point or drop. Recorded data do not change; the last edit is valid.

        Parameters
        ----------
        kind : str
            ``note, target, discard, restore, position, name, operator`` or ``declared``.
        value : JSON value
            New value; None for ``discard`` and ``restore``.
        point : str, optional
            Name of the point to edit.
        number : int, optional
            Survey-wide number of the drop to edit, in place of a point.
        """
        if kind not in EDITS:
            raise RecordingError(f"edit: expected one of {', '.join(EDITS)}, got {kind!r}")
        if (point is None) == (number is None):
            raise RecordingError("edit: expected a point or the number of a drop, got both or none")
        text = encode_json(value)
        if len(text) > _MAX_EDIT_BYTES:
            raise RecordingError(f"edit: expected at most {_MAX_EDIT_BYTES} bytes, got {len(text)}")
        with self._lock:
            if number is not None:
                self._drop(number)
            elif point not in self._index.points:
                raise RecordingError(f"edit: expected one of the survey's points, got {point!r}")
            self._write(
                RecordKind.EDIT,
                {"what": kind, "value": decode_json(text), "point": point, "number": number},
            )

    def note_event(self, kind: str, details: Mapping[str, Any] | None = None) -> None:
        """Record an event.

        Parameters
        ----------
        kind : str
            Name of the event, such as ``gap`` or ``overrun``.
        details : mapping, optional
            Values that JSON can express.
        """
        if kind == "recovery":
            raise RecordingError("event: expected any name but 'recovery', which is reserved")
        self._write(RecordKind.EVENT, {"event": kind, "details": dict(details or {})})

    def save_check(self, details: Mapping[str, Any]) -> None:
        """Record a check of the zero or the span of a channel, with its details as JSON values."""
        self._write(RecordKind.CHECK, {"details": dict(details)})

    def save_result(
        self, number: int, result: Mapping[str, Any], kind: ResultKind = "drop"
    ) -> Path:
        """Store a result of an analysis and return the path of its file; earlier results remain.

        While the spare folder is used, the file is made by a recovery.

        Parameters
        ----------
        number : int
            Survey-wide number of the drop; for a diagnosis that of the last drop of the point.
        result : mapping
            Result as JSON values.
        kind : "drop", "trial" or "diagnosis"
            Valid result of the drop, trial with other settings, or diagnosis of its point.
        """
        with self._lock:
            self._drop(number)
            count = 1
            while self._exists(path := self._layout.result(number, count, kind)):
                count += 1
            text = encode_json(result) + "\n"
            data = text.encode("ascii")
            # The journal contains the result, too; a recovery makes a missing file from it.
            if self._records.part is None:
                try:
                    self._storage.write_file(path, data)
                except OSError as err:
                    if not self._records.spare:
                        raise refused(err, str(path)) from err
            listed = {
                "path": self._layout.relative(path),
                "size": len(data),
                "sha256": hashlib.sha256(data).hexdigest(),
                "number": number,
            }
            self._write(RecordKind.FILE, listed | {"content": text})
            return path

    def publish(self, number: int) -> None:
        """Request the HDF5 file of a drop, whose rebounds are all saved, and return at once.

        A repeated request has no effect. While the spare folder is used no file is made; the
        recovery makes it.

        Parameters
        ----------
        number : int
            Survey-wide number of the drop.
        """
        with self._lock:
            drop = self._drop(number)
            is_requested = number in self._requested
            if self._jobs is None or is_requested or self._records.part is not None:
                return
            self._requested.add(number)
            self._jobs.submit(
                publish,
                self._layout,
                drop.places,
                self._storage,
                on_finish=partial(self._list_published, drop),
            )

    def open_capture(self, name: str, header: Mapping[str, Any]) -> CaptureWriter:
        """Begin a raw capture, a file with every byte of a link, which is closed with the survey.

        Parameters
        ----------
        name : str
            Begin of its file name: ``captures/NAME-1.pfwdc``, then ``-2`` and so on.
        header : mapping
            Description of the capture as JSON values: url, dialect, identity, setup.
        """
        stem = "".join(c if c.isalnum() and c.isascii() else "-" for c in name)[:40] or "link"
        with self._lock:
            count = 1
            while self._exists(path := self._layout.captures / f"{stem}-{count}.pfwdc"):
                count += 1
            capture = CaptureWriter(path, header, storage=self._storage)
            self._captures.append(capture)
            return capture

    def free_drops(self) -> int:
        """Return the number of further drops of the size of the last one for which the disk has
        room.
        """
        try:
            free = self._storage.free_bytes(self.folder)
        except OSError:
            return 0
        return int(free // max(self._drop_bytes, 1))

    def scarce_drops(self) -> int | None:
        """Return the number of drops for which the disk has room, if the operator must be warned.

        That is with less than 200 MB or with room for fewer than 500 drops. None with more room, or
        if the folder is missing.
        """
        if not self.folder.is_dir():  # `maintain` reports a missing folder
            return None
        drops = self.free_drops()
        if drops * self._drop_bytes >= WARNING_FREE_BYTES and drops >= WARNING_FREE_DROPS:
            return None
        return drops

    def check_room(self) -> None:
        """Raise `StorageFull` if the disk has room for fewer than 20 drops.

        No drop should be started then.
        """
        drops = self.free_drops()
        if drops < MIN_FREE_DROPS:
            raise StorageFull(
                f"{self.folder}: expected room for {MIN_FREE_DROPS} drops before arming, got room "
                f"for {drops}; free some space or name another folder"
            )

    def close(self, timeout: float = 60.0) -> None:
        """Wait for the HDF5 files of the drops, at most `timeout` seconds, and close the survey."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        with contextlib.ExitStack() as ends:
            ends.callback(self._records.close)
            if self._jobs is not None:
                ends.callback(self._jobs.close)
            try:
                self._finish(timeout)
            except (RecordingError, OSError) as err:
                # Acknowledged records are safe; recovery lists the remaining files.
                _log.warning("%s could not be closed cleanly: %s", self.folder, err)

    def _finish(self, timeout: float) -> None:
        self._records.maintain()
        for number in sorted(self._index.drops):
            if self._layout.drop_file_name(number) not in self._index.files:
                self.publish(number)
        if self._jobs is not None:
            self._jobs.wait(timeout)
            self._jobs.close()  # when it returns, all results are listed
        for listed in self._unlisted:
            self._write(RecordKind.FILE, listed)
        for capture in self._captures:
            capture.close()
            listed = file_facts(self._layout, capture.path)
            self._write(RecordKind.FILE, listed | {"number": None})
        self._write(RecordKind.CLOSE, {"by": "writer"})

    def _list_published(self, drop: DropEntry, task: Task[dict[str, Any]]) -> None:
        """Record that the file of a drop was made, or report why not; called in another thread."""
        try:
            listed = result_of(task)
            try:
                self._write(RecordKind.FILE, listed)
            except RecordingError:
                self._unlisted.append(listed)  # `close` tries again
                raise
        except RecordingError as err:  # it is only reported: the drop is safe in the journal
            _log.warning("the file of drop %d is not made yet: %s", drop.number, err)
            self._reports.put(PublishingFailed(drop.number, drop.point, drop.drop, str(err)))

    def _exists(self, path: Path) -> bool:
        try:
            return self._layout.relative(path) in self._index.files or path.exists()
        except OSError as err:
            raise refused(err, str(path)) from err

    def _drop(self, number: int) -> DropEntry:
        drop = self._index.drops.get(number)
        if drop is None:
            raise RecordingError(f"expected the number of a recorded drop, got {number}")
        return drop

    def _check_number(self, record: DropRecord) -> None:
        drop = record.drop.number
        expected = self._index.next_drop(record.point)
        is_used = self._index.is_used(record.point, drop)
        is_lost = (record.point, drop) in self._index.lost_drops.values()
        if drop < 1 or is_used or (drop < expected and is_lost):
            raise RecordingError(
                f"drop {record.point}/{drop}: expected an unused number from 1 on, got a used or "
                f"invalid one; the next free number is {expected}"
            )

    def _write(self, kind: int, data: Mapping[str, Any]) -> None:
        with self._lock:
            full_data = dict(data) | {"time_utc": now()}
            entry = self._records.append(kind, full_data)
            self._index.add(entry, full_data)
