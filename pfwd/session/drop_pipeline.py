"""Pipeline of a detected drop: screening, saving, acknowledgement, inversion, rebounds."""

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from pfwd.analysis.drop_facts import FACTS_KEY, facts_to_store
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DiagnosisResult, DropResult, MeasuredFacts
from pfwd.analysis.screening.drops import Screening, compare, counted
from pfwd.judging import DropView, PointView, SurveyView, drop_from_traces
from pfwd.judging.view import NO_SETUP, recorded_fields
from pfwd.procedures import Kind, PointDrop
from pfwd.session.analyses import Analyses
from pfwd.session.diagnosing import PointDiagnoses
from pfwd.session.events import DropSaved, Notice, Rebounded, SavedDrop, SessionEvent
from pfwd.session.feeds import ImportedDrop, RecordedDrop
from pfwd.session.setup_file import setup_of
from pfwd.session.survey_recorder import SurveyRecorder
from pfwd_device.recording.drop_payload import facts_of
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.record import DropRecord, Rebound
from pfwd_device.recording.survey_writer import SurveyWriter

LAST_REBOUNDS = 3.0
"""Time for which the end waits for bounces after the last drop, s by the host's clock."""


@dataclass(frozen=True, eq=False, slots=True)
class _Coming:
    """Drop that is not acknowledged yet."""

    view: DropView
    """The drop, screened by its own record."""
    received: float | None
    source: RecordedDrop | ImportedDrop | None
    release: Callable[[], None] | None


class DropPipeline:
    """Pipeline for the drops of a session.

    Parameters
    ----------
    listener : callable
        Receives the events.
    options : AnalysisOptions, optional
        None: no drop is inverted.
    writer : SurveyWriter, optional
        None: nothing is saved.
    view : callable
        Returns the survey as the events so far have made it.
    live : bool
        Whether bounces may still come by themselves after the last drop.
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
        """How many drops are safe (in a replay: were handed on)."""
        self._coming: dict[tuple[str, int], _Coming] = {}
        self._largest: dict[str, float] = {}
        self._rejected: dict[str, int] = {}
        self._last: tuple[str, int] | None = None
        self._last_record: int | None = None
        self._rebounds_until = 0.0
        self._before: DropView | None = None
        self._records: dict[tuple[str, int], int] = {}
        """Number within the survey of the drop that was saved last, by point and number."""

    @property
    def held(self) -> int:
        """Number of drops that are not safe."""
        return self.recorder.held if self.recorder is not None else 0

    @property
    def settled(self) -> bool:
        """True: the hammer has come to rest after the last drop."""
        return self._last is None

    @property
    def complete(self) -> bool:
        """True: all drops are safe, and no rebound is expected."""
        waiting = not self._live or time.monotonic() <= self._rebounds_until
        return not self.held and (self.settled or not waiting)

    def add_stored_point(self, point: PointView) -> None:
        """Use the largest and the rejected drops of a stored point to screen further ones."""
        largest = max((drop.pulse_peak for drop in point.drops), default=0.0)
        self._largest[point.name] = max(largest, self._largest.get(point.name, 0.0))
        rejected = sum(fact.kind is Kind.REJECTED for fact in point.facts)
        self._rejected.setdefault(point.name, rejected)

    def number_for(self, point: str, requested: int | None = None) -> int:
        """Return the number of a drop: as recorded if that is free, else the next one."""
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
        """Save a drop, and acknowledge it when it is safe.

        `release` is called then: no other copy of the drop is needed any more.
        """
        if self.recorder is not None and (duplicate := self.recorder.find(record)) is not None:
            self._last = None
            if release is not None and self.recorder.is_safe(record):
                release()
            text = f"drop {duplicate} of the survey came again; nothing is recorded twice"
            self._report(Notice(text, kind="drops that came again"))
            return
        key = record.point, record.drop.number
        view, facts = self._screen(record)
        if source is None and facts is not None:
            metadata = {**record.metadata, FACTS_KEY: facts.to_json()}
            record = replace(record, metadata=metadata)
        self._coming[key] = _Coming(view, received, source, release)
        self._last, self._last_record = key, None
        self._rebounds_until = time.monotonic() + LAST_REBOUNDS
        if self.recorder is not None:
            self.recorder.keep(record)
        else:
            self._on_saved(record, None, None)

    def take_buffered(
        self, record: DropRecord, received: float, release: Callable[[], None]
    ) -> None:
        """Save a drop that the instrument buffers under a key of its own choice; see `take`.

        A name that the survey has for other samples is reported, and the drop gets a key of its
        own: `release` has the instrument erase it.
        """
        if self.recorder is not None:
            named, remarks = self.recorder.with_unique_key(record)
            if remarks and self.recorder.find(named) is None:
                text = (
                    f"drop {record.point}/{record.drop.number}: the instrument used its name "
                    f"{record.metadata['key']} (serial number, run, sample of the trigger) before, "
                    f"for drop {remarks[-1]}, which has other samples; both are recorded"
                )
                self._report(Notice(text, serious=True, kind="names used twice"))
            record = named
        self.take(record, received, release=release)

    def take_rebound(self, rebound: Rebound, *, recorded: bool) -> None:
        """Add a rebound to its drop, unless it was recorded with it."""
        if self._last is None:
            return
        self._rebounds_until = time.monotonic() + LAST_REBOUNDS
        if self.recorder is not None and not recorded:
            self.recorder.keep_rebound(*self._last, self._last_record, rebound)
        self._report(Rebounded(*self._last, rebound.delay, rebound.peak_load))

    def take_late_rebound(self, point: str, number: int, rebound: Rebound) -> None:
        """Record a rebound of a drop whose rebounds seemed to be over."""
        if self.recorder is not None:
            record = self._records.get((point, number))
            self.recorder.keep_rebound(point, number, record, rebound)
        self._report(Rebounded(point, number, rebound.delay, rebound.peak_load))

    def end_of_rebounds(self) -> None:
        """Publish the file of a drop: no further rebound will come."""
        if self.recorder is not None and self._last_record is not None:
            self.recorder.publish(self._last_record)
        self._last = self._last_record = None

    def _on_saved(self, record: DropRecord, number: int | None, spare: Path | None) -> None:
        """Acknowledge a safe drop, then request its inversion."""
        key = record.point, record.drop.number
        coming = self._coming.pop(key)
        if coming.release is not None:
            coming.release()
        file = coming.source.file if coming.source is not None else ""
        if self.recorder is not None and number is not None:
            self._records = {key: number}
            file = str(Layout(self.recorder.writer.folder).drop_file(number))
            if key == self._last:
                self._last_record = number
            else:  # its rebounds are over, and were held with it
                self.recorder.publish(number)
        view = replace(coming.view, record=number, screening=self._compare(coming.view, key[0]))
        saved = SavedDrop(
            record.point,
            view,
            record.drop,
            file,
            spare=None if spare is None else str(spare),
            received=coming.received,
        )
        self.acknowledged += 1
        identical = None
        if coming.source is not None:
            identical = record.drop.has_samples_of(coming.source.record.drop)
        self._report(DropSaved(saved, identical))
        if self.analyses is not None:
            self.analyses.request(saved)
        if self.diagnoses is not None:
            self.diagnoses.request(saved)

    def _screen(self, record: DropRecord) -> tuple[DropView, MeasuredFacts | None]:
        """Screen a drop by its own record; return it, and the facts to be stored with it."""
        drop, setup = record.drop, NO_SETUP
        try:
            setup = setup_of(record.declared, f"drop {record.point}")
            recorded = recorded_fields(facts_of(record), self._before)
            view = self._before = drop_from_traces(drop, setup, **recorded)
            return view, facts_to_store(view.own, view.own_pulse_peak, setup)
        except Exception as err:  # it has to be saved, whatever its traces are
            fault = f"could not be judged: {type(err).__name__}"
            text = f"drop {record.point}/{drop.number} {fault}: {err}"
            self._report(Notice(text, serious=True, details=traceback.format_exc()))
            facts = PointDrop(drop.number, Kind.REJECTED, reason=fault)
            screening = Screening("rejected", fault)
            return DropView(facts, 0.0, setup, screening=screening, metadata=record.metadata), None

    def _compare(self, drop: DropView, point: str) -> Screening:
        """Compare a drop with those of its point before it."""
        assert drop.screening is not None
        screening, peak = drop.screening, drop.own_pulse_peak
        largest = self._largest[point] = max(peak, self._largest.get(point, 0.0))
        screening = compare(screening, peak, largest)
        before = self._rejected.get(point, 0)
        self._rejected[point] = before + (screening.status == "rejected")
        return counted(screening, drop.number, before, drop.setup)

    def _earlier_drops(self, point: str, number: int) -> list[SavedDrop]:
        """Return the drops of a point before a number, without discarded ones.

        Their traces are read from the survey: those of all its drops would fill the memory.
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
