"""Findings of diagnoses for tests, from a small number of values."""

from collections.abc import Sequence

from inversion.diagnosis.findings import EffectParameter, EffectResult, FittedState, effect_result


def state_of(
    model: str,
    modulus: float,
    deviation: float,
    interval: tuple[float, float],
    residual_rms: float,
    over_noise: float,
    over_peak: float,
    contact_over_peak: float,
    stress: float | None = None,
    modulus_100kpa: float | None = None,
) -> FittedState:
    """Return a fitted state."""
    return FittedState(
        model=model,
        modulus_pa=modulus,
        modulus_sd_pa=deviation,
        modulus_interval_pa=interval,
        fitted_modulus=modulus,
        residual_rms_m=residual_rms,
        residual_over_noise=over_noise,
        residual_rms_over_peak=over_peak,
        contact_residual_rms_over_peak=contact_over_peak,
        stress_pa=stress,
        modulus_100kpa_pa=modulus_100kpa,
    )


def parameter_of(
    name: str, unit: str, value: float, deviation: float, drop: int | None, at_bound: bool
) -> EffectParameter:
    """Return a parameter of an effect."""
    return EffectParameter(
        name=name, unit=unit, value=value, sd=deviation, drop=drop, at_bound=at_bound
    )


def effect_of(
    name: str,
    scope: str,
    advice: str,
    parameters: Sequence[EffectParameter],
    evidence: float,
    alternatives: Sequence[str],
) -> EffectResult:
    """Return an effect, which may have no parameters."""
    shared = {"evidence": evidence, "alternatives": tuple(alternatives), "probability": 1.0}
    if not parameters:
        return EffectResult(name=name, scope=scope, advice=advice, parameters=(), **shared)
    return effect_result(name, scope, advice, parameters, **shared)
