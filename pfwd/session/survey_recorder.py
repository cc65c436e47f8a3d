"""Saving of a session's drops; while the disk is full they wait in memory and are tried again."""

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
    SessionNotice,
    StorageLow,
    SurveyFilesChanged,
)
from pfwd_device.errors import RecordingError, StorageFull
from pfwd_device.recording import PublishingFailed, SurveyNotSafe
from pfwd_device.recording.record import DropRecord, ReboundRecord
from pfwd_device.recording.survey_writer import SurveyWriter
from pfwd_device.wire.fields import pack_int24

RETRY_INTERVAL = 2.0
"""Time between attempts to save the waiting drops, s."""

LAST_ATTEMPTS = 30.0
"""Duration of the attempts at the end of a session, s, unless it was stopped."""

PAUSE = 0.05
"""Time between attempts at the end of a session, s."""

WATCH_INTERVAL = 1.0
"""Time between checks that the survey's files are still in place, s."""

Saved = Callable[[DropRecord, int, Path | None], None]
Report = Callable[[DropNotSaved | SessionNotice], None]


def report_file_changes(writer: SurveyWriter, report: Report) -> None:
    """Report the changes of a survey's files since the last call.

    Parameters
    ----------
    writer : SurveyWriter
    report : callable
        Receives the events.
    """
    for change in writer.take_reports():
        match change:
            case PublishingFailed(_, point, drop, reason):
                text = (
                    f"drop {point}/{drop} has no file of its own yet (it is safe in the journal; "
                    f"pfwd recover makes the file): {reason}"
                )
                report(DropNotPublished(text, point=point, number=drop, reason=reason))
            case SurveyNotSafe():
                report(SurveyFilesChanged(change.text))


def _counts_of(record: DropRecord) -> NDArray[np.int32]:
    assert record.counts is not None  # only imported drops have none
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


def _is_same_pulse(streamed: DropRecord, buffered: DropRecord) -> bool:
    """Return whether a drop of the stream is complete and has the samples of a buffered one."""
    first, second = (each.metadata["detection"]["first_sample"] for each in (streamed, buffered))
    ours = _counts_of(streamed)[max(0, second - first) :]
    theirs = _counts_of(buffered)[max(0, first - second) :]
    length = min(len(ours), len(theirs))
    is_streamed = not streamed.metadata["detection"].get("by_instrument")
    trigger = second + buffered.metadata["detection"]["trigger"]
    has_trigger = 0 <= trigger - first < len(_counts_of(streamed))
    is_complete = is_streamed and has_trigger and not streamed.metadata["missing"]
    return is_complete and np.array_equal(ours[:length], theirs[:length])


class SurveyRecorder:
    """Saves drops in their order; drops that wait to be saved are reported as not safe.

    Parameters
    ----------
    writer : SurveyWriter
    saved : callable
        Called with each saved drop, its number within the survey, and the spare folder that holds
        it (None: it is in the folder of the survey).
    report : callable
        Receives the events about failures.
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
        """Number of drops that wait to be saved."""
        return len(self._held)

    def next_number(self, point: str) -> int:
        """Return the number that the next drop of a point gets."""
        waiting = [record.drop.number for record in self._held if record.point == point]
        return max([self.writer.next_number(point), *(number + 1 for number in waiting)])

    def find(self, record: DropRecord) -> str | None:
        """Return the number or name of the saved or waiting drop with the same key; None: it is
        new.
        """
        key = record.metadata.get("key")
        if not isinstance(key, str):
            return None
        stored = self.writer.find_key(key)
        if stored is not None:
            return str(stored)
        held = self._held_with(key)
        return None if held is None else f"{held.point}/{held.drop.number}"

    def with_unique_key(self, record: DropRecord) -> tuple[DropRecord, list[str]]:
        """Return a drop with a key that no drop with other samples has.

        If other samples have its key, the checksum of its samples is appended to the key.

        Returns
        -------
        record : DropRecord
            Its key is new, or that of the same samples.
        remarks : list of str
            Drops with other samples that have the former key.
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

    def find_streamed(self, buffered: DropRecord) -> DropRecord | None:
        """Return the drop of the stream that a buffered drop repeats; None: there is none.

        The record of the instrument contains its trigger, and their samples agree.
        """
        identity, detection = buffered.metadata["identity"], buffered.metadata["detection"]
        run = f"{identity['serial_number']}/{detection['stream']}/"
        first = detection["first_sample"]
        for sample in range(first, first + len(_counts_of(buffered))):
            streamed = self._held_with(f"{run}{sample}") or self._read(f"{run}{sample}")
            if streamed is not None and _is_same_pulse(streamed, buffered):
                return streamed
        return None

    def _held_with(self, key: str) -> DropRecord | None:
        held = (record for record in self._held if record.metadata.get("key") == key)
        return next(held, None)

    def _read(self, key: str) -> DropRecord | None:
        """Return the saved drop with this key; None: there is none, or it cannot be read."""
        number = self.writer.find_key(key)
        try:
            return None if number is None else self.writer.contents().read_drop(number)
        except RecordingError:
            return None  # the caller then saves the drop, perhaps a second time

    def is_safe(self, record: DropRecord) -> bool:
        """Return whether a drop with the same key is saved."""
        key = record.metadata.get("key")
        return isinstance(key, str) and self.writer.find_key(key) is not None

    def keep(self, record: DropRecord) -> None:
        """Save a drop; if that fails, it waits in memory."""
        self._held.append(record)
        self._save()

    def retry(self) -> None:
        """Try to save waiting drops, at most every `RETRY_INTERVAL`, and maintain the survey.

        It is to be called regularly.
        """
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
        """Make the last attempts to save waiting drops, and report those that are lost.

        Parameters
        ----------
        stopped : callable
            Returns True if the session was stopped; then there is one attempt.
        patience : float, s
            Duration of the attempts otherwise.
        """
        if self._held:
            self._save()
        until = time.monotonic() + patience
        while self._held and not stopped() and time.monotonic() < until:
            time.sleep(PAUSE)
            self.retry()
        if self._held:
            names = ", ".join(f"{record.point}/{record.drop.number}" for record in self._held)
            text = f"LOST: drop {names} could not be written to the disk; repeat the measurement"
            self._report(SessionNotice(text, serious=True))
        self.writer.maintain()
        self._report_file_changes()
        away = self.writer.drops_in_spare()
        if away:
            folder = next(iter(away.values()))
            text = (
                f"{len(away)} drops are NOT in {self.writer.folder} but in the spare folder "
                f"{folder}; pfwd recover {self.writer.folder} moves them back"
            )
            self._report(SurveyFilesChanged(text))

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
            self._report_file_changes()  # before the drop, so that the events are in order
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
        elif reported is None or (
            room < reported and room <= reported // 2
        ):  # warn at each halving
            text = f"The disk is filling: room for about {room} more drops in {self.writer.folder}."
            self._report(StorageLow(text, serious=True, drops_remaining=room))
        else:
            return
        self._reported_room = room

    def keep_rebound(
        self, point: str, drop: int, number: int | None, rebound: ReboundRecord
    ) -> None:
        """Save a rebound; if its drop waits to be saved, the rebound waits with it.

        Parameters
        ----------
        point : str
        drop : int
            Number of the drop within the point.
        number : int or None
            Number of the drop within the survey; None: the drop waits to be saved.
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
        """Save the declarations of a test point; a failure is only reported, as drops have them,
        too.
        """
        self._attempt(lambda: self.writer.add_point(name, declared), f"the test point {name}")

    def keep_check(self, details: Mapping[str, Any]) -> None:
        """Save the result of a sensor check."""
        self._attempt(lambda: self.writer.save_check(details), "a check of the sensors")

    def keep_event(self, kind: str, details: Mapping[str, Any]) -> None:
        """Save an event of the survey."""
        self._attempt(lambda: self.writer.note_event(kind, details), f"the event {kind}")

    def keep_result(self, number: int, result: DropResult) -> Path | None:
        """Save a result of a drop, given by its number within the survey.

        Returns
        -------
        Path or None
            File of the result; None: it could not be saved, which is reported.
        """
        path: Path | None = self._attempt(
            lambda: self.writer.save_result(
                number, result.to_stored(), "trial" if result.is_trial else "drop"
            ),
            "a result",
        )
        return path

    def keep_diagnosis(self, number: int, result: DiagnosisResult) -> None:
        """Save the diagnosis of a point with its last drop, a number within the survey."""
        self._attempt(
            lambda: self.writer.save_result(number, result.to_stored(), "diagnosis"), "a diagnosis"
        )

    def publish(self, number: int) -> None:
        """Write the HDF5 file of a drop, by its number within the survey."""
        self._attempt(lambda: self.writer.publish(number), "the file of a drop")

    def _attempt(self, save: Callable[[], Any], subject: str) -> Any:
        try:
            return save()
        except RecordingError as err:
            full = isinstance(err, StorageFull)
            self._report(SessionNotice(f"{subject} could not be saved: {err}", serious=not full))
            return None
