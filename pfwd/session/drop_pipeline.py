"""Pipeline of a detected drop: screening, saving, acknowledgement, inversion, rebounds.

Screening decides by the record whether a drop is measured, seating or rejected. A rebound is a
further impact of the weight, which bounces after a drop; it is recorded with the drop.
"""

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from inversion.notices import Notice, text_of
from pfwd.analysis.drop_facts import FACTS_KEY, facts_to_store
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DiagnosisResult, DropResult, MeasuredFacts
from pfwd.analysis.screening.drops import Screening, compare, counted
from pfwd.files.record_marks import copy_fault
from pfwd.judging import DropView, PointView, SurveyView, drop_from_traces
from pfwd.judging.view import NO_SETUP, recorded_fields
from pfwd.procedures import Kind, PointDrop
from pfwd.session.analyses import Analyses
from pfwd.session.diagnosing import PointDiagnoses
from pfwd.session.events import DropSaved, Rebounded, SavedDrop, SessionEvent, SessionNotice
from pfwd.session.feeds import ImportedDrop, RecordedDrop
from pfwd.session.setup_file import setup_of
from pfwd.session.survey_recorder import SurveyRecorder
from pfwd_device.recording.drop_payload import facts_of
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.record import DropRecord, ReboundRecord
from pfwd_device.recording.survey_writer import SurveyWriter

LAST_REBOUNDS = 3.0
"""Time for which the end of a session waits for rebounds after the last drop, s."""


@dataclass(frozen=True, eq=False, slots=True)
class _UnsavedDrop:
    """Drop that was screened and is not saved yet."""

    view: DropView
    """Drop, screened without regard to the other drops of its point."""
    received: float | None
    source: RecordedDrop | ImportedDrop | None
    release: Callable[[], None] | None


class DropPipeline:
    """Processes the drops of a session one after the other.

    Parameters
    ----------
    listener : callable
        Receives the events.
    options : AnalysisOptions or None
        None: no drop is inverted.
    writer : SurveyWriter or None
        Survey to record into; None: nothing is saved.
    view : callable
        Returns the survey as the events so far have made it.
    live : bool
        True: rebounds may still follow the last drop.
    """

    def __init__(
        self,
        listener: Callable[[SessionEvent], None],
        options: AnalysisOptions | None,
        writer: SurveyWriter | None,
        view: Callable[[], SurveyView],
        *,
        live: bool,
    ) -> None:
        self._report = listener
        self._view = view
        self._live = live
        self.recorder = SurveyRecorder(writer, self._on_saved, listener) if writer else None
        self.analyses = Analyses(options, listener, self._keep_result) if options else None
        self.diagnoses: PointDiagnoses | None = None
        if options is not None and options.diagnose:
            self.diagnoses = PointDiagnoses(
                options, listener, self._keep_diagnosis, self._earlier_drops
            )
        self.acknowledged = 0
        """Number of saved drops; in a replay without output, of processed drops."""
        self._unsaved: dict[tuple[str, int], _UnsavedDrop] = {}
        self._largest: dict[str, float] = {}
        self._rejected: dict[str, int] = {}
        self._last: tuple[str, int] | None = None
        self._last_record: int | None = None
        self._rebounds_until = 0.0
        self._before: DropView | None = None
        self._records: dict[tuple[str, int], int] = {}
        """Number within the survey of the last saved drop, by its point and number."""

    @property
    def held(self) -> int:
        """Number of drops that wait to be saved."""
        return self.recorder.held if self.recorder is not None else 0

    @property
    def settled(self) -> bool:
        """True if no more rebounds of the last drop are expected."""
        return self._last is None

    @property
    def complete(self) -> bool:
        """True if all drops are saved, and no more rebounds are expected."""
        waiting = not self._live or time.monotonic() <= self._rebounds_until
        return not self.held and (self.settled or not waiting)

    def add_stored_point(self, point: PointView) -> None:
        """Add the drops of a stored point, to which further ones are compared."""
        largest = max((drop.pulse_peak for drop in point.drops), default=0.0)
        self._largest[point.name] = max(largest, self._largest.get(point.name, 0.0))
        rejected = sum(fact.kind is Kind.REJECTED for fact in point.facts)
        self._rejected.setdefault(point.name, rejected)

    def number_for(self, point: str, requested: int | None = None) -> int:
        """Return the number of the next drop of a point: `requested` if it is free, else the next
        free one.
        """
        if self.recorder is not None:
            return max(requested or 0, self.recorder.next_number(point))
        return requested or self.acknowledged + 1

    def take(
        self,
        record: DropRecord,
        received: float | None = None,
        source: RecordedDrop | ImportedDrop | None = None,
        release: Callable[[], None] | None = None,
    ) -> None:
        """Screen and save a drop, and acknowledge it once it is saved.

        Parameters
        ----------
        record : DropRecord
        received : float, optional
            Time at which its last sample arrived, s, monotonic clock; None: in a replay.
        source : RecordedDrop or ImportedDrop, optional
            Recorded drop of which this is the replay.
        release : callable, optional
            Called when the drop is saved, for instance to let the instrument erase its copy.
        """
        if self.recorder is not None and release is not None:
            # The same drop, recorded from the stream, may have another trigger and hence key.
            record = self.recorder.find_streamed(record) or record
        if self.recorder is not None and not isinstance(source, ImportedDrop):
            # The key of an imported drop is a checksum of its content.
            record = self._with_unique_key(record, self.recorder)
        if self.recorder is not None and (duplicate := self.recorder.find(record)) is not None:
            self._last = None
            if release is not None and self.recorder.is_safe(record):
                release()
            text = f"drop {duplicate} of the survey was received again; it is not recorded twice"
            self._report(SessionNotice(text, kind="drops received again"))
            return
        key = record.point, record.drop.number
        if self.recorder is not None:
            record = self.recorder.writer.with_copy_mark(record)
            if (fault := copy_fault(record.metadata)) is not None:
                text = (
                    f"drop {key[0]}/{key[1]}: {text_of(fault)}; its point gets no verdict with it. "
                )
                self._report(SessionNotice(text + "Discard the copy", serious=True, kind="copies"))
        view, facts = self._screen(record)
        if source is None and facts is not None:
            metadata = {**record.metadata, FACTS_KEY: facts.to_json()}
            record = replace(record, metadata=metadata)
        self._unsaved[key] = _UnsavedDrop(view, received, source, release)
        self._last, self._last_record = key, None
        self._rebounds_until = time.monotonic() + LAST_REBOUNDS
        if self.recorder is not None:
            self.recorder.keep(record)
        else:
            self._on_saved(record, None, None)

    def take_rebound(self, rebound: ReboundRecord, *, recorded: bool) -> None:
        """Save a rebound with the last drop; `recorded`: the record of a replayed drop has it
        already.
        """
        if self._last is None:
            return
        self._rebounds_until = time.monotonic() + LAST_REBOUNDS
        if self.recorder is not None and not recorded:
            self.recorder.keep_rebound(*self._last, self._last_record, rebound)
        self._report(Rebounded(*self._last, rebound.delay, rebound.peak_load))

    def take_late_rebound(self, point: str, number: int, rebound: ReboundRecord) -> None:
        """Save a rebound with an earlier drop that was already complete."""
        if self.recorder is not None:
            record = self._records.get((point, number))
            self.recorder.keep_rebound(point, number, record, rebound)
        self._report(Rebounded(point, number, rebound.delay, rebound.peak_load))

    def end_of_rebounds(self) -> None:
        """Write the file of the last drop, because no further rebound belongs to it."""
        if self.recorder is not None and self._last_record is not None:
            self.recorder.publish(self._last_record)
        self._last = self._last_record = None

    def _with_unique_key(self, record: DropRecord, recorder: SurveyRecorder) -> DropRecord:
        """Return a drop with a unique key, and report it if other samples had its key before.

        Otherwise the drop would count as saved, and an instrument that buffers it would erase it.
        """
        named, remarks = recorder.with_unique_key(record)
        if remarks and recorder.find(named) is None:
            text = (
                f"drop {record.point}/{record.drop.number}: the instrument used its key "
                f"{record.metadata['key']} (serial number, run, sample of the trigger) before, "
                f"for drop {remarks[-1]}, which has other samples; both are recorded"
            )
            self._report(SessionNotice(text, serious=True, kind="keys used twice"))
        return named

    def _on_saved(self, record: DropRecord, number: int | None, spare: Path | None) -> None:
        """Acknowledge a saved drop, then request its inversion."""
        key = record.point, record.drop.number
        unsaved = self._unsaved.pop(key)
        if unsaved.release is not None:
            unsaved.release()
        file = unsaved.source.file if unsaved.source is not None else ""
        if self.recorder is not None and number is not None:
            self._records = {key: number}
            file = str(Layout(self.recorder.writer.folder).drop_file(number))
            if key == self._last:
                self._last_record = number
            else:  # its rebounds are complete and were saved with it
                self.recorder.publish(number)
        screening = self._compare(unsaved.view, key[0])
        is_analysed = self.analyses is not None and screening.status != "rejected"
        view = replace(unsaved.view, record=number, screening=screening, awaits_result=is_analysed)
        saved = SavedDrop(
            record.point,
            view,
            record.drop,
            file,
            spare=None if spare is None else str(spare),
            received=unsaved.received,
        )
        self.acknowledged += 1
        identical = None
        if unsaved.source is not None:
            identical = record.drop.has_samples_of(unsaved.source.record.drop)
        self._report(DropSaved(saved, identical))
        if self.analyses is not None:
            self.analyses.request(saved)
        if self.diagnoses is not None:
            self.diagnoses.request(saved)

    def _screen(self, record: DropRecord) -> tuple[DropView, MeasuredFacts | None]:
        """Screen a drop by its record alone.

        Returns
        -------
        view : DropView
            Rejected if its traces cannot be screened.
        facts : MeasuredFacts or None
            Peaks and other values to store with the drop; None: they cannot be computed.
        """
        drop, setup = record.drop, NO_SETUP
        try:
            setup = setup_of(record.declared, f"drop {record.point}")
            recorded = recorded_fields(facts_of(record), self._before)
            view = self._before = drop_from_traces(drop, setup, **recorded)
            return view, facts_to_store(view.own, view.own_pulse_peak, setup)
        except Exception as err:  # a drop is saved in any case
            kind = type(err).__name__
            text = f"drop {record.point}/{drop.number} could not be screened: {kind}: {err}"
            self._report(SessionNotice(text, serious=True, details=traceback.format_exc()))
            reason = Notice("screening-failed", {"fault": kind})
            facts = PointDrop(drop.number, Kind.REJECTED, reason=reason)
            screening = Screening("rejected", reason)
            return DropView(facts, 0.0, setup, screening=screening, metadata=record.metadata), None

    def _compare(self, drop: DropView, point: str) -> Screening:
        """Return the screening of a drop after comparison with the earlier drops of its point."""
        assert drop.screening is not None
        screening, peak = drop.screening, drop.own_pulse_peak
        largest = self._largest[point] = max(peak, self._largest.get(point, 0.0))
        screening = compare(screening, peak, largest)
        before = self._rejected.get(point, 0)
        self._rejected[point] = before + (screening.status == "rejected")
        return counted(screening, drop.number, before, drop.setup)

    def _earlier_drops(self, point: str, number: int) -> list[SavedDrop]:
        """Read the drops of a point before a number from the survey, without discarded ones.

        They are not held in memory, because the traces of a survey may not fit into it.
        """
        stored = self._view().points.get(point)
        if self.recorder is None or stored is None:
            return []
        read = self.recorder.writer.contents().read_drop
        return [
            SavedDrop(point, drop, read(drop.record).drop)
            for drop in stored.drops
            if drop.number < number and drop.discarded is None
            if drop.record is not None and drop.setup is not NO_SETUP
        ]

    def _keep_diagnosis(self, record: int, result: DiagnosisResult) -> None:
        if self.recorder is not None:
            self.recorder.keep_diagnosis(record, result)

    def _keep_result(self, record: int, result: DropResult) -> None:
        if self.recorder is not None:
            self.recorder.keep_result(record, result)


def renumbered(record: DropRecord, number: int) -> DropRecord:
    """Return a drop with another number within its point."""
    if record.drop.number == number:
        return record
    return replace(record, drop=replace(record.drop, number=number))
