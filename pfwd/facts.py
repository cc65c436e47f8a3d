"""Facts of drops, points and diagnoses: every output shows their values as `pfwd.units.Units` does.

A fact is a value with its interval, its unit and a note. The keys are names that a reader knows.
"""

import math
from collections.abc import Mapping

from pfwd.analysis.results import DropResult, EffectResult, FittedState, relative_spread
from pfwd.procedures import PointModulus, PointValue, Quantity
from pfwd.procedures.point import UNSUPPORTED_MARK
from pfwd.units import DECLARED, UNDETERMINED, Fact, QuantityName, unit_of_effect
from pfwd_device.text import clean

UNEXPLAINED = "UNEXPLAINED"
"""Word for a residual above noise and model error, with which the modulus may be wrong."""


def facts_of_drop(result: DropResult) -> dict[str, Fact]:
    """Return the ground, the pulse and the load of the fit of a drop."""
    mark = "" if result.not_supported is None else UNSUPPORTED_MARK
    pulse = result.half_sine
    load, radius = result.peak_load_n, result.plate_radius_m
    depth = _parameter(result, "depth", result.bedrock_depth_m, result.bedrock_depth_sd_m)
    if depth.deviation is not None and result.bedrock_depth_interval_m is not None:
        depth = Fact("depth", result.bedrock_depth_m, result.bedrock_depth_interval_m)
    return {
        "modulus": Fact("modulus", result.modulus_pa, result.modulus_interval_pa, mark=mark),
        "equivalent": Fact(
            "modulus",
            result.equivalent_modulus_pa,
            result.equivalent_modulus_interval_pa,
            mark=mark,
        ),
        "effective": Fact(
            "modulus", result.effective_modulus_pa, result.effective_modulus_interval_pa
        ),
        "viscosity": _parameter(
            result, "viscosity", result.viscosity_pa_s, result.viscosity_sd_pa_s
        ),
        "bedrock": depth,
        "density": _parameter(result, "density", result.density_kg_m3, result.density_sd_kg_m3),
        "peak modulus": Fact("modulus", result.peak_modulus_pa),
        "load": Fact("load", load),
        "pressure": Fact(
            "pressure", load / (math.pi * radius**2) if load is not None and radius else None
        ),
        "duration": Fact("duration", None if pulse is None else pulse.duration_s),
    }


def _parameter(
    result: DropResult, quantity: QuantityName, value: float | None, deviation: float | None
) -> Fact:
    """Return a parameter of the ground; without a deviation it was given."""
    if value is None or not math.isfinite(value):
        return Fact(quantity, None)
    if deviation is None or not math.isfinite(deviation):
        return Fact(quantity, value, note=DECLARED)
    return Fact(quantity, value, deviation=deviation, spread=relative_spread(result))


_STATE_FACTS: Mapping[str, QuantityName] = {
    "modulus": "modulus",
    "equivalent": "modulus",
    "viscosity": "viscosity",
    "bedrock": "depth",
    "density": "density",
    "stress": "pressure",
    "at 100 kPa": "modulus",
}
"""Quantities of the facts of a state."""

_MIN_STRESS_DIFFERENCE = 0.02
"""Relative difference of the moduli at two stresses from which both are shown."""


def facts_of_state(state: FittedState | None) -> dict[str, Fact]:
    """Return the ground of a fit of all drops; a modulus that is not determined has no value."""
    if state is None:
        return {name: Fact(quantity, None) for name, quantity in _STATE_FACTS.items()}
    return {
        "modulus": Fact(
            "modulus",
            None if state.is_undetermined else state.modulus_pa,
            state.modulus_interval_pa,
        ),
        "equivalent": Fact(
            "modulus",
            state.equivalent_modulus_pa,
            state.equivalent_modulus_interval_pa,
        ),
        "viscosity": Fact("viscosity", state.viscosity_pa_s),
        "bedrock": Fact("depth", state.bedrock_depth_m),
        "density": Fact("density", state.density_kg_m3),
        "stress": Fact("pressure", state.stress_pa),
        "at 100 kPa": _at_100_kpa(state),
    }


def _at_100_kpa(state: FittedState) -> Fact:
    """Return the modulus at 100 kPa; it has no value if the ground is linear, or has no modulus."""
    value, interval, modulus = state.modulus_pa, state.modulus_interval_pa, state.modulus_100kpa_pa
    if value and interval is not None and modulus is not None:
        ratio = modulus / value
        if abs(ratio - 1.0) >= _MIN_STRESS_DIFFERENCE:
            low, high = interval
            return Fact("modulus", modulus, (ratio * low, ratio * high))
    return Fact("modulus", None)


EffectFacts = list[tuple[str, int | None, Fact]]
"""Parameters of an effect: name, number of the drop (None: all drops), and fact."""


def facts_of_effect(effect: EffectResult) -> EffectFacts:
    """Return the parameters of an effect.

    A fitted parameter without a deviation is one that the records leave open.
    """
    is_fitted = effect.probability is not None and math.isfinite(effect.probability)
    facts = []
    for parameter in effect.parameters:
        unit = unit_of_effect(clean(parameter.unit))
        fact = Fact(unit, parameter.value, deviation=parameter.sd)
        if is_fitted and not math.isfinite(parameter.sd):
            fact = Fact(unit, None, note=UNDETERMINED)
        facts.append((parameter.name, parameter.drop, fact))
    return facts


def fact_of_value(value: PointValue | None) -> Fact:
    """Return the judged value of a point; without an interval it has the range of its drops."""
    if value is None:
        return Fact("modulus", None)
    return Fact(
        value.quantity.dimension,
        value.value,
        value.interval or value.drop_range,
        mark="" if value.not_supported is None else UNSUPPORTED_MARK,
        note="drop_range" if not value.interval and value.drop_range else "",
    )


def fact_of_modulus(modulus: PointModulus | None, quantity: Quantity = Quantity.MODULUS) -> Fact:
    """Return a fitted modulus of a point."""
    if modulus is None:
        return Fact("modulus", None)
    mark = "" if modulus.not_supported is None else UNSUPPORTED_MARK
    return Fact("modulus", *modulus.in_quantity(quantity), mark=mark)
