"""Events of a measuring session as lines: JSON objects, or one line of text for each drop."""

import logging
import math
import sys
from collections.abc import Mapping
from typing import Any

from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.results import DropAnalysis, DropResult
from pfwd.export.json_text import json_text
from pfwd.facts import fact_of_modulus, fact_of_value
from pfwd.judging import Job, PointView, SurveyView
from pfwd.judging.advice import advice_on_drop
from pfwd.judging.job import target_text
from pfwd.message_groups import Notice, text_of
from pfwd.procedures import Verdict
from pfwd.session.events import (
    DropAnalysed,
    DropNotPublished,
    DropNotSaved,
    DropSaved,
    InstrumentLost,
    InstrumentReady,
    JobReported,
    NotReady,
    PointDiagnosed,
    Ready,
    Rebounded,
    Repeats,
    SavedDrop,
    SensorCheck,
    SessionEvent,
    SessionNotice,
    SurveyChanged,
    TableBuilding,
)
from pfwd.session.live_view import CompletePoints
from pfwd.session.session import Ending
from pfwd.units import SI
from tui.diagnosis_lines import diagnosis_sentence
from tui.format import drop_line
from tui.output import clean, say

log = logging.getLogger("pfwd.session")

STATUS_OF_ENDING = {Ending.DONE: 0, Ending.UNSAVED: 1, Ending.LOST: 3}
"""Exit status of a command by the reason for the end of its session."""

MIN_MODULUS_CHANGE = 0.005
"""Relative change of a drop's modulus by the full search above which another line is printed."""


class SessionLines:
    """Printer of the events of a session; `print_event` is its listener.

    Parameters
    ----------
    as_json : bool
        True: results are printed as JSON objects, messages as text to standard error.
    analysed : bool
        True: drops are inverted, and a drop is printed when it has its first modulus.
    bell : bool
        True: the terminal's bell rings for every saved drop.
    """

    def __init__(self, *, as_json: bool, analysed: bool, bell: bool = False) -> None:
        self._as_json = as_json
        self._analysed = analysed
        self._bell = bell
        self._first_moduli: dict[tuple[str, int], float] = {}
        self._identical: dict[tuple[str, int], bool | None] = {}
        self._reported_tables: set[str] = set()
        self._repeats = Repeats()
        self._reported_job: tuple[str, float | None] | None = None
        self._complete = CompletePoints(self._point)
        self.moduli: dict[int, float] = {}
        """Last modulus of each recorded drop, Pa, by the number of the drop within the survey."""

    def print_event(self, event: SessionEvent) -> None:
        """Print an event, and the point that is complete with it."""
        self._event(event)
        if isinstance(event, SurveyChanged):
            self._complete.take(event)
            if isinstance(event.cause, DropSaved):
                self._advise(event.view, event.cause.saved)

    def finish(self) -> None:
        """Print the points that wait for a result; to be called at the end of the session."""
        self._complete.rest()

    def _point(self, point: PointView) -> None:
        progress = point.progress
        if progress.measured_wanted is None and progress.verdict is Verdict.NONE:
            return  # without a procedure or a target nothing is judged
        record = point.as_json()
        if point.progress.complete:
            text = point_text(point)
        else:  # a drop was discarded or moved; only complete points have the key `complete`
            text = f"point {clean(point.name)} is not complete any more: "
            text += text_of(point.progress.instruction)
            del record["complete"]
            record["open_again"] = True
        log.info("%s", text)
        print(json_text(record) if self._as_json else text, flush=True)

    def _event(self, event: SessionEvent) -> None:
        match event:
            case JobReported(job, differences):
                self._job(job, differences)
            case InstrumentReady():
                self._ready(event)
            case InstrumentLost(reason):
                self._say(f"INSTRUMENT LOST: {reason}", logging.WARNING)
            case NotReady(reason):
                if self._repeats.due("not ready") is not None:
                    self._say(f"not ready: {reason}", logging.WARNING)
            case Ready():
                if self._repeats.due("ready") is not None:
                    self._say("ready")
            case SensorCheck(details, faults):
                self._checked(details, faults)
            case DropSaved():
                self._saved(event)
            case DropNotSaved(point, number, reason):
                text = f"drop {point}/{number} is NOT SAFE yet, it is in memory only: {reason}"
                self._say(text, logging.ERROR)
            case DropAnalysed():
                self._analysis(event)
            case PointDiagnosed():
                self._diagnosed(event)
            case Rebounded(point, number, delay, load):
                log.info("rebound of %s/%s after %.3f s, %.0f N", point, number, delay, load)
            case TableBuilding(table):
                if table not in self._reported_tables:
                    self._reported_tables.add(table)
                    self._say(f"computing a response table once: {table}")
            case SessionNotice(text, serious, details):
                self._say(text, logging.WARNING if serious else logging.INFO)
                if details:
                    log.error("%s", details)
                if isinstance(event, DropNotPublished) and self._as_json:
                    line = {
                        "point": event.point,
                        "drop": event.number,
                        "saved": True,
                        "published": False,
                        "reason": event.reason,
                    }
                    print(json_text(line), flush=True)

    def _job(self, job: Job, differences: tuple[str, ...]) -> None:
        for text in differences:
            self._say(f"{text} (pfwd job shows every change)", logging.WARNING)
        job_key = (job.procedure_in_force.name, job.target)
        if job_key == self._reported_job or (job.procedure is None and job.target is None):
            return
        self._reported_job = job_key
        target = "" if job.target is None else f", target {target_text(job.target)}"
        name = job.procedure_in_force.name
        self._say(f"judged by {name}: {job.quantity.label}{target}")

    def _say(self, text: str, level: int = logging.INFO) -> None:
        log.log(level, "%s", text)
        say(text)

    def _ready(self, event: InstrumentReady) -> None:
        identity, setup = event.identity, event.setup
        n_unreported = self._repeats.due("connections")
        if n_unreported is None:
            return
        if n_unreported:
            self._say(f"the instrument was connected {n_unreported} more times meanwhile")
        prefix = "connected again: " if event.again else ""
        self._say(
            f"{prefix}{identity.title}, at {event.url}: {len(identity.channels)} channels at "
            f"{identity.sampling_rate:g} Hz"
        )
        ratio = "0.35 (assumed)" if setup.poisson_ratio is None else f"{setup.poisson_ratio:g}"
        mass = "not declared" if setup.plate_mass is None else f"{setup.plate_mass:g} kg"
        self._say(
            f"plate radius {setup.plate_radius:g} m, plate mass {mass}, Poisson's ratio {ratio}"
        )
        if setup.procedure is not None:
            self._say(f"procedure {setup.procedure}: {setup.seating_drops} seating drops")
        for channel in identity.channels:
            when = f", calibrated {channel.calibrated}" if channel.calibrated else ""
            log.info("%s: %s at %g m%s", channel.name, channel.quantity.role, channel.offset, when)
        for text in (*event.differences, *event.warnings):
            self._say(text)

    def _checked(self, details: Mapping[str, Any], faults: tuple[Notice, ...]) -> None:
        zero, ratio = details["zero_n"], details["span_ratio"]
        span = "no shunt to check the span" if ratio is None else f"span {100 * ratio:.1f} %"
        verdict = "OK" if not faults else "NOT OK"
        self._say(f"load cell {verdict}: zero {zero:.0f} N, {span}")
        for fault in faults:
            self._say(text_of(fault), logging.WARNING)

    def _saved(self, event: DropSaved) -> None:
        saved = event.saved
        self._identical[saved.point, saved.number] = event.identical
        where = "" if saved.spare is None else f" in the spare folder {saved.spare}"
        log.info("drop %s/%s saved as %s%s", saved.point, saved.number, saved.record, where)
        for mark in saved.view.marks:
            self._say(f"drop {saved.point}/{saved.number}: {text_of(mark)}", logging.WARNING)
        if self._bell:
            print("\a", end="", file=sys.stderr, flush=True)
        if not self._analysed or saved.screening.status == "rejected":
            analysis = DropAnalysis(saved.drop, saved.screening, None, setup=saved.setup)
            self._line(saved, drop_result(saved.file, analysis))
            self._forget(saved)

    def _advise(self, view: SurveyView, saved: SavedDrop) -> None:
        """Print the advice on a drop that needs no fit: wrong drop height, saturated channel."""
        others = [drop for drop in view.points[saved.point].drops if drop.number != saved.number]
        for advice in advice_on_drop(view.job, saved.view, others):
            self._say(f"at drop {saved.point}/{saved.number}: {advice}", logging.WARNING)

    def _analysis(self, event: DropAnalysed) -> None:
        saved, result = event.saved, event.result
        modulus = result.modulus_pa or math.nan
        if saved.record is not None:
            self.moduli[saved.record] = modulus
        first = self._first_moduli.get((saved.point, saved.number))
        if not event.final:
            self._first_moduli[saved.point, saved.number] = modulus
        changed = first is None or not abs(modulus - first) <= MIN_MODULUS_CHANGE * first
        if self._as_json or changed:
            self._line(saved, result, event.delay, preliminary=not event.final)
        if event.final:
            self._forget(saved)

    def _diagnosed(self, event: PointDiagnosed) -> None:
        result = event.result
        log.info("point %s diagnosed: %s", event.point, result.verdict)
        if self._as_json:
            record = result.to_json()
            keys = (
                "drops",
                "verdict",
                "corrected",
                *result.DERIVED,
                "effects",
                "after",
                "warnings",
                "warning_codes",
            )
            diagnosis = {key: record[key] for key in keys}
            print(json_text({"point": event.point, "diagnosis": diagnosis}), flush=True)
            return
        print(f"point {clean(event.point)} diagnosed: {diagnosis_sentence(result)}", flush=True)

    def _forget(self, saved: SavedDrop) -> None:
        """Remove the intermediate results of a drop that has its last result."""
        self._first_moduli.pop((saved.point, saved.number), None)
        self._identical.pop((saved.point, saved.number), None)

    def _line(
        self,
        saved: SavedDrop,
        result: DropResult,
        delay: float | None = None,
        *,
        preliminary: bool | None = None,
    ) -> None:
        identical = self._identical.get((saved.point, saved.number))
        after = "" if delay is None else f", {delay:.3f} s after its last sample"
        log.info("%s%s", drop_line(saved.point, saved.number, result), after)
        if self._as_json:
            record = result.to_json()
            line = {
                "point": saved.point,
                "drop": saved.number,
                "saved": saved.record is not None or identical is not None,
                **({} if saved.record is None else {"record": saved.record}),
                **({} if saved.spare is None else {"spare": saved.spare}),
                **({} if identical is None else {"identical": identical}),
                **({} if delay is None else {"delay_s": delay}),
                **({} if preliminary is None else {"preliminary": preliminary}),
                **{key: value for key, value in record.items() if key not in ("point", "drop")},
            }
            print(json_text(line), flush=True)
            return
        line_text = drop_line(saved.point, saved.number, result)
        if identical is False:
            line_text += "  DIFFERS from the recorded traces"
        if saved.spare is not None:
            line_text += "  IN THE SPARE FOLDER"
        print(line_text, flush=True)


def point_text(point: PointView) -> str:
    """Return a complete point as a line: judged value, interval, target, verdict, settlements."""
    progress = point.progress
    value = progress.value
    text = "nothing to judge"
    if value is not None:
        text = f"{value.quantity.label} {SI.show(fact_of_value(value))}"
    parts = [f"point {clean(point.shown_name)}: {text}"]
    if value is not None and value.quantity.is_fitted and progress.modulus is not None:
        unjudged = value.quantity.other_fitted
        fact = fact_of_modulus(progress.modulus, unjudged)
        if fact.value is not None:
            parts.append(f"not judged: {unjudged.label} {SI.show(fact)}")
    if progress.target is not None:
        parts.append(f"target {target_text(progress.target)}")
    if progress.verdict is not Verdict.NONE:
        parts.append(f"{progress.verdict.value.upper()}: {text_of(progress.verdict_reason)}")
    used = [depth for number, _, depth in progress.compaction if number in progress.used]
    if used:
        listed = ", ".join(SI.text("settlement", depth) for depth in used)
        parts.append(f"settlement {listed} {SI.unit('settlement')}")
    return "  ".join(parts)
