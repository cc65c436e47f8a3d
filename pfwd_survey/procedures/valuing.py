"""The quantity of a procedure for a point, from the drops that are averaged."""

import dataclasses
import math
from collections.abc import Sequence

from pfwd_survey.procedures.moduli import (
    e_lwd,
    e_vd,
    half_width_95,
    mean,
    stress_dependence,
)
from pfwd_survey.procedures.point import (
    DiagnosedModulus,
    PointDrop,
    PointValue,
    StressDependence,
)
from pfwd_survey.procedures.profile import Procedure, Quantity

ASSUMED_POISSON_RATIO = 0.35
"""Where neither procedure nor setup says one: the usual value of subgrades; said so in a note."""

OTHER_LOAD = 0.1
"""Part by which the mean load may differ from the nominal one, which E_vd takes for granted,
before a note says so."""


def value_of(
    procedure: Procedure,
    used: Sequence[PointDrop],
    plate_radius: float,
    declared_ratio: float | None,
    notes: list[str],
    diagnosed: DiagnosedModulus | None = None,
) -> PointValue | None:
    """The quantity that a procedure judges; None: the drops do not say it."""
    if procedure.quantity is Quantity.MODULUS:
        return _with_diagnosis(_inverted(used, plate_radius, notes), diagnosed, notes)
    moved = [drop for drop in used if drop.peak_deflection]
    deflections, loads = known(moved, "peak_deflection"), known(moved, "peak_load")
    if not deflections:
        return None
    if procedure.quantity is Quantity.DEFLECTION:
        return _deflection(deflections, loads, plate_radius)
    if procedure.quantity is Quantity.E_VD:
        return _e_vd(procedure, deflections, loads, plate_radius, notes)
    if len(loads) != len(deflections):
        return None
    ratio = _poisson_ratio(procedure, declared_ratio, notes)
    return _e_lwd(procedure, deflections, loads, plate_radius, ratio)


def _deflection(
    deflections: Sequence[float], loads: Sequence[float], plate_radius: float
) -> PointValue:
    middle = mean(deflections)
    return PointValue(
        Quantity.DEFLECTION,
        middle,
        _around(middle, half_width_95(deflections)),
        len(deflections),
        middle,
        _mean_load(deflections, loads),
        plate_radius=plate_radius,
    )


def _e_vd(
    procedure: Procedure,
    deflections: Sequence[float],
    loads: Sequence[float],
    plate_radius: float,
    notes: list[str],
) -> PointValue:
    # The reader refuses a profile without them.
    assert procedure.factor is not None
    assert procedure.nominal_pressure is not None
    factor, nominal = procedure.factor.value, procedure.nominal_pressure.value
    middle, mean_load = mean(deflections), _mean_load(deflections, loads)
    _note_load(procedure, mean_load, notes)
    moduli = [e_vd(deflection, plate_radius, factor, nominal) for deflection in deflections]
    of_means = e_vd(middle, plate_radius, factor, nominal)
    value = mean(moduli) if procedure.average == "modulus" else of_means
    return PointValue(
        Quantity.E_VD,
        value,
        _around(value, half_width_95(moduli)),
        len(deflections),
        middle,
        mean_load,
        factor,
        plate_radius,
        pressure=nominal,
    )


def _e_lwd(
    procedure: Procedure,
    deflections: Sequence[float],
    loads: Sequence[float],
    plate_radius: float,
    ratio: float,
) -> PointValue:
    assert procedure.factor is not None  # the reader refuses a profile without
    factor = procedure.factor.value
    middle, mean_load = mean(deflections), mean(loads)
    moduli = [
        e_lwd(load, deflection, plate_radius, ratio, factor)
        for load, deflection in zip(loads, deflections, strict=True)
    ]
    of_means = e_lwd(mean_load, middle, plate_radius, ratio, factor)
    value = mean(moduli) if procedure.average == "modulus" else of_means
    return PointValue(
        Quantity.E_LWD,
        value,
        _around(value, half_width_95(moduli)),
        len(deflections),
        middle,
        mean_load,
        factor,
        plate_radius,
        ratio,
        mean_load / (math.pi * plate_radius**2),
    )


def _mean_load(deflections: Sequence[float], loads: Sequence[float]) -> float | None:
    """None when the load of a drop is not known."""
    return mean(loads) if len(loads) == len(deflections) else None


def _inverted(
    used: Sequence[PointDrop], plate_radius: float, notes: list[str]
) -> PointValue | None:
    inverted = [drop for drop in used if drop.modulus is not None]
    moduli = known(inverted, "modulus")
    if not moduli:
        return None
    value, half = mean(moduli), half_width_95(moduli)
    # The model's error is common to the drops of a point: a mean does not lessen it.
    if half is None:
        notes.append("one drop: the scatter between drops is not in the interval")
    intervals = [drop.modulus_interval for drop in inverted if drop.modulus_interval is not None]
    model = mean([(high - low) / 2 for low, high in intervals]) if intervals else None
    parts = [part for part in (half, model) if part is not None]
    deflections, loads = (known(inverted, name) for name in ("peak_deflection", "peak_load"))
    return PointValue(
        Quantity.MODULUS,
        value,
        _around(value, math.hypot(*parts)) if parts else None,
        len(inverted),
        mean(deflections) if deflections else None,
        mean(loads) if loads else None,
        plate_radius=plate_radius,
    )


# Why a point is judged by its fits, by the verdict of its diagnosis; clean: nothing is behind it.
_NOT_DIAGNOSED = {
    "explained": (
        "the diagnosis explains the residual, but does not correct the modulus: it is that of the "
        "fits",
    ),
    "unexplained": (
        "the diagnosis does not explain the residual: the modulus is that of the fits",
    ),
}


def _with_diagnosis(
    value: PointValue | None, diagnosed: DiagnosedModulus | None, notes: list[str]
) -> PointValue | None:
    """The diagnosed modulus where the diagnosis stands by it, else that of the fits."""
    if value is None or diagnosed is None:
        return value
    if not diagnosed.corrected:
        notes.extend(_NOT_DIAGNOSED.get(diagnosed.verdict, ()))
        return value
    notes.append(
        f"the modulus is the diagnosed one, {diagnosed.value / 1e6:.3g} MPa; that of the fits "
        f"is {value.value / 1e6:.3g} MPa"
    )
    return dataclasses.replace(value, value=diagnosed.value, interval=diagnosed.interval)


def _around(value: float, half: float | None) -> tuple[float, float] | None:
    return None if half is None else (max(0.0, value - half), value + half)


def known(drops: Sequence[PointDrop], attribute: str) -> list[float]:
    """What is known of an attribute of drops, in their order."""
    values = (getattr(drop, attribute) for drop in drops)
    return [float(value) for value in values if value is not None]


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


def stress_of(
    procedure: Procedure,
    usable: Sequence[PointDrop],
    plate_radius: float,
    declared_ratio: float | None,
) -> StressDependence | None:
    """From all usable drops: those beyond the mean may have fallen from other heights."""
    area = math.pi * plate_radius**2
    if procedure.quantity is Quantity.MODULUS:
        pairs = [
            (drop.peak_load / area, drop.modulus)
            for drop in usable
            if drop.peak_load and drop.modulus
        ]
    else:
        factor = procedure.factor.value if procedure.factor is not None else 2.0
        ratio = _poisson_ratio(procedure, declared_ratio, [])
        pairs = [
            (
                drop.peak_load / area,
                e_lwd(drop.peak_load, drop.peak_deflection, plate_radius, ratio, factor),
            )
            for drop in usable
            if drop.peak_load and drop.peak_deflection
        ]
    return stress_dependence([pair[0] for pair in pairs], [pair[1] for pair in pairs])
