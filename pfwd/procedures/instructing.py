"""What is to be done next at a point, in one sentence."""

from collections.abc import Sequence

from pfwd.procedures.point import ExcludedDrop, Exclusion, Kind
from pfwd.procedures.profile import Procedure
from pfwd.procedures.sorting import SortedDrops

_REPEATED = frozenset({Exclusion.REJECTED, Exclusion.DISCARDED, Exclusion.FAULT})
"""Why a drop is to be repeated; a seating drop, or one too many, is none the worse."""


def next_step(
    procedure: Procedure,
    sorted_drops: SortedDrops,
    violated: Sequence[str],
    faults: Sequence[str],
) -> tuple[Kind | None, str]:
    """Return the kind of the next drop, None when the point is done, and an instruction.

    Parameters
    ----------
    procedure : Procedure
    sorted_drops : SortedDrops
    violated : sequence of str
        Preconditions of the procedure that the point violates.
    faults : sequence of str
        Faults that other checks of the procedure report.
    """
    seating, measured = procedure.seating_drops, procedure.measured_drops
    seating_done, complete = sorted_drops.seating_done, sorted_drops.complete
    repeated = _to_be_repeated(sorted_drops)
    again = ""
    if repeated is not None:
        again = f"Drop {repeated.number} does not count ({repeated.reason}): "
    if seating is not None and seating_done < seating:
        text = f"seating drop {seating_done + 1} of {seating}"
        return Kind.SEATING, f"{again}{text}." if again else f"Lift the weight for {text}."
    if measured is None:
        if complete and not again:
            text = "Enough for a mean; another measured drop makes it surer"
            return Kind.MEASURED, f"{text}."
        return Kind.MEASURED, f"{again}a measured drop." if again else "Lift the weight."
    if not complete:
        text = f"measured drop {len(sorted_drops.used) + 1} of {measured}"
        return Kind.MEASURED, f"{again}{text}." if again else f"Lift the weight for {text}."
    if violated:
        sentence = f"{violated[0][0].upper()}{violated[0][1:]}"
        return None, f"{sentence}: correct it and measure the point again beside this place."
    if faults:
        return None, (
            f"{faults[0][0].upper()}{faults[0][1:]}: see that the plate lies flat, and measure the "
            "point anew beside this place."
        )
    return None, "The point is done: walk to the next."


def _to_be_repeated(sorted_drops: SortedDrops) -> ExcludedDrop | None:
    """The last drop when it is one to be repeated."""
    drops = sorted_drops.drops
    if not drops or drops[-1].kind is Kind.SEATING:
        return None
    for excluded in sorted_drops.excluded:
        if excluded.number == drops[-1].number and excluded.why in _REPEATED:
            return excluded
    return None
