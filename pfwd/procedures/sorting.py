"""Assignment of roles to the drops of a point: seating, averaged, or excluded with a reason."""

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
    """Drops of a point with the role that a procedure assigns to each."""

    drops: Sequence[PointDrop]
    """All drops of the point, in the order they fell."""
    kinds: Mapping[int, Kind]
    """Kind of each drop by the procedure; the key is the drop's number."""
    usable: Sequence[PointDrop]
    """Measured drops that violate no enforced check."""
    used: Sequence[PointDrop]
    """Averaged drops: the first usable ones, up to the number that the procedure requires."""
    excluded: Sequence[ExcludedDrop]
    """Every drop that is not averaged, with the reason."""
    seating: int
    """Number of seating drops."""
    complete: bool
    """True when the required numbers of drops are reached."""
    counted: bool
    """True when the procedure requires a number of drops; each of them then needs a value."""


def kind_of(procedure: Procedure, rejected: Sequence[bool], seating: int = 0) -> Kind:
    """Return the kind of the next drop of a point: seating or measured.

    Parameters
    ----------
    procedure : Procedure
    rejected : sequence of bool
        For every earlier drop of the point, whether it was rejected. A rejected drop did not load
        the ground as a drop does, and therefore does not seat the plate.
    seating : int
        Number of seating drops, used when the procedure enforces none.
    """
    required = seating if procedure.seating_drops is None else procedure.seating_drops
    loaded = sum(not was_rejected for was_rejected in rejected)
    return Kind.SEATING if loaded < required else Kind.MEASURED


def sort_drops(procedure: Procedure, drops: Sequence[PointDrop], notes: list[str]) -> SortedDrops:
    """Assign a role to each drop of a point.

    Parameters
    ----------
    procedure : Procedure
    drops : sequence of PointDrop
        All drops of the point, in the order they fell.
    notes : list of str
        Violations of checks that are not enforced are appended, one sentence each.
    """
    required_seating = procedure.seating_drops
    usable: list[PointDrop] = []
    excluded: list[ExcludedDrop] = []
    kinds: dict[int, Kind] = {}
    loaded = seating = 0
    unenforced: dict[str, list[int]] = {}
    for drop in drops:

        def exclude(why: Exclusion, reason: str, number: int = drop.number) -> None:
            excluded.append(ExcludedDrop(number, why, reason))

        kinds[drop.number] = drop.kind
        if drop.kind is Kind.REJECTED:
            exclude(Exclusion.REJECTED, f"rejected: {drop.reason or 'no drop'}")
            continue
        seats = drop.kind is Kind.SEATING
        if required_seating is not None:
            seats = loaded < required_seating
            if drop.kind is not Kind.DISCARDED:
                kinds[drop.number] = Kind.SEATING if seats else Kind.MEASURED
        loaded += 1
        fault = _drop_fault(procedure, drop, unenforced)
        if seats:
            seating += 1
            total = "" if required_seating is None else f" {seating} of {required_seating}"
            exclude(Exclusion.SEATING, f"seating drop{total}")
        elif drop.kind is Kind.DISCARDED:
            why = f": {drop.reason}" if drop.reason else ""
            exclude(Exclusion.DISCARDED, f"discarded{why}")
        elif fault:
            exclude(Exclusion.FAULT, fault)
        else:
            usable.append(drop)
    for text, numbers in unenforced.items():
        names = ", ".join(map(str, numbers))
        notes.append(f"drop{'s' if len(numbers) > 1 else ''} {names}: {text}")
    required = procedure.measured_drops
    used = usable if required is None else usable[:required]
    for drop in usable[len(used) :]:
        reason = f"beyond the {required} measured drops"
        excluded.append(ExcludedDrop(drop.number, Exclusion.BEYOND, reason))
    return SortedDrops(
        drops=drops,
        kinds=kinds,
        usable=usable,
        used=used,
        excluded=excluded,
        seating=seating,
        complete=len(used) >= (required or 1),
        counted=required is not None,
    )


def _drop_fault(
    procedure: Procedure, drop: PointDrop, unenforced: dict[str, list[int]]
) -> str | None:
    """Return the reason why a drop is not averaged, as a text; None: there is none.

    It is a fault of its peaks, or the first violation of an enforced check of single drops.

    For a violated check that is not enforced, the drop's number is appended to
    ``unenforced[text]``.
    """
    fault = drop.peak_fault
    for key, attribute, sign in _DROP_CHECKS:
        number, value = procedure.checks.get(key), getattr(drop, attribute)
        if number is None or value is None or sign * (value - number.value) >= 0:
            continue
        check = CHECKS[key]
        name, side = attribute.replace("_", " "), "less" if sign > 0 else "more"
        limit = f"{side} than {number.value * check.scale:.3g} {check.unit}"
        if procedure.enforced(number) is None:
            text = f"{name} {limit} (not verified, not enforced)"
            unenforced.setdefault(text, []).append(drop.number)
        elif fault is None:
            fault = f"{name} {value * check.scale:.3g} {check.unit}, {limit}"
    return fault
