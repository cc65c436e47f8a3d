"""Judgement of the drops of a test point by a measuring procedure: value, verdict and next step.

The function `judge` depends on its arguments only; it reads no file and keeps no state.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

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
from pfwd.procedures.profile import CHECKS, OUR_TOLERANCES, Procedure, Quantity
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


@dataclass(frozen=True, slots=True)
class _Goal:
    """Target of a point, and the place where it was stated."""

    target: float | None
    """Pa, or m if the target is a deflection; None: there is no target."""
    source: str


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
    earlier_violations: Sequence[str] = (),
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
    earlier_violations : sequence of str
        Violated preconditions that the caller detected, one sentence each.

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
    if modulus is None and diagnosed is not None:
        withheld = diagnosed.use_reason
    if modulus is not None and record_fault is not None:
        modulus = dataclasses.replace(modulus, not_supported=record_fault, not_supported_code=None)
    if procedure.quantity.is_fitted:
        if len(used) == 1 and modulus is not None and modulus.source == "fitted":
            notes.append("one drop: the scatter between drops is not in the interval")
        notes += _modulus_notes(procedure.quantity, modulus, other_modulus, diagnosed)
    value = value_of(procedure, used, plate_radius, poisson_ratio, notes, modulus)
    reason = violated[0] if violated else record_fault
    if value is not None and reason is not None:
        value = dataclasses.replace(value, not_supported=reason, not_supported_code=None)
    scatter = _scatter(procedure.quantity, used)
    faults = _point_faults(procedure, scatter, value, notes)
    goal = _goal(procedure, target, moisture, material, notes)
    _note_s_over_v(procedure, scatter.s_over_v, notes)
    verdict, reason, code = _verdict(
        procedure, value, goal.target, violated, faults, sorted_drops, withheld, modulus
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
        target=goal.target,
        target_source=goal.source,
        verdict=verdict,
        verdict_reason=reason,
        verdict_reason_code=code,
    )


def _notes(procedure: Procedure) -> list[str]:
    """Return the notes on unverified numbers of a procedure, which hold whatever the drops are."""
    notes = []
    unverified = [
        key
        for key, number in procedure.numbers().items()
        if not number.verified and not procedure.enforce_unverified
    ]
    in_formula = [key for key in unverified if key in ("factor", "nominal_pressure_pa")]
    if in_formula:
        notes.append(f"used in the formula without being verified: {', '.join(in_formula)}")
    ignored = [key for key in unverified if key not in in_formula and key not in _ALWAYS_ENFORCED]
    if ignored:
        notes.append(f"not verified, hence not enforced: {', '.join(ignored)}")
    return notes


def _modulus_notes(
    quantity: Quantity,
    modulus: PointModulus | None,
    unused: PointModulus | None,
    diagnosed: DiagnosedModulus | None,
) -> list[str]:
    """Return notes that say whether the diagnosed or the fitted modulus of the point is used."""
    if diagnosed is None:
        return []
    if modulus is None or modulus.source == "fitted":
        return [f"the diagnosed modulus is not used: {diagnosed.use_reason}"]
    value = _megapascal(modulus, quantity)
    text = f"the modulus is the diagnosed one, {value} MPa"
    if quantity is Quantity.EQUIVALENT_MODULUS:
        text = f"the equivalent modulus is the diagnosed one, {value} MPa"
    if unused is not None:
        text += f"; that of the fits is {_megapascal(unused, quantity)} MPa"
    return [text]


def _megapascal(modulus: PointModulus, quantity: Quantity) -> str:
    """Return a modulus as text in MPa, rounded to the digits that its interval justifies."""
    value, interval = modulus.in_quantity(quantity)
    if value is None:
        return "none"
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
    notes: list[str],
) -> list[str]:
    """Return the violated checks of a point that are enforced, one sentence each.

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
        text = f"{CHECKS[key].words} is {scattered:.1%}, at most {number.value:.1%} is allowed"
        if procedure.enforced(number) is None:
            notes.append(f"{text} (not verified, not enforced)")
        else:
            faults.append(text)
    if value is not None and value.quantity is not Quantity.DEFLECTION:
        low, high = procedure.limit("least_value_pa"), procedure.limit("most_value_pa")
        if low is not None and value.value < low:
            notes.append(
                f"{value.quantity.words} is below the range of the method ({low / 1e6:g} MPa)"
            )
        if high is not None and value.value > high:
            notes.append(
                f"{value.quantity.words} is above the range of the method ({high / 1e6:g} MPa)"
            )
    return faults


def _goal(
    procedure: Procedure,
    target: float | None,
    moisture: float | None,
    material: str | None,
    notes: list[str],
) -> _Goal:
    """Return the target declared for the point if it fits, else that of the procedure.

    A target fits if it is of the judged quantity.
    """
    if target is not None and is_target_for(procedure, target):
        return _Goal(target, "of the point")
    if target is not None:
        judged, compared = "a modulus", "a deflection"
        if procedure.quantity is Quantity.DEFLECTION:
            judged, compared = compared, judged
        notes.append(f"the target is {compared}, the procedure judges {judged}: not compared")
    default = procedure.target_for(moisture, material)
    return _Goal(None, "") if default is None else _Goal(default.value.value, default.value.source)


def is_target_for(procedure: Procedure, target: float) -> bool:
    """Return whether a target is of the quantity that a procedure judges.

    A number below 1 is a deflection in m, a larger one a modulus in Pa: moduli begin at 100 kPa,
    and deflections are smaller than the radius of a plate.
    """
    return (procedure.quantity is Quantity.DEFLECTION) == (target < MAX_DEFLECTION_M)


def _note_s_over_v(procedure: Procedure, s_over_v: float | None, notes: list[str]) -> None:
    limit = procedure.limit("most_s_over_v_s")
    if s_over_v is not None and limit is not None and s_over_v > limit:
        notes.append(
            f"s/v is {s_over_v * 1e3:.2f} ms, above {limit * 1e3:.2f} ms: more compaction is "
            "possible"
        )


def _verdict(
    procedure: Procedure,
    value: PointValue | None,
    target: float | None,
    violated: Sequence[str],
    faults: Sequence[str],
    drops: SortedDrops,
    withheld: str | None,
    modulus: PointModulus | None,
) -> tuple[Verdict, str, ReasonCode | None]:
    undecided = Verdict.UNDECIDED
    if target is None:
        return Verdict.NONE, "there is no target", None
    if violated:
        return undecided, violated[0], ReasonCode.PRECONDITION
    if not drops.complete:
        return undecided, "measured drops are missing", ReasonCode.DROPS_MISSING
    if value is None and withheld is not None and procedure.quantity.is_fitted:
        text = f"the modulus is not supported by the data: {withheld}"
        return undecided, text, ReasonCode.NOT_SUPPORTED
    if value is None and modulus is not None and procedure.quantity.is_fitted:
        text = "no equivalent modulus: no sensor is on the plate, or the data leave it open"
        return undecided, text, ReasonCode.VALUE_MISSING
    if value is None or (drops.counted and value.drops < len(drops.used)):
        text = "a measured drop lacks what is judged: discard and repeat it"
        return undecided, text, ReasonCode.VALUE_MISSING
    if value.not_supported is not None:
        subject = "the modulus" if value.quantity.is_fitted else value.quantity
        text = f"{subject} is not supported by the data: {value.not_supported}"
        return undecided, text, ReasonCode.NOT_SUPPORTED
    if faults:
        return undecided, faults[0], ReasonCode.SCATTER
    if value.interval is None:
        text = "the modulus has no interval"
        if not value.quantity.is_fitted:
            text = f"an interval needs {MIN_DROPS_FOR_INTERVAL} measured drops, "
            text += f"the point has {value.drops}"
        return undecided, text, ReasonCode.DROPS_MISSING
    low, high = value.interval
    if value.quantity is Quantity.DEFLECTION:  # smaller is better
        reached, missed = high <= target, low > target
    else:
        reached, missed = low >= target, high < target
    if reached:
        return Verdict.PASS, "the whole 95 % interval reaches the target", ReasonCode.DECIDED
    if missed:
        return Verdict.FAIL, "the whole 95 % interval misses the target", ReasonCode.DECIDED
    return undecided, "the target lies within the 95 % interval", ReasonCode.INTERVAL


def _compaction(sorted_drops: SortedDrops) -> tuple[tuple[int, str, float], ...]:
    return tuple(
        (drop.number, sorted_drops.kinds[drop.number].value, drop.peak_deflection)
        for drop in sorted_drops.drops
        if drop.kind is not Kind.REJECTED and drop.peak_deflection is not None
    )


def next_step(
    procedure: Procedure,
    sorted_drops: SortedDrops,
    violated: Sequence[str],
    faults: Sequence[str],
) -> tuple[Kind | None, str]:
    """Return the kind of the next drop, and one sentence of instruction.

    The kind is None when the point is done.

    Parameters
    ----------
    procedure : Procedure
    sorted_drops : SortedDrops
    violated : sequence of str
        Preconditions of the procedure that the point violates.
    faults : sequence of str
        Faults that the other enforced checks of the procedure report, one sentence each.
    """
    seating, measured = procedure.seating_drops, procedure.measured_drops
    repeated = _drop_to_repeat(sorted_drops)
    prefix, request = "", "Lift the weight for "
    if repeated is not None:
        prefix = request = f"Drop {repeated.number} does not count ({repeated.reason}): "
    if seating is not None and sorted_drops.seating < seating:
        return Kind.SEATING, f"{request}seating drop {sorted_drops.seating + 1} of {seating}."
    if measured is None:
        if prefix:
            return Kind.MEASURED, f"{prefix}a measured drop."
        if sorted_drops.complete:
            return Kind.MEASURED, "Enough for a mean; another measured drop makes it more certain."
        return Kind.MEASURED, "Lift the weight."
    if not sorted_drops.complete:
        number = len(sorted_drops.used) + 1
        return Kind.MEASURED, f"{request}measured drop {number} of {measured}."
    if violated:
        sentence = f"{violated[0][0].upper()}{violated[0][1:]}"
        return None, f"{sentence}: correct it and measure the point again beside this place."
    if faults:
        return None, (
            f"{faults[0][0].upper()}{faults[0][1:]}: see that the plate lies flat, and measure the "
            "point again beside this place."
        )
    return None, "The point is done: walk to the next."


def _drop_to_repeat(sorted_drops: SortedDrops) -> ExcludedDrop | None:
    """Return the last drop if it has to be repeated, else None."""
    drops = sorted_drops.drops
    if not drops or drops[-1].kind is Kind.SEATING:
        return None
    for excluded in sorted_drops.excluded:
        if excluded.number == drops[-1].number and excluded.why in _REPEATED:
            return excluded
    return None
