"""The result of one drop, without loading what found it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from inversion.result import HalfSinePulse as HalfSinePulse
from inversion.result import InversionResult
from inversion.result import LayerResult as LayerResult
from inversion.result import TimeHistories as TimeHistories
from pfwd.analysis.diagnosis.result import DropDiagnosis
from pfwd.analysis.screening.drops import DropStatus, Screening
from pfwd.analysis.stored import StoredRecord
from pfwd_device import Drop

if TYPE_CHECKING:
    from pfwd.files.header import PointSetup


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
    """Facts of a drop that its procedure judges, computed from its traces."""

    LEFT_OUT: ClassVar[frozenset[str]] = frozenset({"rejected"})

    version: int | None = None
    """Version of the computation, see `pfwd.analysis.drop_facts.FACTS_VERSION`."""
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
    rejected: str | None = None
    """Reason why the record is no drop, which then has no other facts; None: it is one.

    Programs of before this key ignore facts that have it, and read the traces.
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class DropResult(InversionResult, StoredRecord):
    """Result of one drop of a survey: the keys of ``pfwd invert --json``."""

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
    FIRST: ClassVar[tuple[str, ...]] = ("file", "point", "drop", "status", "reason")

    file: str | None = None
    """That the drop is from."""
    point: str | int | float | None = None
    """Name of its test point."""
    drop: int | None = None
    """Number within the point."""
    status: DropStatus | None = None
    reason: str | None = None
    """Why it was rejected."""
    peak_load_n: float | None = None
    """Of the measured load, less its offset, N; None in results of earlier versions."""
    deflection_recorded_m: float | None = None
    """Peak of the centre as recorded, m."""
    deflection_corrected_m: float | None = None
    """The same with the declared response of the geophone taken out, m; procedures judge it."""
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
        from pfwd.procedures.profile import OUR_TOLERANCES
        from pfwd.procedures.valuing import residual_fault

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
