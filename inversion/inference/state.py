"""Fit of a point as plain numbers: moduli with their intervals, residuals, reasons for doubt."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.findings import NEARLY_EXPLAINED, FittedState
from inversion.inference.modulus import (
    NORMAL_95,
    Component,
    ModulusOf,
    depth_range,
    equivalent_estimate,
    ground_of,
    mean_stress,
    quantiles,
    rock_depth,
    secant_estimate,
    secant_modulus,
)
from inversion.inference.posterior import PointFit, Posterior
from inversion.inference.selection import EXPLAINED_TO, SIMILAR_DISCREPANCY_RATIO
from inversion.notices import Notice, Value
from inversion.records import Interval
from inversion.result import is_open

Mixture = Callable[[ModulusOf], Sequence[Component]]
"""Function that returns a modulus by each structure that an interval covers, the best first."""

# Contact pressure at which moduli of different drops are compared, Pa.
_REFERENCE_PA = 100e3
# Relative error (95 %) of the modulus over the discrepancy of a record that the base model does not
# explain. It exceeds 1 because its parameters imitate part of the model error and of the response
# of the instrument, and that part does not show as discrepancy.
_ERROR_PER_DISCREPANCY = 5.0
# Residual over the noise above which slow noise is no explanation of more than a nearly explained
# residual.
_MAX_RESIDUAL_OVER_NOISE = 2.0
# If the best fit does not explain the record, others of similar discrepancy have at least this
# weight, relative to the best one.
_SIMILAR_WEIGHT = 0.1


def doubtful_weights(
    weights: Sequence[float], fits: Sequence[Posterior], best: Posterior
) -> list[float]:
    """Return the weights of fits, relative to the best one, if even that one is doubtful.

    Evidence weights structures correctly only if one of them is right. If not, those of similar
    discrepancy get a weight that the interval shows.
    """
    close = SIMILAR_DISCREPANCY_RATIO * best.discrepancy.scale
    return [
        max(weight, _SIMILAR_WEIGHT) if fit.discrepancy.scale <= close else weight
        for weight, fit in zip(weights, fits, strict=True)
    ]


def fitted_state(posterior: Posterior, mixture: Mixture) -> FittedState:
    """Return the residuals of a fit, and its modulus with the 95 % interval.

    Parameters
    ----------
    posterior : Posterior, of all drops
    mixture : Mixture
    """
    model = posterior.model
    drops = [model.point.drops[drop] for drop in model.drops]
    pairs = list(zip(drops, posterior.recorded, strict=True))
    residuals = [predicted - model_of_drop.observed for model_of_drop, predicted in pairs]
    over_noise = [
        r / model_of_drop.noise[:, None] for model_of_drop, r in zip(drops, residuals, strict=True)
    ]
    rig = any(effect.replaces_ground for effect in model.effects)
    ground = ground_of(posterior)
    stress = mean_stress(model)
    state = FittedState(
        model="rig" if rig else "half-space" if ground.inverse_depth == 0.0 else "layer",
        modulus_interval_pa=(math.nan, math.nan),
        residual_rms_m=_root_mean_square(residuals),
        residual_over_noise=_root_mean_square(over_noise),
        residual_rms_over_peak=posterior.residual_over_peak(),
        contact_residual_rms_over_peak=posterior.residual_over_peak(contact_only=True),
        stress_pa=stress,
        discrepancy_over_peak=posterior.discrepancy.scale,
        discrepancy_interval_over_peak=PointFit(model, posterior.values).scale_interval(posterior),
    )
    if rig:
        return replace(state, modulus_interval_pa=None)
    modulus = secant_modulus(posterior, stress)
    components = mixture(lambda fit: secant_estimate(fit, stress))
    low, median, high = quantiles(components)
    state = replace(
        state,
        fitted_modulus=median,
        modulus_pa=median,
        modulus_sd_pa=median * components[0].deviation,
        modulus_interval_pa=(low, high),
        modulus_depth_m=depth_range(posterior),
        modulus_100kpa_pa=median / modulus * secant_modulus(posterior, _REFERENCE_PA),
        viscosity_pa_s=float(ground.viscosity),
        density_kg_m3=float(ground.density),
        bedrock_depth_m=rock_depth(posterior),
    )
    if drops[-1].measures_plate:
        low, median, high = quantiles(mixture(equivalent_estimate))
        state = replace(
            state, equivalent_modulus_pa=median, equivalent_modulus_interval_pa=(low, high)
        )
    return _without_open_moduli(state)


def without_modulus(state: FittedState) -> FittedState:
    """Return a state without its moduli, which the data do not determine."""
    return replace(
        state,
        modulus_pa=None,
        modulus_sd_pa=None,
        modulus_100kpa_pa=None,
        equivalent_modulus_pa=None,
    )


def _without_open_moduli(state: FittedState) -> FittedState:
    """Return a state without those moduli that their intervals leave open."""
    if is_open(state.equivalent_modulus_interval_pa):
        state = replace(state, equivalent_modulus_pa=None)
    if not state.is_undetermined:
        return state
    return replace(without_modulus(state), equivalent_modulus_pa=state.equivalent_modulus_pa)


def discrepancy_error(state: FittedState) -> float:
    """Return the error (95 %) of the logarithm of a modulus by a fit without effects.

    Parameters
    ----------
    state : FittedState, which does not explain the record
    """
    discrepancy = max(
        state.discrepancy_over_peak or 0.0, state.contact_residual_rms_over_peak or 0.0
    )
    return math.log1p(_ERROR_PER_DISCREPANCY * discrepancy)


def wider(value: float, limits: Interval, error: float) -> Interval:
    """Return the interval of a modulus, Pa, with a further error of its logarithm."""
    low, high = (
        value * math.exp(sign * math.hypot(math.log(end / value), error))
        for sign, end in zip((-1.0, 1.0), limits, strict=True)
    )
    return low, high


def with_discrepancy_error(state: FittedState) -> FittedState:
    """Return the state of a fit without effects whose intervals include `discrepancy_error`."""
    interval, equivalent_interval = state.modulus_interval_pa, state.equivalent_modulus_interval_pa
    if interval is None:
        return state
    modulus, equivalent = state.fitted_modulus, state.equivalent_modulus_pa
    error = discrepancy_error(state)
    if equivalent is not None and equivalent_interval is not None:
        limits = wider(equivalent, equivalent_interval, error)
        state = replace(state, equivalent_modulus_interval_pa=limits)
    if state.modulus_sd_pa is not None:
        relative = math.hypot(state.modulus_sd_pa / modulus, error / NORMAL_95)
        state = replace(state, modulus_sd_pa=modulus * relative)
    limits = wider(modulus, interval, error)
    return _without_open_moduli(replace(state, modulus_interval_pa=limits))


def unexplained_reasons(posterior: Posterior) -> list[Notice]:
    """Return the reasons why a fit does not explain its records; empty: it does."""
    reasons = []
    discrepancy = posterior.discrepancy.scale
    if discrepancy > EXPLAINED_TO:
        values: dict[str, Value] = {"discrepancy_over_peak": discrepancy, "limit": EXPLAINED_TO}
        reasons.append(Notice("discrepancy-remains", values))
    # Only the last drop is judged, because the first of several drops may have a larger residual.
    model = posterior.model
    last = model.point.drops[model.last]
    residual = posterior.recorded[-1] - last.observed
    over_noise = _root_mean_square([residual / last.noise[:, None]])
    last_residual = posterior.residuals_over_peak()[-1]
    if not reasons and over_noise > _MAX_RESIDUAL_OVER_NOISE and last_residual > NEARLY_EXPLAINED:
        reasons.append(Notice("noise-exceeded", {"residual_over_noise": over_noise}))
    return reasons


def _root_mean_square(parts: Sequence[FloatArray]) -> float:
    return math.sqrt(np.mean(np.concatenate([part.ravel() for part in parts]) ** 2))
