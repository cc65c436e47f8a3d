"""The result of one drop, without loading what found it."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from pfwd_device import Drop
from pfwd_survey.inverting.diagnosis.result import DropDiagnosis
from pfwd_survey.inverting.screening.drops import DropStatus, Screening
from pfwd_survey.inverting.screening.missing import whole_part
from pfwd_survey.inverting.screening.signals import remove_offset
from pfwd_survey.inverting.stored import Interval, StoredRecord

if TYPE_CHECKING:
    # Only for annotations: a logger shows results without loading the inversion.
    from inversion import InversionResult
    from inversion.result import LayerValue
    from pfwd_survey.files.header import PointSetup


OPEN_FACTOR = 10.0
"""An interval wider than this factor is no value; as in the inversion, which is not loaded here."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What was asked of a drop, as it is kept with the answer."""

    question: str
    settings: str
    software: str


@dataclass(frozen=True, eq=False)
class DropAnalysis:
    """A drop with what the screening and the inversion found.

    ``result`` is None for a rejected drop; ``fault`` says why an accepted one has none.
    """

    drop: Drop
    screening: Screening
    result: InversionResult | None
    fault: str | None = None
    setup: PointSetup | None = None
    """What was declared of it; None: then its deflection is not corrected."""
    asked: Asked | None = None
    stored: DropResult | None = None
    """What the survey kept of the same question; then there is no ``result``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredFacts(StoredRecord):
    """What a procedure has to know of a drop, as it was found in its traces."""

    version: int | None = None
    """Of how it is found; see `pfwd_survey.inverting.drop_facts.FACTS_VERSION`."""
    peak_load_n: float | None = None
    pulse_peak_n: float | None = None
    """By which the drops of a point are compared, single spikes left out, N."""
    deflection_m: float | None = None
    """Peak of the centre, the response below taken out, m."""
    velocity_m_per_s: float | None = None
    duration_s: float | None = None
    offset_over_peak: float | None = None
    return_over_peak: float | None = None
    geophone_natural_frequency_hz: float | None = None
    """Of the response that was taken out; None: none was."""
    geophone_damping: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class HalfSinePulse(StoredRecord):
    """A half-sine that stands for the load."""

    peak_pressure_pa: float | None = None
    """Over the plate, Pa."""
    duration_s: float | None = None
    rms_over_peak: float | None = None
    """How far the load is from it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerResult(StoredRecord):
    """One medium, from the surface down."""

    modulus_pa: float | None = None
    modulus_sd_pa: float | None = None
    """From the noise, Pa."""
    modulus_interval_pa: Interval | None = None
    """95 %, Pa."""
    thickness_m: float | None = None
    """None: goes on without end."""
    thickness_sd_m: float | None = None
    """None: given, not fitted."""
    thickness_interval_m: Interval | None = None
    """95 %, m."""
    viscosity_pa_s: float | None = None
    density_kg_m3: float | None = None
    poisson_ratio: float | None = None

    @property
    def modulus_known(self) -> bool:
        """Whether there is a modulus that the record does not leave open.

        Examples
        --------
        >>> LayerResult(modulus_pa=9e7, modulus_interval_pa=(4e7, 4.1e8)).modulus_known
        False
        """
        if self.modulus_pa is None:
            return False
        low, high = self.modulus_interval_pa or (1.0, 1.0)
        return high <= OPEN_FACTOR * low


@dataclass(frozen=True, slots=True, kw_only=True)
class DropResult(StoredRecord):
    """What is known of one drop: the keys of ``pfwd invert --json``, in their order.

    None: not known, or not in the model. A deviation that is None while its value is not: the value
    was given, not fitted.
    """

    LEFT_OUT: ClassVar[frozenset[str]] = frozenset(
        {
            "point",
            "reason",
            "facts",
            "refit",
            "software",
            "settings",
            "question",
            "stored",
            "diagnosis",
        }
    )

    file: str | None = None
    """That the drop is from."""
    point: str | int | float | None = None
    """Name of its test point."""
    drop: int | None = None
    """Number within the point."""
    status: DropStatus | None = None
    reason: str | None = None
    """Why it was rejected."""
    method: str | None = None
    """That ran: mpga, least-squares or published."""
    model: str | None = None
    """layer (on rock) or half-space."""
    modulus_pa: float | None = None
    """Young's modulus of the ground, Pa."""
    modulus_sd_pa: float | None = None
    """Its standard deviation from the noise, Pa."""
    viscosity_pa_s: float | None = None
    viscosity_sd_pa_s: float | None = None
    density_kg_m3: float | None = None
    density_sd_kg_m3: float | None = None
    bedrock_depth_m: float | None = None
    bedrock_depth_sd_m: float | None = None
    modulus_interval_pa: Interval | None = None
    """95 %, the model's own error included, Pa."""
    bedrock_depth_interval_m: Interval | None = None
    """95 %, m."""
    modulus_depth_correlation: float | None = None
    """Of the two as fitted, -1 to 1."""
    layers: tuple[LayerResult, ...] | None = None
    """All media from the surface down; modulus_pa is the lowest one's."""
    effective_modulus_pa: float | None = None
    """Of one medium that the plate at rest would press in as far, Pa."""
    effective_modulus_interval_pa: Interval | None = None
    """95 %, Pa."""
    effective_depth_m: float | None = None
    """Above which 90 % of that deflection arises, m."""
    poisson_ratio: float | None = None
    """Of the ground; given."""
    plate_radius_m: float | None = None
    plate: str | None = None
    """How the plate presses: rigid-rough, rigid-smooth or published."""
    load: str | None = None
    """What the model was loaded with: measured, or half-sine and how it was read."""
    peak_load_n: float | None = None
    """Of the measured load, less its offset, N; None in results of earlier versions."""
    deflection_recorded_m: float | None = None
    """Peak of the centre as recorded, m."""
    deflection_corrected_m: float | None = None
    """The same with the declared response of the geophone taken out, m; procedures judge it."""
    half_sine: HalfSinePulse | None = None
    """By least squares."""
    half_sine_equal_area: HalfSinePulse | None = None
    """With the measured peak and area."""
    peak_modulus_pa: float | None = None
    """Of the peak method, for comparison, Pa."""
    peak_factor: float | None = None
    """Shape factor of the peak method."""
    r_squared: float | None = None
    noise_rms_m: float | None = None
    """Noise, quantisation or the model's error, the largest, m."""
    residual_rms_over_peak: float | None = None
    """From the trigger to the end of the record."""
    contact_residual_rms_over_peak: float | None = None
    """To the end of the contact."""
    contact_end_s: float | None = None
    """The load has gone, s after the trigger."""
    window_end_s: float | None = None
    """Last sample of the fit, s after the trigger."""
    priors: bool | None = None
    """Whether what nature gives decided between grounds that fit alike."""
    explained: bool | None = None
    """Whether the residual is within the noise, and no channel is clipped."""
    converged: bool | None = None
    at_bound: tuple[str, ...] | None = None
    """Names of the parameters that stopped at a bound."""
    forward_solves: int | None = None
    elapsed_s: float | None = None
    """Of the analysis, without the start of the program, s."""
    seed: int | None = None
    """Of the search."""
    warnings: tuple[str, ...] | None = None
    """What should be known of the result; None: the record does not say."""
    facts: MeasuredFacts | None = None
    """For the judgement of its point, so that its traces need not be read again."""
    refit: str | None = None
    """Settings of a trial that somebody made; the result before it counts. None: no trial."""
    software: str | None = None
    """That made it, with its version."""
    settings: str | None = None
    """That differ from the usual ones, in words."""
    question: str | None = None
    """Tells what was asked: samples, what was declared, and settings."""
    stored: bool | None = None
    """Whether the survey kept it from before; None: no."""
    diagnosis: DropDiagnosis | None = None
    """Of its point; None: nobody asked for it."""

    @property
    def is_trial(self) -> bool:
        """Whether somebody made it with other settings, so that it does not count."""
        return self.refit is not None or "refit" in self.more

    @property
    def not_supported(self) -> str | None:
        """Reason why the data do not support the modulus, by the usual limit; None: they do."""
        from pfwd_survey.procedures.profile import OUR_TOLERANCES
        from pfwd_survey.procedures.valuing import residual_fault

        if self.modulus_pa is None:
            return None
        limit = OUR_TOLERANCES["most_residual"]
        return fit_fault(self) or residual_fault(self.contact_residual_rms_over_peak, limit)

    @property
    def half_sine_load_n(self) -> float | None:
        """Peak of the half-sine, N."""
        pressure = None if self.half_sine is None else self.half_sine.peak_pressure_pa
        if pressure is None or self.plate_radius_m is None:
            return None
        return pressure * math.pi * self.plate_radius_m**2

    @property
    def known_peak_load_n(self) -> float | None:
        """Peak of the measured load, N; what its half-sine says where that was not kept."""
        return self.half_sine_load_n if self.peak_load_n is None else self.peak_load_n


DECISIVE_PARAMETERS = ("modulus", "density", "depth", "thickness")
"""Parts of the names of parameters without which there is no modulus when they are on a bound.
Viscosity on a bound widens the interval only."""


def fit_fault(result: DropResult) -> str | None:
    """Return why the data do not support a fitted modulus, its residual apart; None: they do."""
    if result.converged is False:
        return "the fit did not converge"
    for name in result.at_bound or ():
        if any(part in name for part in DECISIVE_PARAMETERS):
            return f"{name.replace('_', ' ')} is on a bound of the search"
    return None


def drop_result(
    path: str | os.PathLike[str],
    analysis: DropAnalysis,
    point_warnings: Sequence[str] = (),
    point: Any = None,
) -> DropResult:
    """The result of one drop, with the keys of ``pfwd invert --json``.

    Parameters
    ----------
    path : of the file that the drop is from
    analysis : DropAnalysis
    point_warnings : sequence of str
        What should be known of the point as a whole.
    point : optional
        Its name, where it has one.
    """
    if analysis.stored is not None:
        kept = analysis.stored
        number, name = analysis.drop.number, os.fspath(path)
        return dataclasses.replace(
            kept, file=name, point=point, drop=number, refit=None, stored=True
        )
    status, reason = analysis.screening.status, analysis.screening.reason
    if analysis.fault is not None:
        status, reason = "rejected", analysis.fault
    warnings = [*point_warnings, *analysis.screening.warnings]
    found: dict[str, Any] = {}
    if analysis.result is not None:
        found = _found(analysis.result)
        found["explained"] = analysis.result.explained and not analysis.screening.clipped
        warnings += analysis.result.warnings
    if analysis.asked is not None and analysis.fault is None:
        found |= dataclasses.asdict(analysis.asked)
    return DropResult(
        file=os.fspath(path),
        point=point,
        drop=analysis.drop.number,
        status=status,
        reason=reason if status == "rejected" else None,
        peak_load_n=_peak_load(analysis.drop),
        **_deflections(analysis),
        warnings=tuple(warnings),
        **found,
    )


def _peak_load(drop: Drop) -> float | None:
    """Of the load less its offset, N; None where samples around the trigger are missing."""
    if drop.only_peaks is not None:
        return drop.only_peaks.load
    whole, missing, _ = whole_part(drop)
    if missing is not None or not whole.load.size:
        return None
    peak = float(remove_offset(whole.time, whole.load).max())
    return peak if math.isfinite(peak) else None


def _deflections(analysis: DropAnalysis) -> dict[str, Any]:
    """Peaks of the centre, and what a procedure has to know; of a rejected drop what is there."""
    # Loaded here: what a procedure has to know is found with what is kept in a result.
    from pfwd_survey.inverting.drop_facts import corrected_deflection, facts_of, recorded_deflection

    drop, setup = analysis.drop, analysis.setup
    rejected = analysis.screening.status == "rejected"
    return {
        "deflection_recorded_m": recorded_deflection(drop),
        "deflection_corrected_m": None if setup is None else corrected_deflection(drop, setup),
        "facts": None if setup is None or rejected else facts_of(drop, setup),
    }


def _found(result: InversionResult) -> dict[str, Any]:
    ground = result.subgrade
    area = math.pi * result.plate_radius**2

    def pulse(fit: Any) -> HalfSinePulse:
        return HalfSinePulse(
            peak_pressure_pa=fit.peak_load / area,
            duration_s=fit.duration,
            rms_over_peak=fit.rms_over_peak,
        )

    return {
        "method": result.method,
        "model": result.model,
        "modulus_pa": ground.modulus.value if result.modulus_known else None,
        "modulus_sd_pa": ground.modulus.deviation if result.modulus_known else None,
        "viscosity_pa_s": ground.viscosity.value,
        "viscosity_sd_pa_s": ground.viscosity.deviation,
        "density_kg_m3": ground.density.value,
        "density_sd_kg_m3": ground.density.deviation,
        "bedrock_depth_m": _finite(ground.bedrock_depth.value),
        "bedrock_depth_sd_m": ground.bedrock_depth.deviation,
        "modulus_interval_pa": result.modulus_interval,
        "bedrock_depth_interval_m": result.depth_interval,
        "modulus_depth_correlation": result.modulus_depth_correlation,
        "layers": tuple(_layer(layer) for layer in result.layers),
        "effective_modulus_pa": result.effective.modulus,
        "effective_modulus_interval_pa": result.effective.interval,
        "effective_depth_m": result.effective.depth,
        "poisson_ratio": result.poisson_ratio,
        "plate_radius_m": result.plate_radius,
        "plate": result.plate,
        "load": result.load,
        "half_sine": pulse(result.half_sine),
        "half_sine_equal_area": pulse(result.half_sine_equal_area),
        "peak_modulus_pa": result.peak.modulus,
        "peak_factor": result.peak.factor,
        "r_squared": result.r_squared,
        "noise_rms_m": result.noise_rms,
        "residual_rms_over_peak": result.residual_rms_over_peak,
        "contact_residual_rms_over_peak": result.contact_residual_rms_over_peak,
        "contact_end_s": result.history.contact_end,
        "window_end_s": result.history.window_end,
        "priors": result.priors,
        "explained": result.explained,
        "converged": result.converged,
        "at_bound": result.at_bound,
        "forward_solves": result.forward_solves,
        "elapsed_s": result.elapsed,
        "seed": result.seed,
    }


def _layer(layer: LayerValue) -> LayerResult:
    return LayerResult(
        modulus_pa=layer.modulus.value,
        modulus_sd_pa=layer.modulus.deviation,
        modulus_interval_pa=layer.modulus_interval,
        thickness_m=_finite(layer.thickness.value),
        thickness_sd_m=layer.thickness.deviation,
        thickness_interval_m=layer.thickness_interval,
        viscosity_pa_s=layer.viscosity,
        density_kg_m3=layer.density,
        poisson_ratio=layer.poisson_ratio,
    )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
