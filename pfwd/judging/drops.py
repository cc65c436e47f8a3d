"""One drop of a survey, and its kind among the drops of its point.

A rebound is recognised by comparison with the largest drop of its point, which may come later.
Hence a drop has facts of its own record, and `classify_drops` decides with all drops of the point.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from inversion.notices import Notice
from pfwd.analysis.drop_facts import JudgedDeflection, uncompared_facts, with_modulus
from pfwd.analysis.results import DropResult, TimeHistories
from pfwd.analysis.screening.drops import Screening, rebound_reason, screen
from pfwd.files.header import PointSetup
from pfwd.peaks.stiffness import Stiffness
from pfwd.procedures import Kind, PointDrop
from pfwd_device import Drop
from pfwd_device.drop import Peaks
from pfwd_device.recording.survey_content import SurveyDrop


@dataclass(frozen=True, eq=False)
class DropView:
    """One drop of a survey, as every reader has it."""

    own: PointDrop
    """Facts of its own record alone: rejected or measured."""
    own_pulse_peak: float
    """Peak by which rebounds are recognised, N; 0: the drop is not compared."""
    setup: PointSetup
    """Present setup."""
    discarded: str | None = None
    """Reason of the person who discarded it, which may be empty; None: it is not discarded."""
    moved_to: str | None = None
    """Sentence that names the point to which it was moved; None: it was not moved."""
    result: DropResult | None = None
    """Result that counts: the last sound one, if it rests on the setup."""
    sound_result: DropResult | None = None
    """Last sound result that is no trial, whatever setup it rests on."""
    last_result: DropResult | None = None
    """Last result that is no trial, even if it lacks values."""
    record: int | None = None
    """Number within the survey; None: it is not saved."""
    notes: tuple[str, ...] = ()
    declared: Mapping[str, Any] | None = None
    """Keys of a header as recorded; None: the record is damaged, or the drop is being measured."""
    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Position, times, operator, identity and marks as recorded."""
    peaks: Peaks | None = None
    """Peaks as recorded; None: samples around the trigger are missing, or there is no record."""
    has_traces: bool = True
    """False for a drop of which only the peaks were recorded."""
    fault: str | None = None
    """Damage of the record or of its results; None: no damage."""
    screening: Screening | None = None
    """Screening of its traces; None: its facts are stored, and the traces were not read."""
    curves: TimeHistories | None = None
    """Measured and fitted, for a report; None: there are none, or the traces were not read."""
    deflection: JudgedDeflection | None = None
    """Deflection whose peak is judged, for a report; None: none, or the traces were not read."""
    stiffness: Stiffness | None = None
    """Stiffness of the rig under it, for a report; None: it is on ground, or not read."""
    source: SurveyDrop | None = None
    """The stored drop, for its traces; None: it is measured now, or came from another process."""

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for another process, which does not have the survey."""
        return {**self.__dict__, "source": None}

    @property
    def number(self) -> int:
        """Number within the point."""
        return self.own.number

    @property
    def marks(self) -> tuple[str, ...]:
        """Irregularities of the record."""
        return tuple(map(str, self.metadata.get("marks") or ()))

    @property
    def warnings(self) -> tuple[Notice, ...]:
        """Warnings of the screening and of the result, each once."""
        screened = () if self.screening is None else self.screening.warnings
        warnings = () if self.result is None else self.result.warnings or ()
        return (*screened, *(warning for warning in warnings if warning not in screened))

    @property
    def left_out(self) -> tuple[float, ...]:
        """Distances of the sensors that take no part in the fit, m, once its traces are read."""
        return () if self.screening is None else self.screening.left_out

    @cached_property
    def facts(self) -> PointDrop:
        """Facts after a person discarded or moved the drop, with its modulus."""
        if self.moved_to is not None:
            return PointDrop(self.number, Kind.REJECTED, reason=self.moved_to)
        facts = with_modulus(self.own, self.result, self.setup)
        if self.discarded is None or facts.kind is Kind.REJECTED:
            return facts
        reason = self.discarded or None
        return dataclasses.replace(facts, kind=Kind.DISCARDED, reason=reason)

    @property
    def pulse_peak(self) -> float:
        """Peak for the comparison with the other drops of its point, N; 0: it is not compared."""
        return 0.0 if self.moved_to is not None else self.own_pulse_peak

    def with_result(self, result: DropResult | None) -> "DropView":
        """Return the drop with a result in place of the stored ones."""
        return dataclasses.replace(self, result=result, sound_result=result, last_result=result)


def drop_from_traces(drop: Drop, setup: PointSetup, **more: Any) -> DropView:
    """Screen a drop by its own record, and return it with its facts.

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
    """Return the facts of the drops of a point: rebounds rejected, seating drops counted.

    Parameters
    ----------
    drops : sequence of DropView
        In the order they fell.
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
