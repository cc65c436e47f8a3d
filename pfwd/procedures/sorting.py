"""Which drops of a point seat the plate, which are averaged, and which take no part, and why."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pfwd.procedures.point import ExcludedDrop, Exclusion, Kind, PointDrop
from pfwd.procedures.profile import CHECKS, Procedure

_DROP_CHECKS: tuple[tuple[str, str, float], ...] = (
    # key, attribute of the drop, +1: at least, -1: at most
    ("false_trigger_load_n", "peak_load", 1),
    ("least_peak_load_n", "peak_load", 1),
    ("most_peak_load_n", "peak_load", -1),
    ("shortest_pulse_s", "pulse_duration", 1),
    ("longest_pulse_s", "pulse_duration", -1),
    ("least_deflection_m", "peak_deflection", 1),
    ("most_deflection_m", "peak_deflection", -1),
    ("most_offset_over_peak", "offset_over_peak", -1),
    ("most_return_over_peak", "return_over_peak", -1),
)


@dataclass(frozen=True, slots=True)
class SortedDrops:
    """The drops of a point, by what a procedure makes of them."""

    drops: Sequence[PointDrop]
    """All of the point, in the order they fell."""
    kinds: Mapping[int, Kind]
    """What each counts as by the procedure, by its number."""
    usable: Sequence[PointDrop]
    """Measured drops without fault."""
    used: Sequence[PointDrop]
    """Those of them that are averaged: as many as the procedure wants, the first ones."""
    excluded: Sequence[ExcludedDrop]
    """Every drop that takes no part."""
    seating_done: int
    complete: bool
    """Whether enough drops are in."""
    counted: bool
    """Whether the procedure says how many that are; then each of them has to say its part."""


def kind_of(procedure: Procedure, rejected: Sequence[bool], seating: int = 0) -> Kind:
    """Which kind the next drop of a point is.

    Parameters
    ----------
    procedure : Procedure
    rejected : sequence of bool
        For every drop before it: whether the screening rejected it. Such a drop did not load the
        ground as a drop does, and therefore does not seat the plate.
    seating : int
        Seating drops where the procedure does not enforce a number.
    """
    wanted = procedure.seating_drops
    loaded = sum(not was_rejected for was_rejected in rejected)
    return Kind.SEATING if loaded < (seating if wanted is None else wanted) else Kind.MEASURED


def sort_drops(procedure: Procedure, drops: Sequence[PointDrop], notes: list[str]) -> SortedDrops:
    """The drops of a point, sorted; what checks that are not enforced find goes to the notes."""
    wanted = procedure.measured_drops
    usable, excluded, seating_done = _sort_out(procedure, drops, notes)
    used = usable if wanted is None else usable[:wanted]
    beyond = usable[len(used) :]
    text = f"beyond the {wanted} measured drops"
    excluded += [ExcludedDrop(drop.number, Exclusion.BEYOND, text) for drop in beyond]
    complete = len(used) >= (wanted or 1)
    kinds = _kinds(procedure, drops)
    return SortedDrops(
        drops, kinds, usable, used, excluded, seating_done, complete, wanted is not None
    )


def _sort_out(
    procedure: Procedure, drops: Sequence[PointDrop], notes: list[str]
) -> tuple[list[PointDrop], list[ExcludedDrop], int]:
    """Usable drops, excluded ones with their reasons, seating drops done."""
    wanted = procedure.seating_drops
    usable: list[PointDrop] = []
    excluded: list[ExcludedDrop] = []
    loaded = seating_done = 0
    unenforced: dict[str, list[int]] = {}
    for drop in drops:

        def leave_out(why: Exclusion, reason: str, number: int = drop.number) -> None:
            excluded.append(ExcludedDrop(number, why, reason))

        if drop.kind is Kind.REJECTED:
            leave_out(Exclusion.REJECTED, f"rejected: {drop.reason or 'no drop'}")
            continue
        before, loaded = loaded, loaded + 1
        fault = _drop_fault(procedure, drop, unenforced)
        if wanted is not None and before < wanted:
            seating_done += 1
            leave_out(Exclusion.SEATING, f"seating drop {seating_done} of {wanted}")
        elif wanted is None and drop.kind is Kind.SEATING:
            seating_done += 1
            leave_out(Exclusion.SEATING, "seating drop")
        elif drop.kind is Kind.DISCARDED:
            why = f": {drop.reason}" if drop.reason else ""
            leave_out(Exclusion.DISCARDED, f"discarded{why}")
        elif fault:
            leave_out(Exclusion.FAULT, fault)
        else:
            usable.append(drop)
    for text, numbers in unenforced.items():
        names = ", ".join(map(str, numbers))
        notes.append(f"drop{'s' if len(numbers) > 1 else ''} {names}: {text}")
    return usable, excluded, seating_done


def _kinds(procedure: Procedure, drops: Sequence[PointDrop]) -> dict[int, Kind]:
    """What the drops count as by the procedure; as they were marked where it does not say."""
    wanted, loaded, kinds = procedure.seating_drops, 0, {}
    for drop in drops:
        kinds[drop.number] = drop.kind
        if drop.kind is Kind.REJECTED:
            continue
        if wanted is not None and drop.kind is not Kind.DISCARDED:
            kinds[drop.number] = Kind.SEATING if loaded < wanted else Kind.MEASURED
        loaded += 1
    return kinds


def _drop_fault(
    procedure: Procedure, drop: PointDrop, unenforced: dict[str, list[int]]
) -> str | None:
    """What an enforced check finds wrong with a drop; what others find is noted by its text."""
    found = None
    for key, attribute, sign in _DROP_CHECKS:
        number, value = procedure.checks.get(key), getattr(drop, attribute)
        if number is None or value is None or sign * (value - number.value) >= 0:
            continue
        check = CHECKS[key]
        text = (
            f"{attribute.replace('_', ' ')} {value * check.scale:.3g} {check.unit}, "
            f"{'less' if sign > 0 else 'more'} than {number.value * check.scale:.3g} {check.unit}"
        )
        if procedure.enforced(number) is None:
            side = "less" if sign > 0 else "more"
            text = f"{attribute.replace('_', ' ')} {side} than {number.value * check.scale:.3g}"
            text += f" {check.unit} (not verified, not enforced)"
            unenforced.setdefault(text, []).append(drop.number)
        elif found is None:
            found = text
    return found
