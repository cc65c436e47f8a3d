"""A drop as it takes part in the judgement of its point, by its own record and beside the others.

What counts as a rebound is told by comparison with the largest drop of the point, which may come
later: a drop is therefore never judged once and for all, but with all drops that are known.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

from pfwd_device import Drop
from pfwd_survey.files.header import PointSetup
from pfwd_survey.inverting.drop_facts import point_drop, with_modulus
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.inverting.screening.drops import (
    Screening,
    pulse_peak,
    rebound_reason,
    screen,
)
from pfwd_survey.procedures import Kind, PointDrop


@dataclass(frozen=True, slots=True)
class MeasuredDrop:
    """What is known of one drop."""

    facts: PointDrop
    """By its own record: rejected, discarded, or measured; what it counts as follows from the
    other drops."""
    pulse_peak: float
    """By which it is compared with them, N; 0: it is not."""
    setup: PointSetup
    """What is declared of it now."""
    unmoved: "MeasuredDrop | None" = None
    """As it was before it was moved to another point, for who restores it; None: it was not."""

    def with_result(self, result: DropResult | None) -> "MeasuredDrop":
        """The same with the modulus of the result that counts."""
        facts = with_modulus(self.facts, result, self.setup)
        unmoved = None if self.unmoved is None else self.unmoved.with_result(result)
        if facts == self.facts and unmoved is None:
            return self
        return dataclasses.replace(self, facts=facts, unmoved=unmoved)

    def with_discarding(self, reason: str | None) -> "MeasuredDrop":
        """The same as a person discarded it; None: nobody did."""
        if self.unmoved is not None:
            return self.unmoved.with_discarding(reason)
        kind = self.facts.kind
        if kind is Kind.REJECTED:  # it stays what it is
            return self
        kind = Kind.MEASURED if reason is None else Kind.DISCARDED
        facts = dataclasses.replace(self.facts, kind=kind, reason=reason or None)
        return dataclasses.replace(self, facts=facts)

    def with_move(self, where: str) -> "MeasuredDrop":
        """The same as it was moved to another point: here it did not fall."""
        facts = PointDrop(self.facts.number, Kind.REJECTED, reason=where)
        return MeasuredDrop(facts, 0.0, self.setup, self.unmoved or self)


def measured_drop(
    drop: Drop,
    setup: PointSetup,
    screening: Screening | None = None,
    discarded: str | None = None,
) -> MeasuredDrop:
    """A drop by its own record.

    Parameters
    ----------
    drop : Drop
    setup : PointSetup
    screening : Screening, optional
        Of the drop, where it was looked at before.
    discarded : str, optional
        Why a person discarded it; "" without a reason, None: nobody did.
    """
    own = screen(drop, setup) if screening is None else screening
    if drop.only_peaks is not None and not setup.is_stiffness_test:
        return MeasuredDrop(_measured(point_drop(drop, setup, own)), 0.0, setup).with_discarding(
            discarded
        )
    found = point_drop(drop, setup, own)
    if found.kind is Kind.REJECTED:
        return MeasuredDrop(found, 0.0, setup)
    return MeasuredDrop(_measured(found), pulse_peak(drop), setup).with_discarding(discarded)


def _measured(facts: PointDrop) -> PointDrop:
    """Which drops are seating is counted with all of them."""
    return dataclasses.replace(facts, kind=Kind.MEASURED)


def compared(drops: Sequence[MeasuredDrop]) -> list[PointDrop]:
    """The drops of a point beside each other: rebounds rejected, seating drops counted.

    Parameters
    ----------
    drops : sequence of MeasuredDrop
        In the order they fell.
    """
    largest = max((drop.pulse_peak for drop in drops), default=0.0)
    found, rejected = [], 0
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
        found.append(facts)
    return found
