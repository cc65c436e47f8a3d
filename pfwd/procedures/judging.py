"""Judgement of the drops of a test point by a measuring procedure: value, verdict and next step.

The function `judge` depends on its arguments only; it reads no file and keeps no state.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

from inversion.notices import Notice, Value, text_notice
from pfwd.digits import with_ends
from pfwd.errors import OptionError, refusal
from pfwd.procedures.point import (
    LARGEST_PLATE_RADIUS_M,
    DiagnosedModulus,
    ExcludedDrop,
    Exclusion,
    Kind,
    PointDrop,
    PointModulus,
    PointProgress,
    PointValue,
    ReasonCode,
    Verdict,
)
from pfwd.procedures.preconditions import violated_preconditions
from pfwd.procedures.profile import OUR_TOLERANCES, Procedure, Quantity, term_of_number
from pfwd.procedures.sorting import SortedDrops, sort_drops
from pfwd.procedures.values import (
    MIN_DROPS_FOR_INTERVAL,
    mean,
    moduli_of,
    recorded_values,
    spread,
    stress_of,
    unsupported_records,
    value_of,
)

MAX_DEFLECTION_M = 1.0
"""A target below this number is a deflection in m, a larger one a modulus in Pa."""

_ALWAYS_ENFORCED = frozenset({"nominal_load_n", "plate_radius_m", *OUR_TOLERANCES})
"""Keys of plate, load and their tolerances: enforced even where no verified source states them."""


_REPEATED = frozenset({Exclusion.REJECTED, Exclusion.DISCARDED, Exclusion.FAULT})
"""Reasons of exclusion after which the operator has to repeat the drop."""


@dataclass(frozen=True, slots=True)
class _Scatter:
    """Relative scatter of the averaged drops; a value is None when too few drops have it."""

    deflection: float | None
    """Largest minus smallest deflection, over the mean; load and modulus are computed alike."""
    load: float | None
    modulus: float | None
    change: float | None
    """Relative change of the deflection from the first to the last averaged drop."""
    s_over_v: float | None
    """Mean deflection over mean peak velocity, s."""


def judge(
    procedure: Procedure,
    drops: Sequence[PointDrop],
    *,
    plate_radius: float,
    poisson_ratio: float | None = None,
    target: float | None = None,
    moisture: float | None = None,
    material: str | None = None,
    diagnosed: DiagnosedModulus | None = None,
    centre_sensor: str | None = None,
    earlier_violations: Sequence[Notice] = (),
) -> PointProgress:
    """Judge the drops of a point by a procedure.

    Parameters
    ----------
    procedure : Procedure
    drops : sequence of PointDrop
        All drops of the point, in the order they fell.
    plate_radius : float, m
        0: no plate, which is allowed when all drops are rejected.
    poisson_ratio : float, optional
        Declared for the point; ignored where the procedure states a value.
    target : float, Pa (m for a deflection), optional
        Target declared for the point; the targets of the procedure are then ignored.
    moisture : float, percent, optional
        Selects one of the procedure's targets.
    material : str, optional
        Selects one of the procedure's targets.
    diagnosed : DiagnosedModulus, optional
        Replaces the fitted modulus where the diagnosis permits its use.
    centre_sensor : str, optional
        Place of the centre sensor, "plate" or "ground"; None: it is not compared.
    earlier_violations : sequence of Notice
        Violated preconditions that the caller detected.

    Returns
    -------
    PointProgress

    Raises
    ------
    OptionError
        If the plate radius is not positive or too large.
    """
    on_rig = plate_radius == 0 and all(drop.kind is Kind.REJECTED for drop in drops)
    if not (on_rig or 0 < plate_radius <= LARGEST_PLATE_RADIUS_M):
        raise OptionError(
            refusal(
                "plate radius",
                f"a number > 0 and at most {LARGEST_PLATE_RADIUS_M:g}, in m",
                f"{plate_radius:g}",
            )
        )
    notes = _notes(procedure)
    sorted_drops = sort_drops(procedure, drops, notes)
    used = sorted_drops.used
    preconditions = violated_preconditions(procedure, used, plate_radius, centre_sensor)
    violated = [*earlier_violations, *preconditions]
    record_fault = unsupported_records(used)
    modulus, other_modulus = moduli_of(procedure, used, diagnosed)
    withheld = None
    if diagnosed is not None and (modulus is None or modulus.value is None):
        withheld = diagnosed.use_reason
    if modulus is not None and record_fault is not None:
        modulus = dataclasses.replace(modulus, not_supported=record_fault, not_supported_code=None)
    if procedure.quantity.is_fitted:
        if len(used) == 1 and modulus is not None and modulus.source == "fitted":
            notes.append(Notice("one-measured-drop"))
        notes += _modulus_notes(procedure.quantity, modulus, other_modulus, diagnosed)
    value = value_of(procedure, used, plate_radius, poisson_ratio, notes, modulus)
    reason = violated[0] if violated else record_fault
    if value is not None and reason is not None:
        value = dataclasses.replace(value, not_supported=reason, not_supported_code=None)
    scatter = _scatter(procedure.quantity, used)
    faults = _point_faults(procedure, scatter, value, notes)
    target, target_source = _goal(procedure, target, moisture, material, notes)
    _note_s_over_v(procedure, scatter.s_over_v, notes)
    verdict, reason, code = _verdict(
        procedure, value, target, violated, faults, sorted_drops, withheld, modulus
    )
    next_kind, instruction = next_step(procedure, sorted_drops, violated, faults)
    return PointProgress(
        next_kind=next_kind,
        instruction=instruction,
        seating_done=sorted_drops.seating,
        seating_wanted=procedure.seating_drops,
        measured_done=len(sorted_drops.usable),
        measured_wanted=procedure.measured_drops,
        complete=sorted_drops.complete,
        used=tuple(drop.number for drop in used),
        kinds=tuple(sorted_drops.kinds.items()),
        excluded=tuple(sorted(sorted_drops.excluded, key=lambda drop: drop.number)),
        faults=(*violated, *faults),
        notes=tuple(notes),
        value=value,
        modulus=modulus,
        withheld=withheld,
        other_modulus=other_modulus,
        deflection_spread=scatter.deflection,
        load_spread=scatter.load,
        modulus_spread=scatter.modulus,
        s_over_v=scatter.s_over_v,
        compaction=_compaction(sorted_drops),
        compaction_change=scatter.change,
        stress=stress_of(procedure, sorted_drops.usable, plate_radius, poisson_ratio),
        target=target,
        target_source=target_source,
        verdict=verdict,
        verdict_reason=reason,
        verdict_reason_code=code,
    )


def _notes(procedure: Procedure) -> list[Notice]:
    """Return the notes on unverified numbers of a procedure, which hold whatever the drops are."""
    notes = []
    unverified = [
        key
        for key, number in procedure.numbers().items()
        if not number.verified and not procedure.enforce_unverified
    ]
    in_formula = [key for key in unverified if key in ("factor", "nominal_pressure_pa")]
    if in_formula:
        numbers = tuple(map(term_of_number, in_formula))
        notes.append(Notice("unverified-in-formula", {"numbers": numbers}))
    ignored = [key for key in unverified if key not in in_formula and key not in _ALWAYS_ENFORCED]
    if ignored:
        notes.append(Notice("unverified", {"numbers": tuple(map(term_of_number, ignored))}))
    return notes


def _modulus_notes(
    quantity: Quantity,
    modulus: PointModulus | None,
    unused: PointModulus | None,
    diagnosed: DiagnosedModulus | None,
) -> list[Notice]:
    """Return notes that say whether the diagnosed or the fitted modulus of the point is used."""
    if diagnosed is None:
        return []
    if modulus is None or modulus.source == "fitted":
        return [Notice("diagnosed-not-used", {"reason": diagnosed.use_reason})]
    value = _rounded(modulus, quantity)
    fitted = None if unused is None else _rounded(unused, quantity)
    if value is None:
        return []
    values: dict[str, Value] = {"quantity": quantity, "modulus_mpa": value}
    if fitted is None:
        return [Notice("modulus-diagnosed", values)]
    return [Notice("modulus-diagnosed-and-fitted", {**values, "fitted_mpa": fitted})]


def _rounded(modulus: PointModulus, quantity: Quantity) -> str | None:
    """Return a modulus as text in MPa, rounded to the digits that its interval justifies."""
    value, interval = modulus.in_quantity(quantity)
    if value is None:
        return None
    if interval is None:
        return f"{value / 1e6:.3g}"
    return with_ends(value / 1e6, (interval[0] / 1e6, interval[1] / 1e6))[0]


def _scatter(quantity: Quantity, used: Sequence[PointDrop]) -> _Scatter:
    deflections, velocities = (
        recorded_values(used, "peak_deflection"),
        recorded_values(used, "peak_velocity"),
    )
    return _Scatter(
        deflection=spread(deflections),
        load=spread(recorded_values(used, "peak_load")),
        modulus=spread([m for drop in used if (m := drop.modulus_in(quantity)) is not None]),
        change=deflections[-1] / deflections[0] - 1 if len(deflections) > 1 else None,
        s_over_v=(
            mean(deflections) / mean(velocities)
            if velocities and len(velocities) == len(deflections)
            else None
        ),
    )


def _point_faults(
    procedure: Procedure,
    scatter: _Scatter,
    value: PointValue | None,
    notes: list[Notice],
) -> list[Notice]:
    """Return the violated checks of a point that are enforced.

    Violated checks that are not enforced are appended to ``notes``.
    """
    spreads = {
        "most_load_spread": scatter.load,
        "most_deflection_spread": scatter.deflection,
        "most_modulus_spread": scatter.modulus,
    }
    faults = []
    for key, scattered in spreads.items():
        number = procedure.checks.get(key)
        if number is None or scattered is None or scattered <= number.value:
            continue
        values: dict[str, Value] = {"spread": key, "value": scattered, "limit": number.value}
        fault = Notice("spread-too-large", values)
        if procedure.enforced(number) is None:
            notes.append(Notice("not-enforced", {"fault": fault}))
        else:
            faults.append(fault)
    if value is not None and value.quantity is not Quantity.DEFLECTION:
        low, high = procedure.limit("least_value_pa"), procedure.limit("most_value_pa")
        if low is not None and value.value < low:
            notes.append(Notice("below-range", {"quantity": value.quantity, "limit_pa": low}))
        if high is not None and value.value > high:
            notes.append(Notice("above-range", {"quantity": value.quantity, "limit_pa": high}))
    return faults


def _goal(
    procedure: Procedure,
    target: float | None,
    moisture: float | None,
    material: str | None,
    notes: list[Notice],
) -> tuple[float | None, Notice | None]:
    """Return the target and its source: that of the point if it fits, else of the procedure.

    A target fits if it is of the judged quantity.
    """
    if target is not None and is_target_for(procedure, target):
        return target, Notice("target-of-point")
    if target is not None:
        is_deflection = procedure.quantity is Quantity.DEFLECTION
        notes.append(Notice("target-is-modulus" if is_deflection else "target-is-deflection"))
    default = procedure.target_for(moisture, material)
    if default is None:
        return None, None
    return default.value.value, text_notice(default.value.source)


def is_target_for(procedure: Procedure, target: float) -> bool:
    """Return whether a target is of the quantity that a procedure judges.

    A number below 1 is a deflection in m, a larger one a modulus in Pa: moduli begin at 100 kPa,
    and deflections are smaller than the radius of a plate.
    """
    return (procedure.quantity is Quantity.DEFLECTION) == (target < MAX_DEFLECTION_M)


def _note_s_over_v(procedure: Procedure, s_over_v: float | None, notes: list[Notice]) -> None:
    limit = procedure.limit("most_s_over_v_s")
    if s_over_v is not None and limit is not None and s_over_v > limit:
        notes.append(Notice("s-over-v-too-large", {"s_over_v_s": s_over_v, "limit_s": limit}))


def _verdict(
    procedure: Procedure,
    value: PointValue | None,
    target: float | None,
    violated: Sequence[Notice],
    faults: Sequence[Notice],
    drops: SortedDrops,
    withheld: Notice | None,
    modulus: PointModulus | None,
) -> tuple[Verdict, Notice, ReasonCode | None]:
    undecided = Verdict.UNDECIDED
    if target is None:
        return Verdict.NONE, Notice("no-target"), None
    if violated:
        return undecided, violated[0], ReasonCode.PRECONDITION
    if not drops.complete:
        return undecided, Notice("drops-missing"), ReasonCode.DROPS_MISSING
    if value is None and withheld is not None and procedure.quantity.is_fitted:
        values: dict[str, Value] = {"quantity": procedure.quantity.term, "reason": withheld}
        return undecided, Notice("not-supported", values), ReasonCode.NOT_SUPPORTED
    if value is None and modulus is not None and procedure.quantity.is_fitted:
        return undecided, Notice("no-equivalent-modulus"), ReasonCode.VALUE_MISSING
    if value is None or (drops.counted and value.drops < len(drops.used)):
        return undecided, Notice("value-missing"), ReasonCode.VALUE_MISSING
    if value.not_supported is not None:
        values = {"quantity": value.quantity.term, "reason": value.not_supported}
        return undecided, Notice("not-supported", values), ReasonCode.NOT_SUPPORTED
    if faults:
        return undecided, faults[0], ReasonCode.SCATTER
    if value.interval is None:
        reason = Notice("modulus-without-interval")
        if not value.quantity.is_fitted:
            counts = {"needed": MIN_DROPS_FOR_INTERVAL, "drops": value.drops}
            reason = Notice("interval-needs-drops", counts)
        return undecided, reason, ReasonCode.DROPS_MISSING
    low, high = value.interval
    if value.quantity is Quantity.DEFLECTION:  # smaller is better
        reached, missed = high <= target, low > target
    else:
        reached, missed = low >= target, high < target
    if reached:
        return Verdict.PASS, Notice("target-reached"), ReasonCode.DECIDED
    if missed:
        return Verdict.FAIL, Notice("target-missed"), ReasonCode.DECIDED
    return undecided, Notice("target-within-interval"), ReasonCode.INTERVAL


def _compaction(sorted_drops: SortedDrops) -> tuple[tuple[int, str, float], ...]:
    return tuple(
        (drop.number, sorted_drops.kinds[drop.number].value, drop.peak_deflection)
        for drop in sorted_drops.drops
        if drop.kind is not Kind.REJECTED and drop.peak_deflection is not None
    )


def next_step(
    procedure: Procedure,
    sorted_drops: SortedDrops,
    violated: Sequence[Notice],
    faults: Sequence[Notice],
) -> tuple[Kind | None, Notice]:
    """Return the kind of the next drop, and the instruction for the operator.

    The kind is None when the point is done.

    Parameters
    ----------
    procedure : Procedure
    sorted_drops : SortedDrops
    violated : sequence of Notice
        Preconditions of the procedure that the point violates.
    faults : sequence of Notice
        Faults that the other enforced checks of the procedure report.
    """
    seating, measured = procedure.seating_drops, procedure.measured_drops
    kind = Kind.MEASURED
    if seating is not None and sorted_drops.seating < seating:
        kind = Kind.SEATING
        numbers = {"number": sorted_drops.seating + 1, "required": seating}
        following = Notice("next-seating-drop", numbers)
    elif measured is None:
        following = Notice("enough-drops" if sorted_drops.complete else "next-drop")
    elif not sorted_drops.complete:
        numbers = {"number": len(sorted_drops.used) + 1, "required": measured}
        following = Notice("next-measured-drop", numbers)
    elif violated:
        return None, Notice("correct-and-repeat", {"fault": violated[0]})
    elif faults:
        return None, Notice("seat-and-repeat", {"fault": faults[0]})
    else:
        return None, Notice("point-done")
    repeated = _drop_to_repeat(sorted_drops)
    if repeated is None:
        return kind, following
    if measured is None and kind is Kind.MEASURED:
        following = Notice("next-drop")
    values: dict[str, Value] = {"drop": repeated.number, "reason": repeated.reason}
    return kind, Notice("drop-does-not-count", {**values, "next": following})


def _drop_to_repeat(sorted_drops: SortedDrops) -> ExcludedDrop | None:
    """Return the last drop if it has to be repeated, else None."""
    drops = sorted_drops.drops
    if not drops or drops[-1].kind is Kind.SEATING:
        return None
    for excluded in sorted_drops.excluded:
        if excluded.number == drops[-1].number and excluded.why in _REPEATED:
            return excluded
    return None
