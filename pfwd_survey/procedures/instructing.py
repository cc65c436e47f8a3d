"""What is to be done next at a point, in one sentence."""

from collections.abc import Sequence

from pfwd_survey.procedures.point import Kind
from pfwd_survey.procedures.profile import Procedure
from pfwd_survey.procedures.sorting import SortedDrops


def next_step(
    procedure: Procedure, sorted_drops: SortedDrops, faults: Sequence[str]
) -> tuple[Kind | None, str]:
    """Kind of the next drop, None when the point is done, and what is to be done."""
    seating, measured = procedure.seating_drops, procedure.measured_drops
    seating_done, complete = sorted_drops.seating_done, sorted_drops.complete
    repeated = _to_be_repeated(sorted_drops)
    again = "" if repeated is None else f"Drop {repeated[0]} does not count ({repeated[1]}): "
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
    if faults:
        return None, (
            f"{faults[0][0].upper()}{faults[0][1:]}: see that the plate lies flat, and measure the "
            "point anew beside this place."
        )
    return None, "The point is done: walk to the next."


def _to_be_repeated(sorted_drops: SortedDrops) -> tuple[int, str] | None:
    """The last drop and its reason when it is one to be repeated."""
    drops = sorted_drops.drops
    if not drops or drops[-1].kind is Kind.SEATING:
        return None
    for number, reason in sorted_drops.excluded:
        if number == drops[-1].number and not reason.startswith(("seating", "beyond")):
            return number, reason
    return None
