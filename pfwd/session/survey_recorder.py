"""Keeps the drops of a session: saved at once, or held and tried again while the disk is full."""

import dataclasses
import time
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfwd.analysis.results import DiagnosisResult, DropResult
from pfwd.session.events import (
    DropNotPublished,
    DropNotSaved,
    Notice,
    StorageLow,
    SurveyFilesChanged,
)
from pfwd_device.errors import RecordingError, StorageFull
from pfwd_device.recording import (
    FallbackMerged,
    FilesRewritten,
    PublishingFailed,
    SpareUsed,
    SurveyFilesRemoved,
    SurveyMovedAway,
)
from pfwd_device.recording.record import DropRecord, Rebound
from pfwd_device.recording.survey_writer import SurveyWriter
from pfwd_device.wire.fields import pack_int24

RETRY_INTERVAL = 2.0
"""s between attempts to save what the disk did not take."""

LAST_ATTEMPTS = 30.0
"""s; duration of the last attempts at the end of a session, unless it was stopped."""

PAUSE = 0.05
"""s between two looks whether it was."""

WATCH_INTERVAL = 1.0
"""s between two looks whether the survey's files are still in place."""

Saved = Callable[[DropRecord, int, Path | None], None]
Report = Callable[[DropNotSaved | DropNotPublished | SurveyFilesChanged | Notice], None]


def report_file_changes(writer: SurveyWriter, report: Report) -> None:
    """Report what happened to the files of a survey since the last call."""
    for change in writer.take_reports():
        match change:
            case PublishingFailed(_, point, drop, reason):
                report(DropNotPublished(point, drop, reason))
            case SurveyFilesRemoved() | SpareUsed() | SurveyMovedAway():
                report(SurveyFilesChanged(change.text, safe=False))
            case FilesRewritten(lost=lost):
                report(SurveyFilesChanged(change.text, safe=not lost))
            case FallbackMerged():
                report(SurveyFilesChanged(change.text, safe=True))


def _counts_of(record: DropRecord) -> NDArray[np.int32]:
    assert record.counts is not None  # those of a converter
    return record.counts


def _same_samples(recorded: DropRecord, record: DropRecord) -> bool:
    """Return whether two drops with the same key have the same samples."""
    if recorded.counts is None:
        return False
    first, second = recorded.metadata, record.metadata
    return (
        np.array_equal(recorded.counts, _counts_of(record))
        and first["detection"]["first_sample"] == second["detection"]["first_sample"]
        and first["identity"]["sampling_rate"] == second["identity"]["sampling_rate"]
    )


class SurveyRecorder:
    """Saves drops in their order; unsaved ones stay in memory and are reported as unsafe.

    Parameters
    ----------
    writer : SurveyWriter
    saved : callable
        Receives every drop once it is safe, with its number within the survey and the spare folder
        that holds it; None: the survey's own folder does.
    report : callable
        Receives what goes wrong.
    """

    def __init__(self, writer: SurveyWriter, saved: Saved, report: Report) -> None:
        self.writer = writer
        self._saved = saved
        self._report = report
        self._held: list[DropRecord] = []
        self._n_reported = 0
        self._next_try = self._next_watch = 0.0
        self._reported_room: int | None = None

    @property
    def held(self) -> int:
        """Number of drops that are not safe."""
        return len(self._held)

    def next_number(self, point: str) -> int:
        """The number that the next drop of the point gets."""
        waiting = [record.drop.number for record in self._held if record.point == point]
        return max([self.writer.next_number(point), *(number + 1 for number in waiting)])

    def find(self, record: DropRecord) -> str | None:
        """Return the stored drop with the same samples; None when they are new."""
        key = record.metadata.get("key")
        if not isinstance(key, str):
            return None
        stored = self.writer.find_key(key)
        if stored is not None:
            return str(stored)
        held = self._held_with(key)
        return None if held is None else f"{held.point}/{held.drop.number}"

    def with_unique_key(self, record: DropRecord) -> tuple[DropRecord, list[str]]:
        """A buffered drop under a key that no drop with other samples has.

        Its own key is the first. Where other samples are recorded under that, the checksum of its
        samples is added.

        Returns
        -------
        record : DropRecord
            Under a key that is free, or that of the same samples.
        remarks : list of str
            The drops with other samples that have the keys before.
        """
        remarks: list[str] = []
        checksum = zlib.crc32(pack_int24(_counts_of(record)))
        while (conflict := self.find(record)) is not None:
            key = record.metadata["key"]
            recorded = self._held_with(key) or self._read(key)
            if recorded is not None and _same_samples(recorded, record):
                break
            remarks.append(conflict)
            metadata = {**record.metadata, "key": f"{key}/{checksum:08x}"}
            record = dataclasses.replace(record, metadata=metadata)
        return record, remarks

    def _held_with(self, key: str) -> DropRecord | None:
        """The drop with this key that the disk has not taken yet."""
        held = (record for record in self._held if record.metadata.get("key") == key)
        return next(held, None)

    def _read(self, key: str) -> DropRecord | None:
        """The recorded drop with this key; None: it cannot be read."""
        number = self.writer.find_key(key)
        try:
            return None if number is None else self.writer.contents().read_drop(number)
        except RecordingError:
            return None  # taken for another one: a drop too many is better than one too few

    def is_safe(self, record: DropRecord) -> bool:
        """Return whether the same samples are on the disk already."""
        key = record.metadata.get("key")
        return isinstance(key, str) and self.writer.find_key(key) is not None

    def keep(self, record: DropRecord) -> None:
        """Save a drop, or hold it."""
        self._held.append(record)
        self._save()

    def retry(self) -> None:
        """Save the drops that wait from time to time, and keep the survey locked for others."""
        now = time.monotonic()
        if self._held and now >= self._next_try:
            self._save()
        if now >= self._next_watch:
            self._next_watch = now + WATCH_INTERVAL
            self.writer.maintain()
            if self._reported_room is not None:
                self._announce_filling()
        self._report_file_changes()

    def finish(self, stopped: Callable[[], bool], patience: float = LAST_ATTEMPTS) -> None:
        """Make the last attempts to save the held drops; one, when the session was stopped."""
        self.writer.expect_end()
        if self._held:
            self._save()
        until = time.monotonic() + patience
        while self._held and not stopped() and time.monotonic() < until:
            time.sleep(PAUSE)
            self.retry()
        if self._held:
            names = ", ".join(f"{record.point}/{record.drop.number}" for record in self._held)
            self._report(Notice(f"LOST, the disk did not take it: drop {names}", serious=True))
        self.writer.maintain()
        self._report_file_changes()
        away = self.writer.drops_in_spare()
        if away:
            folder = next(iter(away.values()))
            text = (
                f"{len(away)} drops are NOT in {self.writer.folder} but in {folder}; "
                f"pfwd recover {self.writer.folder} brings them home"
            )
            self._report(SurveyFilesChanged(text, safe=False))

    def _save(self) -> None:
        while self._held:
            record = self._held[0]
            try:
                number = self.writer.save_drop(record)
                spare = self.writer.spare_folder_of(number)
            except RecordingError as err:
                self._report_file_changes()
                self._next_try = time.monotonic() + RETRY_INTERVAL
                new, self._n_reported = self._held[self._n_reported :], len(self._held)
                for result in new:
                    self._report(DropNotSaved(result.point, result.drop.number, str(err)))
                return
            del self._held[0]
            self._n_reported = max(0, self._n_reported - 1)
            self._report_file_changes()  # first: NOT SAFE is reported before the next drop
            self._saved(record, number, spare)
        self._announce_filling()

    def _report_file_changes(self) -> None:
        report_file_changes(self.writer, self._report)

    def _announce_filling(self) -> None:
        room, reported = self.writer.scarce_drops(), self._reported_room
        if room is None:
            if reported is not None:
                text = f"The disk has room again in {self.writer.folder}."
                self._report(StorageLow(text, drops_remaining=None))
        elif reported is None or (room < reported and room <= reported // 2):  # half of it has gone
            text = f"The disk is filling: room for about {room} more drops in {self.writer.folder}."
            self._report(StorageLow(text, serious=True, drops_remaining=room))
        else:
            return
        self._reported_room = room

    def keep_rebound(self, point: str, drop: int, number: int | None, rebound: Rebound) -> None:
        """Save a rebound; that of a drop which is held is held with it.

        Parameters
        ----------
        point : str
        drop : int
            Number of the drop within the point.
        number : int or None
            Within the survey; None: it is held.
        rebound : Rebound
        """
        if number is not None:
            self._attempt(lambda: self.writer.save_rebound(number, rebound), "a rebound")
            return
        for index, record in enumerate(self._held):
            if (record.point, record.drop.number) == (point, drop):
                more = (*record.rebounds, rebound)
                self._held[index] = dataclasses.replace(record, rebounds=more)

    def keep_point(self, name: str, declared: Mapping[str, Any]) -> None:
        """Save a test point; a full disk must not end a session, and its drops name it too."""
        self._attempt(lambda: self.writer.add_point(name, declared), f"the test point {name}")

    def keep_check(self, details: Mapping[str, Any]) -> None:
        """Save a check of the sensors."""
        self._attempt(lambda: self.writer.save_check(details), "a check of the sensors")

    def keep_event(self, kind: str, details: Mapping[str, Any]) -> None:
        """Save that something happened."""
        self._attempt(lambda: self.writer.note_event(kind, details), f"the event {kind}")

    def keep_result(self, number: int, result: DropResult) -> Path | None:
        """Save a result."""
        path: Path | None = self._attempt(
            lambda: self.writer.save_result(
                number, result.to_json(), "trial" if result.is_trial else "drop"
            ),
            "a result",
        )
        return path

    def keep_diagnosis(self, number: int, result: DiagnosisResult) -> None:
        """Save a diagnosis with the last measured drop of its point."""
        self._attempt(
            lambda: self.writer.save_result(number, result.to_json(), "diagnosis"), "a diagnosis"
        )

    def publish(self, number: int) -> None:
        """Make the file of a drop."""
        self._attempt(lambda: self.writer.publish(number), "the file of a drop")

    def _attempt(self, save: Callable[[], Any], subject: str) -> Any:
        try:
            return save()
        except RecordingError as err:
            full = isinstance(err, StorageFull)
            self._report(Notice(f"{subject} could not be saved: {err}", serious=not full))
            return None
