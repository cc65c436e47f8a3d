"""Assignment of roles to the drops of a point: seating, averaged, or excluded with a reason."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from inversion.notices import Notice, Value, of_drops
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


def sort_drops(
    procedure: Procedure, drops: Sequence[PointDrop], notes: list[Notice]
) -> SortedDrops:
    """Assign a role to each drop of a point.

    Parameters
    ----------
    procedure : Procedure
    drops : sequence of PointDrop
        All drops of the point, in the order they fell.
    notes : list of Notice
        Violations of checks that are not enforced are appended.
    """
    required_seating = procedure.seating_drops
    usable: list[PointDrop] = []
    excluded: list[ExcludedDrop] = []
    kinds: dict[int, Kind] = {}
    loaded = seating = 0
    unenforced: dict[Notice, list[int]] = {}
    for drop in drops:

        def exclude(why: Exclusion, reason: Notice, number: int = drop.number) -> None:
            excluded.append(ExcludedDrop(number, why, reason))

        kinds[drop.number] = drop.kind
        if drop.kind is Kind.REJECTED:
            reason = drop.reason or Notice("no-drop")
            exclude(Exclusion.REJECTED, Notice("rejected", {"reason": reason}))
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
            exclude(Exclusion.SEATING, _seating_drop(seating, required_seating))
        elif drop.kind is Kind.DISCARDED:
            exclude(Exclusion.DISCARDED, drop.reason or Notice("discarded"))
        elif fault:
            exclude(Exclusion.FAULT, fault)
        else:
            usable.append(drop)
    notes += [of_drops(violation, *numbers) for violation, numbers in unenforced.items()]
    required = procedure.measured_drops
    used = usable if required is None else usable[:required]
    beyond = Notice("beyond-measured", {"required": len(used)})
    excluded += [ExcludedDrop(d.number, Exclusion.BEYOND, beyond) for d in usable[len(used) :]]
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


def _seating_drop(number: int, required: int | None) -> Notice:
    if required is None:
        return Notice("seating-drop")
    return Notice("seating-drop-of", {"number": number, "required": required})


def _drop_fault(
    procedure: Procedure, drop: PointDrop, unenforced: dict[Notice, list[int]]
) -> Notice | None:
    """Return the reason why a drop is not averaged; None: there is none.

    It is a fault of its peaks, or the first violation of an enforced check of single drops.

    For a violated check that is not enforced, the drop's number is appended to
    ``unenforced[violation]``.
    """
    fault = drop.peak_fault
    for key, attribute, sign in _DROP_CHECKS:
        number, value = procedure.checks.get(key), getattr(drop, attribute)
        if number is None or value is None or sign * (value - number.value) >= 0:
            continue
        check = CHECKS[key]
        side = "small" if sign > 0 else "large"
        limit: dict[str, Value] = {
            "limit": number.value * check.scale,
            "unit": check.unit,
            "quantity": attribute,
        }
        if procedure.enforced(number) is None:
            unenforced.setdefault(Notice(f"values-too-{side}", limit), []).append(drop.number)
        elif fault is None:
            fault = Notice(f"value-too-{side}", {"value": value * check.scale, **limit})
    return fault
