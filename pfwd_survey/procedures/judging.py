"""Judges the drops of a point by a procedure. Pure: the same drops give the same answer."""

import math
from collections.abc import Sequence

from pfwd_survey.errors import OptionError, refusal
from pfwd_survey.procedures.moduli import (
    e_lwd,
    e_vd,
    half_width_95,
    mean,
    spread,
    stress_dependence,
)
from pfwd_survey.procedures.point import (
    Kind,
    PointDrop,
    PointProgress,
    PointValue,
    StressDependence,
    Verdict,
)
from pfwd_survey.procedures.profile import CHECKS, Procedure, Quantity

ASSUMED_POISSON_RATIO = 0.35
"""Where neither procedure nor setup says one: the usual value of subgrades; said so in a note."""

OTHER_PLATE = 0.01
"""Part by which the plate may differ from the procedure's before a note says so."""

LARGEST_DEFLECTION = 1.0
"""m; what is larger is a modulus in Pa."""

OTHER_LOAD = 0.1
"""The same of the mean load against the nominal one, which E_vd takes for granted."""

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
    loaded = sum(not one for one in rejected)
    return Kind.SEATING if loaded < (seating if wanted is None else wanted) else Kind.MEASURED


def judge(
    procedure: Procedure,
    drops: Sequence[PointDrop],
    *,
    plate_radius: float,
    poisson_ratio: float | None = None,
    target: float | None = None,
    moisture: float | None = None,
    material: str | None = None,
) -> PointProgress:
    """What a procedure says of the drops of a point.

    Parameters
    ----------
    procedure : Procedure
    drops : sequence of PointDrop
        All of the point, in the order they fell.
    plate_radius : float, m
    poisson_ratio : float, optional
        As declared; the procedure's own wins.
    target : float, Pa (m for a deflection), optional
        Of the point; wins over the procedure's.
    moisture : float, percent, optional
        Chooses among the procedure's targets.
    material : str, optional
        The same.

    Returns
    -------
    PointProgress

    Raises
    ------
    OptionError
        If the plate radius is not positive.
    """
    if not (plate_radius > 0 and math.isfinite(plate_radius)):
        raise OptionError(refusal("plate radius", "a number > 0, in m", f"{plate_radius:g}"))
    notes = _notes(procedure, plate_radius)
    seating_wanted, measured_wanted = procedure.seating_drops, procedure.measured_drops
    usable, excluded, seating_done = _sort_out(procedure, drops, notes)
    kinds = _kinds(procedure, drops)
    used = usable if measured_wanted is None else usable[:measured_wanted]
    excluded += [
        (one.number, f"beyond the {measured_wanted} measured drops") for one in usable[len(used) :]
    ]
    complete = len(used) >= (measured_wanted or 1)
    value = _value(procedure, used, plate_radius, poisson_ratio, notes)
    deflections, loads, moduli = (
        _known(used, name) for name in ("peak_deflection", "peak_load", "modulus")
    )
    spreads = {
        "most_load_spread": spread(loads),
        "most_deflection_spread": spread(deflections),
        "most_modulus_spread": spread(moduli),
    }
    faults = _point_faults(procedure, spreads, value, notes)
    if target is not None and not _is_for(procedure, target):
        notes.append("the target is a modulus, the procedure judges a deflection: not compared")
        target = None
    target, source = _target(procedure, target, moisture, material)
    verdict, reason = _verdict(value, target, faults, complete)
    last_excluded = _last_excluded(drops, excluded)
    next_kind, instruction = _next(
        procedure, seating_done, len(used), complete, faults, last_excluded
    )
    velocities = _known(used, "peak_velocity")
    s_over_v = None
    if velocities and len(velocities) == len(deflections):
        s_over_v = mean(deflections) / mean(velocities)
        limit = procedure.limit("most_s_over_v_s")
        if limit is not None and s_over_v > limit:
            notes.append(
                f"s/v is {s_over_v * 1e3:.2f} ms, above {limit * 1e3:.2f} ms: more compaction is "
                "possible"
            )
    loaded = [one for one in drops if one.kind is not Kind.REJECTED]
    return PointProgress(
        next_kind=next_kind,
        instruction=instruction,
        seating_done=seating_done,
        seating_wanted=seating_wanted,
        measured_done=len(usable),
        measured_wanted=measured_wanted,
        complete=complete,
        used=tuple(one.number for one in used),
        kinds=tuple(kinds.items()),
        excluded=tuple(sorted(excluded)),
        faults=tuple(faults),
        notes=tuple(notes),
        value=value,
        deflection_spread=spreads["most_deflection_spread"],
        load_spread=spreads["most_load_spread"],
        modulus_spread=spreads["most_modulus_spread"],
        s_over_v=s_over_v,
        compaction=tuple(
            (one.number, kinds[one.number].value, one.peak_deflection)
            for one in loaded
            if one.peak_deflection is not None
        ),
        compaction_change=deflections[-1] / deflections[0] - 1 if len(deflections) > 1 else None,
        stress=_stress(procedure, usable, plate_radius, poisson_ratio),
        target=target,
        target_source=source,
        verdict=verdict,
        verdict_reason=reason,
    )


def _notes(procedure: Procedure, plate_radius: float) -> list[str]:
    notes = []
    unverified = [
        key
        for key, number in procedure.numbers().items()
        if not number.verified and not procedure.enforce_unverified
    ]
    in_formula = [key for key in unverified if key in ("factor", "nominal_pressure_pa")]
    if in_formula:
        notes.append(f"used in the formula without being verified: {', '.join(in_formula)}")
    others = [key for key in unverified if key not in in_formula]
    if others:
        notes.append(f"not verified, hence not enforced: {', '.join(others)}")
    radius = procedure.plate_radius
    if radius is not None and abs(plate_radius - radius.value) > OTHER_PLATE * radius.value:
        notes.append(
            f"the procedure is written for a plate of radius {radius.value:g} m, this one has "
            f"{plate_radius:g} m"
        )
    return notes


def _sort_out(
    procedure: Procedure, drops: Sequence[PointDrop], notes: list[str]
) -> tuple[list[PointDrop], list[tuple[int, str]], int]:
    """Usable drops, excluded ones with their reasons, seating drops done."""
    wanted = procedure.seating_drops
    usable, excluded = [], []
    loaded = seating_done = 0
    unenforced: dict[str, list[int]] = {}
    for one in drops:
        if one.kind is Kind.REJECTED:
            excluded.append((one.number, f"rejected: {one.reason or 'no drop'}"))
            continue
        before, loaded = loaded, loaded + 1
        fault = _drop_fault(procedure, one, unenforced)
        if wanted is not None and before < wanted:
            seating_done += 1
            excluded.append((one.number, f"seating drop {seating_done} of {wanted}"))
        elif wanted is None and one.kind is Kind.SEATING:
            seating_done += 1
            excluded.append((one.number, "seating drop"))
        elif one.kind is Kind.DISCARDED:
            excluded.append((one.number, f"discarded{f': {one.reason}' if one.reason else ''}"))
        elif fault:
            excluded.append((one.number, fault))
        else:
            usable.append(one)
    for text, numbers in unenforced.items():
        names = ", ".join(map(str, numbers))
        notes.append(f"drop{'s' if len(numbers) > 1 else ''} {names}: {text}")
    return usable, excluded, seating_done


def _kinds(procedure: Procedure, drops: Sequence[PointDrop]) -> dict[int, Kind]:
    """What the drops count as by the procedure; as they were marked where it does not say."""
    wanted, loaded, kinds = procedure.seating_drops, 0, {}
    for one in drops:
        kinds[one.number] = one.kind
        if one.kind is Kind.REJECTED:
            continue
        if wanted is not None and one.kind is not Kind.DISCARDED:
            kinds[one.number] = Kind.SEATING if loaded < wanted else Kind.MEASURED
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


def _known(drops: Sequence[PointDrop], attribute: str) -> list[float]:
    values = (getattr(one, attribute) for one in drops)
    return [float(value) for value in values if value is not None]


def _value(
    procedure: Procedure,
    used: Sequence[PointDrop],
    plate_radius: float,
    declared_ratio: float | None,
    notes: list[str],
) -> PointValue | None:
    if procedure.quantity is Quantity.MODULUS:
        return _inverted(used, plate_radius, notes)
    known = [one for one in used if one.peak_deflection]
    deflections = _known(known, "peak_deflection")
    if not deflections:
        return None
    loads = _known(known, "peak_load")
    middle, half = mean(deflections), half_width_95(deflections)
    mean_load = mean(loads) if len(loads) == len(deflections) else None
    if procedure.quantity is Quantity.DEFLECTION:
        interval = None if half is None else (max(0.0, middle - half), middle + half)
        return PointValue(
            Quantity.DEFLECTION,
            middle,
            interval,
            len(known),
            middle,
            mean_load,
            plate_radius=plate_radius,
        )
    assert procedure.factor is not None  # the reader refuses a profile without
    factor = procedure.factor.value
    if procedure.quantity is Quantity.E_VD:
        assert procedure.nominal_pressure is not None
        nominal = procedure.nominal_pressure.value
        _note_load(procedure, mean_load, notes)
        values = [e_vd(one, plate_radius, factor, nominal) for one in deflections]
        value = e_vd(middle, plate_radius, factor, nominal)
        ratio, pressure = None, nominal
    else:
        if mean_load is None:
            return None
        ratio = _poisson_ratio(procedure, declared_ratio, notes)
        values = [
            e_lwd(load, one, plate_radius, ratio, factor)
            for load, one in zip(loads, deflections, strict=True)
        ]
        value = e_lwd(mean_load, middle, plate_radius, ratio, factor)
        pressure = mean_load / (math.pi * plate_radius**2)
    if procedure.average == "modulus":
        value = mean(values)
    return PointValue(
        procedure.quantity,
        value,
        _around(value, half_width_95(values)),
        len(known),
        middle,
        mean_load,
        factor,
        plate_radius,
        ratio,
        pressure,
    )


def _around(value: float, half: float | None) -> tuple[float, float] | None:
    return None if half is None else (max(0.0, value - half), value + half)


def _inverted(
    used: Sequence[PointDrop], plate_radius: float, notes: list[str]
) -> PointValue | None:
    known = [one for one in used if one.modulus is not None]
    moduli = _known(known, "modulus")
    if not moduli:
        return None
    value, half = mean(moduli), half_width_95(moduli)
    # The model's error is common to the drops of a point: a mean does not lessen it.
    if half is None:
        notes.append("one drop: the scatter between drops is not in the interval")
    intervals = [one.modulus_interval for one in known if one.modulus_interval is not None]
    model = mean([(high - low) / 2 for low, high in intervals]) if intervals else None
    parts = [part for part in (half, model) if part is not None]
    deflections, loads = (_known(known, name) for name in ("peak_deflection", "peak_load"))
    return PointValue(
        Quantity.MODULUS,
        value,
        _around(value, math.hypot(*parts)) if parts else None,
        len(known),
        mean(deflections) if deflections else None,
        mean(loads) if loads else None,
        plate_radius=plate_radius,
    )


def _note_load(procedure: Procedure, load: float | None, notes: list[str]) -> None:
    nominal = procedure.nominal_load
    if nominal is None or load is None:
        return
    if abs(load - nominal.value) > OTHER_LOAD * nominal.value:
        notes.append(
            f"E_vd takes a load of {nominal.value / 1e3:.2f} kN for granted, the mean is "
            f"{load / 1e3:.2f} kN"
        )


def _poisson_ratio(procedure: Procedure, declared: float | None, notes: list[str]) -> float:
    own = procedure.enforced(procedure.poisson_ratio)
    if own is not None:
        return own
    if declared is not None:
        return declared
    text = f"Poisson's ratio {ASSUMED_POISSON_RATIO:g} is assumed"
    if text not in notes:
        notes.append(text)
    return ASSUMED_POISSON_RATIO


def _point_faults(
    procedure: Procedure,
    spreads: dict[str, float | None],
    value: PointValue | None,
    notes: list[str],
) -> list[str]:
    faults = []
    for key, found in spreads.items():
        number = procedure.checks.get(key)
        if number is None or found is None or found <= number.value:
            continue
        text = f"{CHECKS[key].words} is {found:.1%}, at most {number.value:.1%} is allowed"
        if procedure.enforced(number) is None:
            notes.append(f"{text} (not verified, not enforced)")
        else:
            faults.append(text)
    if value is not None and value.quantity is not Quantity.DEFLECTION:
        low, high = procedure.limit("least_value_pa"), procedure.limit("most_value_pa")
        if low is not None and value.value < low:
            notes.append(f"{value.quantity} is below the range of the method ({low / 1e6:g} MPa)")
        if high is not None and value.value > high:
            notes.append(f"{value.quantity} is above the range of the method ({high / 1e6:g} MPa)")
    return faults


def _is_for(procedure: Procedure, target: float) -> bool:
    """Whether a target is of the quantity that is judged: moduli begin at 100 kPa, deflections
    end at a plate's radius."""
    return procedure.quantity is not Quantity.DEFLECTION or target < LARGEST_DEFLECTION


def _target(
    procedure: Procedure, given: float | None, moisture: float | None, material: str | None
) -> tuple[float | None, str]:
    if given is not None:
        return given, "of the point"
    found = procedure.target_for(moisture, material)
    if found is None:
        return None, ""
    return found.value.value, found.value.source


def _verdict(
    value: PointValue | None, target: float | None, faults: Sequence[str], complete: bool
) -> tuple[Verdict, str]:
    if target is None:
        return Verdict.NONE, "there is no target"
    if value is None or not complete:
        return Verdict.UNDECIDED, "measured drops are missing"
    if faults:
        return Verdict.UNDECIDED, faults[0]
    if value.interval is None:
        return Verdict.UNDECIDED, "one drop has no scatter: the uncertainty is not known"
    low, high = value.interval
    if value.quantity is Quantity.DEFLECTION:  # smaller is better
        reached, missed = high <= target, low > target
    else:
        reached, missed = low >= target, high < target
    if reached:
        return Verdict.PASS, "the whole 95 % interval reaches the target"
    if missed:
        return Verdict.FAIL, "the whole 95 % interval misses the target"
    return Verdict.UNDECIDED, "the target lies within the 95 % interval"


def _last_excluded(
    drops: Sequence[PointDrop], excluded: Sequence[tuple[int, str]]
) -> tuple[int, str] | None:
    """The last drop and its reason when it is one to be repeated."""
    if not drops or drops[-1].kind is Kind.SEATING:
        return None
    for number, reason in excluded:
        if number == drops[-1].number and not reason.startswith(("seating", "beyond")):
            return number, reason
    return None


def _next(
    procedure: Procedure,
    seating_done: int,
    used: int,
    complete: bool,
    faults: Sequence[str],
    last_excluded: tuple[int, str] | None,
) -> tuple[Kind | None, str]:
    seating, measured = procedure.seating_drops, procedure.measured_drops
    again = ""
    if last_excluded is not None:
        again = f"Drop {last_excluded[0]} does not count ({last_excluded[1]}): "
    if seating is not None and seating_done < seating:
        text = f"seating drop {seating_done + 1} of {seating}"
        return Kind.SEATING, f"{again}{text}." if again else f"Lift the weight for {text}."
    if measured is None:
        if complete and not again:
            text = "Enough for a mean; another measured drop makes it surer"
            return Kind.MEASURED, f"{text}."
        return Kind.MEASURED, f"{again}a measured drop." if again else "Lift the weight."
    if not complete:
        text = f"measured drop {used + 1} of {measured}"
        return Kind.MEASURED, f"{again}{text}." if again else f"Lift the weight for {text}."
    if faults:
        return None, (
            f"{faults[0][0].upper()}{faults[0][1:]}: see that the plate lies flat, and measure the "
            "point anew beside this place."
        )
    return None, "The point is done: walk to the next."


def _stress(
    procedure: Procedure,
    usable: Sequence[PointDrop],
    plate_radius: float,
    declared_ratio: float | None,
) -> StressDependence | None:
    """From all usable drops: those beyond the mean may have fallen from other heights."""
    area = math.pi * plate_radius**2
    if procedure.quantity is Quantity.MODULUS:
        pairs = [
            (one.peak_load / area, one.modulus) for one in usable if one.peak_load and one.modulus
        ]
    else:
        factor = procedure.factor.value if procedure.factor is not None else 2.0
        ratio = _poisson_ratio(procedure, declared_ratio, [])
        pairs = [
            (
                one.peak_load / area,
                e_lwd(one.peak_load, one.peak_deflection, plate_radius, ratio, factor),
            )
            for one in usable
            if one.peak_load and one.peak_deflection
        ]
    return stress_dependence([pair[0] for pair in pairs], [pair[1] for pair in pairs])
