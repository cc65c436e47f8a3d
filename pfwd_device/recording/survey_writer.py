"""Writes a survey: what :meth:`SurveyWriter.save_drop` returned for is never lost again."""

import contextlib
import hashlib
import logging
import os
import queue
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from pfwd_device.errors import RecordingError, StorageFull
from pfwd_device.recording.capture import CaptureWriter
from pfwd_device.recording.drop_payload import (
    drop_parts,
    peaks_data,
    raised_version,
    rebound_payload,
)
from pfwd_device.recording.file_repair import FileRepair
from pfwd_device.recording.files import file_facts, now, publish_request
from pfwd_device.recording.framing import Kind
from pfwd_device.recording.index import EDITS, DropEntry, Index, about_of, complete_keys, read_index
from pfwd_device.recording.layout import Layout, ResultKind
from pfwd_device.recording.ledger import Entry
from pfwd_device.recording.lock import SurveyLock
from pfwd_device.recording.payload import decode_json, encode_json
from pfwd_device.recording.publishing import (
    ChildPublisher,
    InlinePublisher,
    Publisher,
    PublishingThread,
)
from pfwd_device.recording.record import DropRecord, Rebound, point_name
from pfwd_device.recording.record_log import RESERVE_BYTES, RecordLog, refused
from pfwd_device.recording.recovery import RecoveryReport, begin, prepare, repair
from pfwd_device.recording.spare import SpareFolder
from pfwd_device.recording.storage import Storage
from pfwd_device.recording.storage_reports import PublishingFailed, StorageReport
from pfwd_device.recording.survey_reader import Survey

WARN_BYTES = 200 * 10**6
"""Free space below which the operator is told."""

WARN_DROPS = 500
"""Free drops below which the operator is told: a long day."""

FEWEST_DROPS = 20
"""Free drops below which nothing is armed: enough to end the point in hand."""

USUAL_DROP = 250_000
"""Bytes of a drop in journal and file, until one has been saved."""

_MOST_EDIT = 65_536

_log = logging.getLogger(__name__)


class SurveyWriter:
    """Writes one survey; made by :meth:`open`, used as a context manager.

    Its methods may be called from several threads. Nothing is buffered: when a method returns,
    what it was given is on the disk.
    """

    def __init__(
        self,
        layout: Layout,
        storage: Storage,
        lock: SurveyLock,
        log: RecordLog,
        index: Index,
        report: RecoveryReport,
    ) -> None:
        self.folder = layout.folder
        self.recovery = report
        """What was put right when the survey was opened."""
        self._layout = layout
        self._storage = storage
        self._survey_lock = lock
        self._records = log
        self._index = index
        self._lock = log.lock
        self._thread: PublishingThread | None = None
        self._submitted: set[int] = set()
        self._unlisted: list[dict[str, Any]] = []
        self._captures: list[CaptureWriter] = []
        self._drop_bytes = USUAL_DROP
        self._closed = False
        self._reports: queue.SimpleQueue[StorageReport] = queue.SimpleQueue()
        self._deferred: set[int] = set()
        self._rewritten = False
        log.report = self._reports.put
        log.moved = self._relocate

    @classmethod
    def open(
        cls,
        folder: str | os.PathLike[str],
        *,
        storage: Storage | None = None,
        publish: bool = True,
        publisher: Publisher | None = None,
        reserve_bytes: int = RESERVE_BYTES,
        spare: SpareFolder | None = None,
        fall_back: bool = True,
        edits_only: bool = False,
        known: Survey | None = None,
    ) -> Self:
        """Begin a survey in `folder`, or continue the one that is there.

        Everything made is on the disk, names included, before this returns.

        Parameters
        ----------
        folder : path
            Made with its parents when it is missing.
        storage : Storage, optional
            The files; by default those of the system.
        publish : bool
            Make a file of every drop, in a child process. Without, recovery makes them later.
        publisher : Publisher, optional
            Makes the files instead of the child process.
        reserve_bytes : int
            Held back for the drop in hand when the disk is full.
        spare : SpareFolder, optional
            What it holds of the survey is brought home.
        fall_back : bool
            Records that the folder does not take go to the spare folder; else they are refused.
        edits_only : bool
            No drops are to be saved: what identifies them on the instrument is not read beforehand.
        known : Survey, optional
            The survey as it was read just now, which is not read again unless it has changed since.
            It is not to be used afterwards.

        Raises
        ------
        SurveyLocked
            If another program writes this survey; the message names it.
        StorageFull, RecordingError
            If the folder cannot be made or written.
        """
        storage = storage or Storage()
        layout = Layout(Path(folder).absolute())
        prepare(layout)
        try:
            storage.make_folder(layout.folder)
        except OSError as err:
            raise refused(err, str(layout.folder)) from err
        lock = SurveyLock(layout, storage)
        helper = publisher or ChildPublisher()
        log: RecordLog | None = None
        try:
            for path in layout.folders:
                storage.make_folder(path)
            log, index, actions = begin(
                layout,
                storage,
                helper,
                lock,
                spare,
                fall_back=fall_back,
                read=_reader_of(known, layout),
            )
            if reserve_bytes:
                log.make_reserve(reserve_bytes)
            report = repair(log, index, helper, publish=publish)
            report = replace(report, actions=(*actions, *report.actions))
            writer = cls(layout, storage, lock, log, index, report)
            if not edits_only:  # drops may come: then nothing is to be looked up first
                complete_keys(layout, index)
            writer._start(helper, publish)
        except BaseException as err:
            if log is not None:
                log.close()
            helper.close()
            lock.release()
            if isinstance(err, OSError) and not isinstance(err, RecordingError):
                raise refused(err, str(layout.folder)) from err
            raise
        return writer

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def points(self) -> tuple[str, ...]:
        """Names of the test points, in order."""
        with self._lock:
            ordered = sorted(self._index.points.values(), key=lambda point: int(point["order"]))
            return tuple(str(point["name"]) for point in ordered)

    def contents(self) -> Survey:
        """The survey as it is acknowledged now, without reading it again."""
        with self._lock:
            return Survey(self._layout, self._index)

    @property
    def survey_id(self) -> str:
        """Identity of the survey, 32 hexadecimal digits."""
        return self._records.survey.hex()

    @property
    def drops_acknowledged(self) -> int:
        """How many drops are safe."""
        with self._lock:
            return len(self._index.drops)

    @property
    def publishing_failures(self) -> dict[int, str]:
        """Why a drop has no file yet, by survey-wide number; its record is safe in the journal."""
        return dict(self._thread.failures) if self._thread else {}

    def take_reports(self) -> list[StorageReport]:
        """What happened to the files since the last call, in order; from any thread."""
        found = []
        with contextlib.suppress(queue.Empty):
            while True:
                found.append(self._reports.get_nowait())
        return found

    def look_after(self) -> None:
        """See to it that everything recorded is at home; to be called every second or so.

        Files that were taken away are written again, what the spare folder holds is brought home.
        What happens is among :meth:`take_reports`.
        """
        self._records.look_after()

    def expect_end(self) -> None:
        """No drops are to come: from now on a survey that is moved away is reported among
        :meth:`take_reports`, and not written again in its old place."""
        self._records.expect_end()

    def kept_in_spare(self, number: int) -> Path | None:
        """The folder that holds a drop which the survey's own does not take; None: it is home."""
        with self._lock:
            return self._records.away(self._drop(number).entry)

    def drops_in_spare(self) -> dict[int, Path]:
        """The folders of the drops that the survey's own does not hold, by survey-wide number."""
        with self._lock:
            places = {n: self._records.away(drop.entry) for n, drop in self._index.drops.items()}
        return {number: place for number, place in places.items() if place is not None}

    def next_number(self, point: str) -> int:
        """The number that the next drop of the point gets, from 1."""
        with self._lock:
            return self._index.next_drop(point_name(point))

    def find_key(self, key: str) -> int | None:
        """Survey-wide number of the drop with this ``metadata["key"]``, when it is recorded."""
        with self._lock:
            complete_keys(self._layout, self._index)
            return self._index.keys.get(key)

    def add_point(self, name: str, declared: Mapping[str, Any] | None = None) -> str:
        """The point's name as it is kept; a known point with other declarations gets these."""
        name = point_name(name)
        plain = decode_json(encode_json(declared or {}))
        with self._lock:
            known = self._index.points.get(name)
            if known is not None and encode_json(known["declared"]) == encode_json(plain):
                return name
            order = int(known["order"]) if known else len(self._index.points) + 1
            self._write(Kind.POINT, {"name": name, "order": order, "declared": plain})
            return name

    def save_drop(self, record: DropRecord) -> int:
        """Survey-wide number of the drop, once it is on the disk: this is the acknowledgement.

        A drop whose ``metadata["key"]`` is recorded already is not recorded again; its number is
        returned, so that an instrument that sends a drop twice is answered twice alike.

        Raises
        ------
        StorageFull, RecordingError
            If it is not on the disk, or its number within the point is taken. The caller keeps
            the drop and may try again.
        """
        key = record.metadata.get("key")
        if key is not None and not isinstance(key, str):
            raise RecordingError(f"key of a drop: expected text, got {type(key).__name__}")
        with self._lock:
            if key is not None and (known := self.find_key(key)) is not None:
                return known
            self._check_number(record)
            if record.point not in self._index.points:
                self.add_point(record.point, record.declared)
            number = self._index.next_number()
            data, arrays = drop_parts(record)
            data |= {"number": number, "key": key, "restored_from": None}
            if (peaks := peaks_data(record.drop)) is not None:
                data["peaks"] = peaks
            if (info := raised_version(self._index.info, data)) is not None:
                self._write(Kind.SURVEY, {**info, "survey_id": self.survey_id})
            entry = self._records.append(Kind.DROP, data, arrays, about_of(Kind.DROP, data))
            self._index.add(entry, data)
            # The file takes about as much again as the record.
            self._drop_bytes = max(2 * entry.length, 4096)
            return number

    def save_rebound(self, number: int, rebound: Rebound) -> None:
        """Keep a rebound of the drop with this survey-wide number."""
        with self._lock:
            self._drop(number)
            payload = rebound_payload(number, rebound)
            entry = self._records.append_payload(Kind.REBOUND, payload)
            self._index.add(entry, {"number": number})

    def edit(
        self, what: str, value: Any = None, *, point: str | None = None, number: int | None = None
    ) -> None:
        """Say something of a point or drop; nothing recorded changes, the last edit counts.

        Parameters
        ----------
        what : one of ``note, target, discard, restore, position, name, operator, declared``
        value : what JSON knows
        point : name of the point it is about
        number : survey-wide number of the drop it is about, instead of a point
        """
        if what not in EDITS:
            raise RecordingError(f"edit: expected one of {', '.join(EDITS)}, got {what!r}")
        if (point is None) == (number is None):
            raise RecordingError("edit: expected a point or the number of a drop")
        text = encode_json(value)
        if len(text) > _MOST_EDIT:
            raise RecordingError(f"edit: expected at most {_MOST_EDIT} bytes, got {len(text)}")
        with self._lock:
            if number is not None:
                self._drop(number)
            elif point not in self._index.points:
                raise RecordingError(f"edit: expected one of the survey's points, got {point!r}")
            self._write(
                Kind.EDIT,
                {"what": what, "value": decode_json(text), "point": point, "number": number},
            )

    def note_event(self, kind: str, details: Mapping[str, Any] | None = None) -> None:
        """Keep that something happened: a gap, a reconnection, an overrun."""
        if kind == "recovery":
            raise RecordingError("event: expected another name, got recovery's own")
        self._write(Kind.EVENT, {"event": kind, "details": dict(details or {})})

    def save_check(self, details: Mapping[str, Any]) -> None:
        """Keep a check of zero or span."""
        self._write(Kind.CHECK, {"details": dict(details)})

    def save_result(
        self, number: int, result: Mapping[str, Any], kind: ResultKind = "drop"
    ) -> Path:
        """Path of the file with a result of the drop; earlier results stay as they are.

        Parameters
        ----------
        number : int
            Survey-wide number of the drop; of a diagnosis that of its point's last drop.
        result : mapping
        kind : "drop", "trial" or "diagnosis"
            What counts for the drop, what somebody tried, or what is said of its point.
        """
        with self._lock:
            self._drop(number)
            count = 1
            while self._taken(path := self._layout.result(number, count, kind)):
                count += 1
            text = encode_json(result) + "\n"
            try:
                self._storage.write_file(path, text.encode("ascii"))
            except OSError as err:
                if not self._records.spare:
                    raise refused(err, str(path)) from err
                # The journal's record holds it too, and recovery makes the file from that.
            self._list_file(path, text.encode("ascii"), number, content=text)
            return path

    def publish(self, number: int) -> None:
        """Make the drop's file: its rebounds are in. Returns at once; twice is once."""
        with self._lock:
            drop = self._drop(number)
            if self._thread is None or number in self._submitted:
                return
            if any(self._records.away(entry) for entry in (drop.entry, *drop.rebounds)):
                self._deferred.add(number)  # its file is made at home
                return
            self._submitted.add(number)
            self._thread.submit(publish_request(self._layout, drop))

    def open_capture(self, name: str, header: Mapping[str, Any]) -> CaptureWriter:
        """A new raw capture ``captures/NAME-1.pfwdc`` (-2, ... follow); closed with the survey."""
        stem = "".join(c if c.isalnum() and c.isascii() else "-" for c in name)[:40] or "link"
        with self._lock:
            count = 1
            while self._taken(path := self._layout.captures / f"{stem}-{count}.pfwdc"):
                count += 1
            capture = CaptureWriter(path, header, storage=self._storage)
            self._captures.append(capture)
            return capture

    def free_drops(self, size_estimate: int | None = None) -> int:
        """How many more drops the disk takes; `size_estimate`: bytes of one, journal and file."""
        try:
            free = self._storage.free_bytes(self.folder)
        except OSError:
            return 0
        return int(free // max(size_estimate or self._drop_bytes, 1))

    def scarce_drops(self) -> int | None:
        """How many more drops the disk takes when it is filling, below 200 MB or 500 drops.

        None: it has room, or the folder is not there.
        """
        if not self.folder.is_dir():  # gone, which is reported as what it is
            return None
        drops = self.free_drops()
        if drops * self._drop_bytes >= WARN_BYTES and drops >= WARN_DROPS:
            return None
        return drops

    def check_room(self) -> None:
        """Raise StorageFull when there is room for fewer than 20 drops: do not arm then."""
        drops = self.free_drops()
        if drops < FEWEST_DROPS:
            raise StorageFull(
                f"{self.folder}: expected room for {FEWEST_DROPS} drops before arming, got room "
                f"for {drops}; free some space or name another folder"
            )

    def close(self, timeout: float = 60.0) -> None:
        """Wait for the files of the drops, at most `timeout` s, and end the survey for now."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        self.expect_end()
        with contextlib.ExitStack() as ends:
            ends.callback(self._survey_lock.release)
            ends.callback(self._records.close)
            if self._thread is not None:
                ends.callback(self._thread.close, 0.0)
            try:
                self._finish(timeout)
            except (RecordingError, OSError) as err:
                # What is acknowledged is safe; recovery lists what could not be listed now.
                _log.warning("%s could not be closed cleanly: %s", self.folder, err)

    def _finish(self, timeout: float) -> None:
        self._records.look_after()
        if self._records.left_behind:
            for capture in self._captures:
                capture.close()
            return  # the rest is made by recovery, where the survey is now
        for number in sorted(self._index.drops):
            if self._layout.drop_file_name(number) not in self._index.files:
                self.publish(number)
        if self._thread is not None:
            self._thread.close(timeout)
        for listed in self._unlisted:
            self._write(Kind.FILE, listed)
        self._close_captures()
        if self._rewritten:
            # Results were taken away with the rest, and their content is in the journal.
            helper = InlinePublisher(self._storage)
            FileRepair(self._records, self._index, helper, thorough=False).repair_other_files()
        self._write(Kind.CLOSE, {"by": "writer"})

    def _start(self, helper: Publisher, publish: bool) -> None:
        if publish:
            self._thread = PublishingThread(helper, self._took, self._not_published)
        else:
            helper.close()

    def _not_published(self, number: int, reason: str) -> None:
        """From the publishing thread: a file cannot be made."""
        with self._lock:
            drop = self._drop(number)
        self._reports.put(PublishingFailed(number, drop.point, drop.drop, reason))

    def _relocate(self, moved: Mapping[int, Entry]) -> None:
        """Records stand elsewhere now: in new files, or at home instead of in the spare folder."""
        self._index.relocate(moved)
        self._rewritten = True
        again = self._deferred | {
            number for number in self._submitted if not self._layout.drop_file(number).exists()
        }
        self._deferred = set()
        self._submitted -= again
        for number in sorted(again):
            self.publish(number)

    def _took(self, request: Mapping[str, Any], answer: Mapping[str, Any]) -> None:
        """From the publishing thread: a file is there."""
        listed = {key: answer[key] for key in ("path", "size", "sha256", "number")}
        try:
            self._write(Kind.FILE, listed)
        except RecordingError:
            self._unlisted.append(listed)  # the disk may take it later
            raise

    def _close_captures(self) -> None:
        for capture in self._captures:
            capture.close()
            listed = file_facts(self._layout, capture.path)
            self._write(Kind.FILE, listed | {"number": None})

    def _list_file(self, path: Path, data: bytes, number: int | None, *, content: str) -> None:
        facts = {
            "path": self._layout.relative(path),
            "size": len(data),
            "sha256": hashlib.sha256(data).hexdigest(),
            "number": number,
        }
        self._write(Kind.FILE, facts | {"content": content})

    def _taken(self, path: Path) -> bool:
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
        taken = self._index.is_taken(record.point, drop)
        if drop < 1 or taken or (drop < expected and self._lost(record.point, drop)):
            raise RecordingError(
                f"drop {record.point}/{drop}: expected a number that is free from 1 on, got one "
                f"that is not; {expected} is the next"
            )

    def _lost(self, point: str, drop: int) -> bool:
        return (point, drop) in self._index.lost_drops.values()

    def _write(self, kind: int, data: Mapping[str, Any]) -> None:
        with self._lock:
            whole = dict(data) | {"time_utc": now()}
            entry = self._records.append(kind, whole)
            self._index.add(entry, whole)


def _reader_of(known: Survey | None, layout: Layout) -> Callable[[Layout], Index]:
    """What gives the index once nobody else can write."""

    def read(asked: Layout) -> Index:
        found = known.index_if_unchanged() if known and known.folder == layout.folder else None
        return read_index(asked) if found is None else found

    return read
