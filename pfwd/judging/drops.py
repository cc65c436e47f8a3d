"""Drops of a survey as readers need them, and the comparison of the drops of a point.

A rebound is recognised by comparison with the largest drop of its point, which may come later.
Hence `DropView` holds the facts from a drop's own record, and `classify_drops` corrects them when
all drops of the point are known.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from inversion.notices import Notice
from pfwd.analysis.diagnosed_drop import DiagnosedDrop
from pfwd.analysis.drop_facts import JudgedDeflection, uncompared_facts, with_modulus
from pfwd.analysis.results import DropResult, TimeHistories
from pfwd.analysis.screening.drops import Screening, rebound_reason, screen
from pfwd.files.editing import MOVED
from pfwd.files.header import PointSetup
from pfwd.files.record_marks import SATURATED, copy_fault, marks_in
from pfwd.peaks.stiffness import Stiffness
from pfwd.procedures import Kind, PointDrop
from pfwd_device import Drop
from pfwd_device.drop import Peaks
from pfwd_device.recording.survey_reader import SurveyDrop

RATE_DEVIATION = "rate_deviation"
"""Key of a drop's metadata, and kind of a drop's edit: true over declared sampling rate minus 1."""


@dataclass(frozen=True, eq=False)
class DropView:
    """One drop of a survey: facts for the judgement, its results, and what was recorded with it."""

    own: PointDrop
    """Facts from its own record alone: rejected or measured."""
    own_pulse_peak: float
    """Peak of the load pulse, N, which is compared to recognise rebounds; 0: it is not compared."""
    setup: PointSetup
    """Setup as declared now, later edits included."""
    discarded: Notice | None = None
    """Reason for which the operator discarded or moved it; None: it counts."""
    result: DropResult | None = None
    """Result to show: the last one, if it was computed with the present setup; None: there is
    none."""
    last_result: DropResult | None = None
    """Last result, whatever setup it was computed with; trials of other settings do not count."""
    record: int | None = None
    """Number of the drop in its survey; None: it is not saved."""
    notes: tuple[str, ...] = ()
    declared: Mapping[str, Any] | None = None
    """Declarations recorded with it, by the keys of a header; None: the record is damaged, or the
    drop is being measured."""
    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Recorded position, times, operator, identity of the device, and marks."""
    peaks: Peaks | None = None
    """Recorded peaks; None: there is no record, or samples around the trigger are missing."""
    has_traces: bool = True
    """False if only the peaks were recorded."""
    fault: str | None = None
    """Damage of the record or of its results; None: no damage."""
    screening: Screening | None = None
    """Screening of its traces; None: the facts are stored, and the traces were not read."""
    curves: TimeHistories | None = None
    """Measured and fitted traces, for a report; None: there are none, or they were not read."""
    deflection: JudgedDeflection | None = None
    """Deflection trace whose peak is judged, for a report; None: there is none, or it was not
    read."""
    stiffness: Stiffness | None = None
    """Stiffness of the test rig, for a report; None: the drop was on ground, or was not read."""
    awaits_result: bool = False
    """True: a result, or a better one, is being computed in the session that measures it."""
    rebounds: tuple[float, ...] = ()
    """Peak loads of the bounces after it, N; empty for a stored drop."""
    identical: bool | None = None
    """In a replay: True if its traces equal the recorded ones; None: not a replay."""
    source: SurveyDrop | None = None
    """Stored drop, from which the traces can be read; None: the drop is being measured, or this
    object came from another process."""

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "source": None}

    @property
    def number(self) -> int:
        """Number of the drop at its point."""
        return self.own.number

    @property
    def marks(self) -> tuple[Notice, ...]:
        """Irregularities of the record, such as missing samples."""
        return marks_in(self.metadata)

    @property
    def moved_to(self) -> Notice | None:
        """Message that names the point to which the operator moved it; None: it was not moved."""
        is_moved = self.discarded is not None and self.discarded.code == MOVED
        return self.discarded if is_moved else None

    @property
    def saturation(self) -> Notice | None:
        """Mark of a saturated channel; None: no channel reached the end of its range."""
        return next((mark for mark in self.marks if mark.code == SATURATED), None)

    @property
    def warnings(self) -> tuple[Notice, ...]:
        """Warnings of the screening and of the result, without repetitions."""
        screened = () if self.screening is None else self.screening.warnings
        warnings = () if self.result is None else self.result.warnings
        return (*screened, *(warning for warning in warnings if warning not in screened))

    @property
    def left_out(self) -> tuple[float, ...]:
        """Distances, m, of the sensors that are excluded from the fit.

        The tuple is empty until the traces are read.
        """
        return () if self.screening is None else self.screening.left_out

    @cached_property
    def facts(self) -> PointDrop:
        """Facts with the fitted modulus and the operator's edits.

        A moved drop is rejected, and a discarded one is marked as discarded.
        """
        if self.moved_to is not None:
            return PointDrop(self.number, Kind.REJECTED, reason=self.moved_to)
        facts = with_modulus(self.own, self.result, self.setup, self.warnings)
        facts = dataclasses.replace(facts, peak_fault=self.saturation)
        deviation, fault = self.metadata.get(RATE_DEVIATION), copy_fault(self.metadata)
        if isinstance(deviation, float):
            fault = Notice("sampling-rate-wrong", {"deviation": abs(deviation)})
        if fault is not None:
            facts = dataclasses.replace(facts, record_fault=fault, fit_fault=fault)
        if self.discarded is None or facts.kind is Kind.REJECTED:
            return facts
        return dataclasses.replace(facts, kind=Kind.DISCARDED, reason=self.discarded)

    @property
    def pulse_peak(self) -> float:
        """Peak of the load pulse for the comparison with the other drops, N.

        0: it is not compared.
        """
        return 0.0 if self.moved_to is not None else self.own_pulse_peak

    def with_result(self, result: DropResult | None) -> "DropView":
        """Return the drop with this result in place of the stored ones."""
        return dataclasses.replace(self, result=result, last_result=result)

    def in_diagnosis(self, fit: DiagnosedDrop | None) -> "DropView":
        """Return the drop with curves and residuals of a diagnosis in place of its own fit.

        None: the drop was not fitted.
        """
        return dataclasses.replace(
            self,
            result=self.result and self.result.in_diagnosis(fit),
            curves=fit.drawn_on(self.curves) if fit and self.curves else None,
        )

    @property
    def has_layers(self) -> bool:
        """True if its result has a profile of moduli."""
        return self.result is not None and len(self.result.layers or ()) > 1

    def without_modulus(self) -> "DropView":
        """Return the drop without the ground that was fitted to it; residuals remain."""
        return dataclasses.replace(
            self,
            result=self.result and self.result.without_ground(),
            last_result=self.last_result and self.last_result.without_ground(),
        )


def drop_from_traces(drop: Drop, setup: PointSetup, **more: Any) -> DropView:
    """Screen a drop by its own record, and return it with the facts that follow.

    Parameters
    ----------
    drop : Drop
    setup : PointSetup
    **more
        Further fields of the DropView.
    """
    screening = screen(drop, setup)
    return DropView(*uncompared_facts(drop, setup, screening), setup, screening=screening, **more)


def classify_drops(drops: Sequence[DropView]) -> list[PointDrop]:
    """Return the facts of all drops of a point.

    Rebounds become rejected, and the first drops become seating drops.

    Parameters
    ----------
    drops : sequence of DropView
        All drops of the point, in the order they fell.
    """
    largest = max((drop.pulse_peak for drop in drops), default=0.0)
    classified, rejected = [], 0
    for drop in drops:
        facts = drop.facts
        if facts.kind is not Kind.REJECTED and drop.pulse_peak > 0:
            reason = rebound_reason(drop.pulse_peak, largest)
            if reason is not None:
                facts = PointDrop(facts.number, Kind.REJECTED, reason=reason)
        if facts.kind is Kind.REJECTED:
            rejected += 1
        elif facts.kind is Kind.MEASURED:
            # With a procedure what did not load the ground does not seat the plate either.
            before = rejected if drop.setup.procedure is not None else 0
            if facts.number - before <= drop.setup.seating_drops:
                facts = dataclasses.replace(facts, kind=Kind.SEATING)
        classified.append(facts)
    return classified
