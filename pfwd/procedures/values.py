"""Value of a point by a procedure: E_vd, E_LWD or a fitted modulus, with its 95 % interval."""

import math
from collections.abc import Sequence
from dataclasses import replace

from inversion.notices import Notice, of_drops
from pfwd.procedures.point import (
    DiagnosedModulus,
    PointDrop,
    PointModulus,
    PointValue,
    StressLaw,
)
from pfwd.procedures.profile import Procedure, Quantity

ASSUMED_POISSON_RATIO = 0.35
"""Poisson's ratio, common for subgrades, where neither procedure nor point states one; a note
reports it.
"""

MIN_DROPS_FOR_INTERVAL = 3
"""Smallest number of measured drops for a 95 % interval: that of two would be 9 standard deviations
wide on each side.
"""

RESIDUAL_NOT_EXPLAINED = "residual-not-explained"
"""Code of the reason that a fit leaves a residual beyond its limit."""

_STUDENT_95 = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228)
"""Two-sided 95 % quantiles of Student's t for 1 to 10 degrees of freedom (any table of them)."""

MIN_STRESS_RATIO = 1.25
"""Smallest ratio of the largest to the smallest pressure at which drops count as made from several
heights; drops from one height repeat within a few percent.
"""


def value_of(
    procedure: Procedure,
    used: Sequence[PointDrop],
    plate_radius: float,
    declared_ratio: float | None,
    notes: list[Notice],
    modulus: PointModulus | None = None,
) -> PointValue | None:
    """Return the value of a point in the quantity that the procedure judges.

    The result is None if the drops lack the quantity.

    Parameters
    ----------
    procedure : Procedure
    used : sequence of PointDrop
        The drops that are averaged.
    plate_radius : float, m
    declared_ratio : float or None
        Poisson's ratio declared for the point.
    notes : list of Notice
        Assumptions that were made are appended.
    modulus : PointModulus, optional
        Modulus of the point from `moduli_of`, needed by a procedure that judges the fitted modulus.
    """
    if procedure.quantity.is_fitted:
        return _judged_modulus(procedure.quantity, used, plate_radius, modulus)
    measured = [drop for drop in used if drop.peak_deflection]
    deflections, loads = (
        recorded_values(measured, "peak_deflection"),
        recorded_values(measured, "peak_load"),
    )
    has_loads = len(loads) == len(deflections)
    is_lwd, is_deflection = (
        procedure.quantity is quantity for quantity in (Quantity.E_LWD, Quantity.DEFLECTION)
    )
    if not deflections or (is_lwd and not has_loads):
        return None
    ratio = _poisson_ratio(procedure, declared_ratio, notes) if is_lwd else None
    average, mean_load = mean(deflections), mean(loads) if has_loads else None
    value, *of_drops = (
        _from_peaks(procedure, load, deflection, plate_radius, ratio)
        for load, deflection in (
            (mean_load, average),
            *zip(loads if has_loads else [None] * len(deflections), deflections, strict=True),
        )
    )
    if procedure.average == "modulus":
        value = mean(of_drops)
    interval, drop_range = _spread_of(value, of_drops)
    nominal, factor = procedure.nominal_pressure, procedure.factor
    pressure = None if nominal is None else nominal.value
    if is_lwd and mean_load is not None:
        pressure = mean_load / (math.pi * plate_radius**2)
    return PointValue(
        procedure.quantity,
        value,
        interval,
        len(deflections),
        drop_range,
        mean_deflection=average,
        mean_load=mean_load,
        factor=None if is_deflection or factor is None else factor.value,
        plate_radius=plate_radius,
        poisson_ratio=ratio,
        pressure=None if is_deflection else pressure,
    )


def _from_peaks(
    procedure: Procedure,
    load: float | None,
    deflection: float,
    plate_radius: float,
    ratio: float | None,
) -> float:
    """Return the judged value from the peaks of a drop, or from the means of several."""
    if procedure.quantity is Quantity.DEFLECTION:
        return deflection
    # The reader refuses a profile without them.
    assert procedure.factor is not None
    if procedure.quantity is Quantity.E_VD:
        assert procedure.nominal_pressure is not None
        nominal = procedure.nominal_pressure.value
        return e_vd(deflection, plate_radius, procedure.factor.value, nominal)
    assert load is not None  # drops without a load have no value
    assert ratio is not None
    return e_lwd(load, deflection, plate_radius, ratio, procedure.factor.value)


def _spread_of(
    average: float, values: Sequence[float]
) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Return the 95 % interval of a mean and None, or None and the range of few values."""
    if len(values) < MIN_DROPS_FOR_INTERVAL:
        return None, (min(values), max(values)) if len(values) > 1 else None
    half = half_width_95(values) or 0.0
    return (max(0.0, average - half), average + half), None


def moduli_of(
    procedure: Procedure, used: Sequence[PointDrop], diagnosed: DiagnosedModulus | None
) -> tuple[PointModulus | None, PointModulus | None]:
    """Return the modulus of a point that is to be used, and the other one if there are two.

    The diagnosed modulus is used where its diagnosis permits it, else the fitted one. Where the
    diagnosis permits none and the data do not support the fits, there is no modulus, but the
    equivalent one of the diagnosis if that is permitted.

    Parameters
    ----------
    procedure : Procedure
        States the largest residual at which a fit counts as supported.
    used : sequence of PointDrop
        The drops that are averaged.
    diagnosed : DiagnosedModulus or None
        Modulus from the diagnosis of the point.
    """
    return modulus_to_use(_fitted_modulus(procedure, used), diagnosed)


def modulus_to_use(
    fitted: PointModulus | None, diagnosed: DiagnosedModulus | None
) -> tuple[PointModulus | None, PointModulus | None]:
    """Return the modulus of a point that is to be used, and the other one, see `moduli_of`."""
    if diagnosed is None:
        return fitted, None
    modulus = diagnosed.modulus
    if diagnosed.use != "do-not-use":
        return modulus, fitted
    if fitted is not None and fitted.not_supported is None:
        return fitted, modulus and replace(modulus, not_supported=diagnosed.use_reason)
    return diagnosed.equivalent_alone, None


def _fitted_modulus(procedure: Procedure, used: Sequence[PointDrop]) -> PointModulus | None:
    """Combine the fitted moduli of drops; see `_combined`."""
    fitted = [drop for drop in used if drop.modulus is not None and 0 < drop.modulus < math.inf]
    if not fitted:
        return None
    # A reason with a code comes first: it states what to do.
    reasons = sorted(
        filter(None, (unsupported_fit(procedure, drop) for drop in fitted)),
        key=lambda reason: reason[1] is None,
    )
    fault, code = reasons[0] if reasons else (None, None)
    value, interval = _combined([(drop.modulus or 0.0, drop.modulus_interval) for drop in fitted])
    equivalent, equivalent_interval = None, None
    equivalents = [
        (drop.equivalent_modulus, drop.equivalent_interval)
        for drop in fitted
        if drop.equivalent_modulus is not None
    ]
    if len(equivalents) == len(fitted):
        equivalent, equivalent_interval = _combined(equivalents)
    depth = fitted[-1].modulus_depth
    return PointModulus(
        value, interval, "fitted", fault, code, equivalent, equivalent_interval, depth
    )


def _combined(
    moduli: Sequence[tuple[float, tuple[float, float] | None]],
) -> tuple[float, tuple[float, float] | None]:
    r"""Return the mean of moduli of drops, on the logarithm of E, with its 95 % interval.

    One drop keeps its interval. Of several, :math:`\ln E` is the mean, and each side of the
    interval is :math:`\sqrt{m^2 + s^2}` with the mean half-width m of the drops' own intervals on
    that side and the half-width s from the scatter (Student). The model's error is common to the
    drops of a point: their mean does not lessen it.
    """
    if len(moduli) == 1:
        return moduli[0]
    logarithms = [math.log(value) for value, _ in moduli]
    average, scatter = mean(logarithms), half_width_95(logarithms) or 0.0
    below, above = [], []
    for (_, interval), logarithm in zip(moduli, logarithms, strict=True):
        if interval is not None:
            low, high = interval
            below.append(logarithm - math.log(low) if low > 0 else math.inf)
            above.append(math.log(high) - logarithm)
    ends = [math.hypot(mean(sides), scatter) if sides else scatter for sides in (below, above)]
    return math.exp(average), (math.exp(average - ends[0]), math.exp(average + ends[1]))


def unsupported_records(used: Sequence[PointDrop]) -> Notice | None:
    """Return the reason why the records of a point support no value at all; None: they do.

    Drops with the same load, deflection and duration to the last digit are one drop that was stored
    several times. Drops without traces are not compared: rounded peaks may agree by chance.
    """
    first: dict[tuple[float | None, ...], int] = {}
    for drop in used:
        if drop.record_fault is not None:
            return of_drops(drop.record_fault, drop.number)
        if drop.pulse_duration is None or drop.peak_deflection is None:
            continue
        peaks = drop.peak_load, drop.peak_deflection, drop.pulse_duration
        if peaks in first:
            return of_drops(Notice("record-copied", {"drop": first[peaks]}), drop.number)
        first[peaks] = drop.number
    return None


def unsupported_fit(procedure: Procedure, drop: PointDrop) -> tuple[Notice, str | None] | None:
    """Return the reason why the data do not support the fitted modulus of a drop, and its code.

    The result is None if they support it.
    """
    if drop.fit_fault is not None:
        return of_drops(drop.fit_fault, drop.number), drop.fit_fault_code
    fault = residual_fault(drop.residual, procedure.tolerance("most_residual").value)
    return None if fault is None else (of_drops(fault, drop.number), RESIDUAL_NOT_EXPLAINED)


def residual_fault(residual: float | None, limit: float) -> Notice | None:
    """Return the fault of a residual above its limit; None: it is below, or unknown.

    Parameters
    ----------
    residual, limit : float
        Root mean square residual over the peak deflection, and its limit.
    """
    if residual is None or residual <= limit:
        return None
    return Notice("residual-too-large", {"residual": residual, "limit": limit})


def _judged_modulus(
    quantity: Quantity,
    used: Sequence[PointDrop],
    plate_radius: float,
    modulus: PointModulus | None,
) -> PointValue | None:
    value, interval = (None, None) if modulus is None else modulus.in_quantity(quantity)
    if modulus is None or value is None:
        return None
    fitted = [drop for drop in used if drop.modulus is not None] or used
    deflections, loads = (
        recorded_values(fitted, name) for name in ("peak_deflection", "peak_load")
    )
    return PointValue(
        quantity,
        value,
        interval,
        len(fitted),
        not_supported=modulus.not_supported,
        not_supported_code=modulus.not_supported_code,
        mean_deflection=mean(deflections) if deflections else None,
        mean_load=mean(loads) if loads else None,
        plate_radius=plate_radius,
    )


def recorded_values(drops: Sequence[PointDrop], attribute: str) -> list[float]:
    """Return the values of an attribute for the drops in which it is not None, in their order."""
    values = (getattr(drop, attribute) for drop in drops)
    return [float(value) for value in values if value is not None]


def _poisson_ratio(procedure: Procedure, declared: float | None, notes: list[Notice]) -> float:
    enforced = procedure.enforced(procedure.poisson_ratio)
    if enforced is not None:
        return enforced
    if declared is not None:
        return declared
    assumption = Notice("poisson-ratio-assumed", {"poisson_ratio": ASSUMED_POISSON_RATIO})
    if assumption not in notes:
        notes.append(assumption)
    return ASSUMED_POISSON_RATIO


def stress_of(
    procedure: Procedure,
    usable: Sequence[PointDrop],
    plate_radius: float,
    declared_ratio: float | None,
) -> StressLaw | None:
    """Return the dependence of a point's modulus on the pressure under the plate.

    The result is None in the case that `stress_dependence` describes.

    All usable drops count, also those that are not averaged: they may have fallen from other
    heights.
    """
    area = math.pi * plate_radius**2
    if procedure.quantity.is_fitted:
        pairs = [
            (drop.peak_load / area, modulus)
            for drop in usable
            if drop.peak_load and (modulus := drop.modulus_in(procedure.quantity))
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


def e_vd(
    deflection: float, plate_radius: float, factor: float = 1.5, nominal_pressure: float = 1e5
) -> float:
    r"""Return the dynamic modulus of deformation E_vd.

    .. math:: E_{vd} = 1.5 \, r \, \sigma / s

    The nominal pressure :math:`\sigma` = 0.1 MPa, to which the device was calibrated (7.07 kN on a
    plate of 0.3 m), is used whatever the load was. With s in mm and that plate the formula is 22.5
    / s, in MPa. It is printed in public manuals of light drop weight testers that follow TP BF-StB
    B 8.3.

    Parameters
    ----------
    deflection : float, m, > 0
        Mean of the measured drops.
    plate_radius : float, m
    factor : float
    nominal_pressure : float, Pa

    Returns
    -------
    float, Pa

    Examples
    --------
    >>> round(e_vd(0.5e-3, 0.15) / 1e6, 6)
    45.0
    """
    return factor * plate_radius * nominal_pressure / deflection


def e_lwd(
    load: float, deflection: float, plate_radius: float, poisson_ratio: float, factor: float
) -> float:
    r"""Return the surface modulus E_LWD of a half-space under a plate, from the peaks.

    .. math:: E_{LWD} = k (1 - \nu^2) \, \sigma \, r / s, \qquad \sigma = F / (\pi r^2)

    with the stress distribution factor k: 2 uniform, pi/2 rigid, 8/3 parabolic (static Boussinesq
    solutions for the centre).

    Parameters
    ----------
    load : float, N
        Measured peak load.
    deflection : float, m, > 0
        Peak deflection in the centre.
    plate_radius : float, m
    poisson_ratio : float
    factor : float
        Stress distribution factor k.

    Returns
    -------
    float, Pa
    """
    pressure = load / (math.pi * plate_radius**2)
    return factor * (1 - poisson_ratio**2) * pressure * plate_radius / deflection


def mean(values: Sequence[float]) -> float:
    """Return the arithmetic mean."""
    return math.fsum(values) / len(values)


def spread(values: Sequence[float]) -> float | None:
    """Return the largest minus the smallest value, over the mean; None: fewer than two values."""
    if len(values) < 2 or mean(values) == 0:
        return None
    return (max(values) - min(values)) / abs(mean(values))


def half_width_95(values: Sequence[float]) -> float | None:
    """Return half the width of the 95 % interval of a mean (Student).

    The result is None for fewer than two values.
    """
    count = len(values)
    if count < 2:
        return None
    average = mean(values)
    variance = math.fsum((value - average) ** 2 for value in values) / (count - 1)
    # Beyond the table the quantile falls by 12 % at most, to 1.96 of the normal distribution; the
    # last one of the table gives the wider interval.
    quantile = _STUDENT_95[min(count - 1, len(_STUDENT_95)) - 1]
    return quantile * math.sqrt(variance / count)


def stress_dependence(pressures: Sequence[float], moduli: Sequence[float]) -> StressLaw | None:
    """Return the exponent n of E = E_0 (p / p_0)^n, by least squares of the logarithms.

    Parameters
    ----------
    pressures : sequence of float, Pa, > 0
        Peak pressure under the plate, for each drop.
    moduli : sequence of float, Pa, > 0
        Modulus from each drop.

    Returns
    -------
    StressDependence or None
        None when the largest pressure is less than 1.25 times the smallest.
    """
    if len(pressures) < 2 or max(pressures) < MIN_STRESS_RATIO * min(pressures):
        return None
    x = [math.log(value) for value in pressures]
    y = [math.log(value) for value in moduli]
    mean_x, mean_y = mean(x), mean(y)
    squares = math.fsum((value - mean_x) ** 2 for value in x)
    slope = math.fsum((a - mean_x) * (b - mean_y) for a, b in zip(x, y, strict=True)) / squares
    deviation = None
    if len(x) > 2:
        residual = math.fsum(
            (b - mean_y - slope * (a - mean_x)) ** 2 for a, b in zip(x, y, strict=True)
        )
        deviation = math.sqrt(residual / (len(x) - 2) / squares)
    return StressLaw(slope, deviation, (min(pressures), max(pressures)))
