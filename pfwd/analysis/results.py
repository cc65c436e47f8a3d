"""Records of results: of a drop, of a diagnosis, of a file.

Importing them does not load the inversion.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

from inversion.diagnosis.findings import DropCurves, Verdict
from inversion.diagnosis.findings import EffectParameter as EffectParameter
from inversion.diagnosis.findings import EffectResult as EffectResult
from inversion.diagnosis.findings import FittedState as FittedState
from inversion.diagnosis.findings import HeldOut as HeldOut
from inversion.diagnosis.findings import HeldOutPart as HeldOutPart
from inversion.errors import RecordFormatError
from inversion.notices import Notice, invalidating, text_of
from inversion.records import Interval, JsonRecord, not_stored
from inversion.result import HalfSinePulse as HalfSinePulse
from inversion.result import InversionResult
from inversion.result import LayerResult as LayerResult
from inversion.result import StructureResult as StructureResult
from inversion.result import TimeHistories as TimeHistories
from pfwd.analysis.diagnosed_drop import DiagnosedDrop
from pfwd.analysis.screening.drops import DropStatus, Screening
from pfwd.digits import significant
from pfwd.display import (
    Displayable,
    alias,
    axes_or_new,
    count,
    draw_fit,
    draw_residual,
    one_line,
    warning_count,
)
from pfwd.errors import SurveyError, refusal
from pfwd.procedures import PointModulus
from pfwd.procedures.point import Use
from pfwd.units import modulus_text
from pfwd_device import Drop

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike, NDArray

    from pfwd.files.header import PointSetup


NARROW_FOR_DESIGN = 0.3
"""Largest distance of either end of the 95 % interval from the modulus, relative to it, at which
the modulus may be used for design."""

EXPLAINED_WITH_CARE = 0.03
"""Largest discrepancy over the peak at which the modulus of an unexplained point may be used with
care."""

WIDEST_WITH_CARE = 2.0
"""Largest ratio of the upper to the lower end of the 95 % interval of such a modulus."""


def _assumptions(result: DropResult | DiagnosisResult, model: str | None) -> str:
    """Return the assumptions of a modulus as text: model, plate, its radius, Poisson's ratio."""
    plate = f"{result.plate} plate of radius {result.plate_radius_m:g} m"
    return f"{model}, {plate}, Poisson's ratio {result.poisson_ratio:g}"


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class DiagnosisResult(JsonRecord, Displayable):
    """Effects that explain the residual of a point, and their influence on the modulus.

    The fields are the keys of ``pfwd diagnose --json``, in their order; each can be used as an
    index, too: ``diagnosis["held_out"]``. ``before`` is the fit of the base model, ``after`` the
    fit of the same model with the effects.
    """

    OPTIONAL_KEYS: ClassVar[frozenset[str]] = frozenset(
        {
            "point",
            "plate",
            "plate_radius_m",
            "poisson_ratio",
            "elapsed_s",
            "software",
            "question",
            "basis",
            "left_out",
            "stored",
            "fits",
        }
    )

    file: str = ""
    point: str | None = None
    """Name of the test point."""
    device: str | None = None
    """Name of the device that measured it."""
    drops: tuple[int, ...] = ()
    """Numbers of the drops that were fitted."""
    rejected: tuple[str, ...] = ()
    """Drops that were not fitted, with the reason."""
    plate: str | None = None
    plate_radius_m: float | None = None
    poisson_ratio: float | None = None
    verdict: Verdict = "unexplained"
    """clean, explained or unexplained."""
    corrected: bool = False
    """True if the modulus after the diagnosis may replace the one before it."""
    noise_rms_m: float | None = None
    """Root mean square of the noise before the pulse, m."""
    before: FittedState | None = None
    """Fit without effects; None: no drop was measured."""
    effects: tuple[EffectResult, ...] = ()
    """Detected effects, the strongest first."""
    after: FittedState | None = None
    held_out: HeldOut | None = None
    """Prediction errors; None: nothing was held out."""
    elapsed_s: float | None = None
    """Computing time, s, without the start of the program."""
    warnings: tuple[Notice, ...] = ()
    software: str | None = None
    """Name and version of the software that made it."""
    question: str | None = None
    """Identifier of the request: points, declarations, device values and held-out data."""
    basis: str | None = None
    """Identifier of the declarations of the point."""
    left_out: tuple[int, ...] | None = None
    """Numbers of drops that were present but not fitted."""
    stored: bool | None = None
    """True: the result comes from the survey; None: it was computed now."""
    fits: tuple[DiagnosedDrop, ...] | None = field(default=None, repr=False, compare=False)
    """Curves and residuals of each drop, which a survey stores beside the keys of the command;
    None: nothing was fitted."""
    curves: tuple[DropCurves, ...] = not_stored(())
    """Traces of the drops; empty for a stored diagnosis."""
    predictor: Callable[..., Any] | None = not_stored()
    """Function that predicts the next drop, see `predict`; None: no drop was diagnosed now."""
    point_modulus: PointModulus | None = not_stored()
    """Modulus of the point after the diagnosis; None: none, or it was not determined."""

    DERIVED: ClassVar[tuple[str, ...]] = ("use", "use_reason", "equivalent_use", "explained_to")
    """Keys of the JSON that follow from the others; a survey does not store them."""

    def to_json(self) -> dict[str, Any]:
        """Return the diagnosis as values that JSON can hold, in the order of the keys."""
        written = self.to_stored()
        written.pop("fits", None)
        alone = replace(self, point_modulus=None)
        derived = {key: getattr(alone, key) for key in self.DERIVED}
        return written | derived | {"use_reason": text_of(alone.use_reason)}

    def fit_of(self, drop: int) -> DiagnosedDrop | None:
        """Return the fits of a drop by its number; None: it was not fitted."""
        return next((fit for fit in self.fits or () if fit.drop == drop), None)

    def to_stored(self) -> dict[str, Any]:
        """Return the diagnosis with the fits of its drops, as a survey stores it."""
        return JsonRecord.to_json(self)

    @property
    def explained_to(self) -> float | None:
        """Discrepancy of the point over its peak: what is unexplained, allowance included.

        For a record without it, the whole residual, which is larger. The value is None if nothing
        was fitted.
        """
        after = self.after
        if after is None or after.discrepancy_over_peak is None:
            return None if after is None else after.residual_rms_over_peak
        return after.discrepancy_over_peak

    @property
    def use(self) -> Use:
        """Permitted use of the modulus with effects: "design", "with-care" or "do-not-use"."""
        return self._assess_modulus().use if self._fault is None else "do-not-use"

    @property
    def use_reason(self) -> Notice:
        """Reason for `use`."""
        return self._fault or self._assess_modulus().reason

    @property
    def _fault(self) -> Notice | None:
        """Reason why the records of the point support no modulus; None: they do."""
        return None if self.point_modulus is None else self.point_modulus.not_supported

    @property
    def supported_modulus(self) -> PointModulus | None:
        """Modulus of the point, unless its records support none."""
        return self.point_modulus if self._fault is None else None

    modulus: ClassVar[float | None] = alias("supported_modulus.value")
    """Modulus to use, Pa: fitted with the effects, or without them if `use` is ``do-not-use``;
    None: none."""
    modulus_interval: ClassVar[Interval | None] = alias("supported_modulus.interval")
    """95 % interval of `modulus`, Pa; None: there is no modulus."""
    equivalent_modulus: ClassVar[float | None] = alias("supported_modulus.equivalent")
    """Modulus of the half-space that deflects as much under the plate, Pa, from the source of
    `modulus`; None: none."""
    equivalent_modulus_interval: ClassVar[Interval | None] = alias(
        "supported_modulus.equivalent_interval"
    )
    """95 % interval of `equivalent_modulus`, Pa."""
    modulus_source: ClassVar[str | None] = alias("supported_modulus.source")
    """Source of `modulus`: ``diagnosed`` (with the effects) or ``fitted``; None: none."""

    @property
    def in_force(self) -> bool:
        """True: the modulus fitted with the effects is the one to use."""
        return self.modulus_source == "diagnosed"

    @property
    def equivalent_use(self) -> Use | None:
        """Permitted use of the equivalent modulus; None: as `use`, or there is none."""
        after = self.after
        if self._fault or after is None or after.equivalent_modulus_interval_pa is None:
            return None
        use = self._assess_use(
            after.equivalent_modulus_pa, after.equivalent_modulus_interval_pa
        ).use
        return None if use == self.use else use

    @property
    def remedy(self) -> Notice | None:
        """Advice for a new measurement if the modulus is not to be used; else None."""
        return self._assess_modulus().remedy if self._fault is None else Notice("repeat")

    def _assess_modulus(self) -> _UseAssessment:
        after = self.after
        return self._assess_use(
            None if after is None else after.modulus_pa,
            None if after is None else after.modulus_interval_pa,
        )

    def _assess_use(self, value: float | None, ends: Interval | None) -> _UseAssessment:
        """Return the use that the diagnosis permits for a modulus, Pa, with its interval."""
        explained_to = self.explained_to
        if value is None or ends is None or explained_to is None or not 0.0 < value < math.inf:
            reason = Notice("modulus-open")
            return _UseAssessment("do-not-use", reason, self._remedy("repeat-longer"))
        fault = invalidating(self.warnings, "record")
        if fault is not None:
            return _UseAssessment("do-not-use", fault, self._remedy("correct-declarations"))
        low, high = ends
        if self.verdict in ("clean", "explained"):
            reach = max(high - value, value - low) / value
            if reach < NARROW_FOR_DESIGN:
                return _UseAssessment("design", Notice(f"record-is-{self.verdict}"))
            shares = {"reach": reach, "limit": NARROW_FOR_DESIGN}
            reason = Notice("interval-too-wide", shares)
            return _UseAssessment("do-not-use", reason, self._remedy("repeat-with-sensor"))
        if explained_to > EXPLAINED_WITH_CARE:
            shares = {"share": explained_to, "limit": EXPLAINED_WITH_CARE}
            reason = Notice("unexplained-too-much", shares)
            return _UseAssessment("do-not-use", reason, self._remedy("repeat-seated"))
        if not high < WIDEST_WITH_CARE * low:
            reason = Notice("interval-spans", {"factor": WIDEST_WITH_CARE})
            return _UseAssessment("do-not-use", reason, self._remedy("repeat-with-sensor"))
        return _UseAssessment("with-care", Notice("unexplained-covered", {"share": explained_to}))

    def _remedy(self, default: str) -> Notice:
        """Return the remedy for a warning, else for the strongest effect, else the default."""
        codes = {warning.code for warning in self.warnings}
        for warned, remedy in _REMEDIES_OF_WARNINGS.items():
            if warned in codes:
                return Notice(remedy)
        strongest = next(iter(self.effects), None)
        if strongest is not None and strongest.scope == "drop" and strongest.advice:
            return Notice("repeat-with-advice", {"advice": strongest.advice})
        return Notice(default)

    def __repr__(self) -> str:
        verdict, names = str(self.verdict), [effect.name for effect in self.effects]
        if names:
            verdict += " by " if verdict == "explained" or self.corrected else ", found "
            verdict += ", ".join(names)
        file = one_line(os.path.basename(self.file))
        parts = [f"{file}, {count(len(self.drops), 'drop')}: {verdict}"]
        if self.before is not None and self.after is not None:
            before, after = (
                modulus_text(state.modulus_pa, state.modulus_interval_pa)
                for state in (self.before, self.after)
            )
            use = f" before, {after} after: {self._use_words()}" if names else ""
            parts += [f"E {before}{use}", _assumptions(self, self.after.model)]
        return f"Diagnosis({'; '.join([*parts, warning_count(self.warnings)])})"

    def _use_words(self) -> str:
        """Return a phrase on the use of the modulus with effects, and on what to use instead."""
        words = {"design": "design value", "with-care": "use with care"}
        instead = "use none" if self.modulus is None else "use the one before"
        return words.get(self.use, f"do not use ({text_of(self.use_reason)}), {instead}")

    def __str__(self) -> str:
        line, *warnings = Displayable.__str__(self).splitlines()
        return "\n".join([line, *(effect.line for effect in self.effects), *warnings])

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """Return a row for the fit before and one for the fit after the effects were added."""
        values = self.to_dict()
        names = tuple(effect.name for effect in self.effects)
        return [
            {
                **{key: values.get(key) for key in ("file", "point", "verdict")},
                "state": label,
                "effects": names if label == "after" else (),
                **values[label],
                "in_force": self.modulus is not None and self.in_force == (label == "after"),
                "use": self.use,
                "use_reason": text_of(self.use_reason),
                **{key: values.get(key) for key in ("plate", "plate_radius_m", "poisson_ratio")},
                "warnings": values["warnings"],
            }
            for label in ("before", "after")
            if values[label] is not None
        ]

    def predict(self, time: ArrayLike, load: ArrayLike) -> NDArray[Any]:
        """Return the displacement that the instrument would record in the next drop.

        The prediction uses the drops of the point, and all points of the same instrument that were
        diagnosed in the same call: the hardening of the ground from drop to drop, and the effects
        that the fits have in common. Mains hum is not predicted. The first call fits all these
        points.

        Parameters
        ----------
        time : (n,) s, uniform steps; 0 is the trigger, with some rest before it
        load : (n,) N, downward positive

        Returns
        -------
        (n_sensors, n) m, downward positive, 0 before the pulse
            Displacement of the diagnosed sensors, in the order of the drop.

        Raises
        ------
        SurveyError, InversionError
            If no drop was diagnosed, or the arrays are not the load of a drop.
        """
        if self.predictor is None:
            raise SurveyError(refusal(str(self.file), "a diagnosed drop to predict from", "none"))
        from pfwd.files.arrays import time_and_load

        predicted: NDArray[Any] = self.predictor(*time_and_load(time, load))
        return predicted

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the residual before and after, in % of the peak over ms.

        Parameters
        ----------
        ax : Axes of matplotlib, optional
            None: a new figure is made.

        Raises
        ------
        SurveyError
            If the point has no measured drop, or the diagnosis is a stored one, without traces.
        """
        if not self.curves:
            hint = "diagnose with refit=True" if self.stored else ""
            raise SurveyError(refusal(str(self.file), "a diagnosed drop to draw", "none", hint))
        return draw_residual(axes_or_new(ax), self.curves, repr(self))


class _UseAssessment(NamedTuple):
    """Permitted use of the modulus of a diagnosis, with reason and remedy."""

    use: Use
    reason: Notice
    remedy: Notice | None = None


_REMEDIES_OF_WARNINGS = {
    "sensor-upside-down": "correct-named-declaration",
    "sensors-exchanged": "correct-named-declaration",
    "bedrock-elsewhere": "correct-named-declaration",
    "bedrock-contradicted": "correct-named-declaration",
    "load-steps": "repeat-without-gaps",
    "sensor-steps": "repeat-without-gaps",
}
"""Codes of the remedies by the code of the warning that requires them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DropDiagnosis(JsonRecord):
    """Diagnosis of the point of a drop, as `pfwd invert --diagnose` reports it with the drop."""

    verdict: Verdict
    """clean, explained or unexplained."""
    corrected: bool
    effects: tuple[EffectResult, ...]
    """Detected effects, the strongest first."""
    after: FittedState | None


@dataclass(frozen=True, slots=True)
class AnalysisRequest:
    """Identifiers of the request for which a result was computed: question, settings, software."""

    question: str
    settings: str
    software: str


@dataclass(frozen=True, eq=False)
class DropAnalysis:
    """A drop with its screening and the result of its inversion.

    ``result`` is None for a rejected drop, and for one whose inversion failed; ``fault`` then has
    the reason.
    """

    drop: Drop
    screening: Screening
    result: InversionResult | None
    fault: Notice | None = None
    setup: PointSetup | None = None
    """Declarations for the drop; None: its deflection is not corrected for the geophone
    response."""
    request: AnalysisRequest | None = None
    stored: DropResult | None = None
    """Stored result of the same request; ``result`` is then None."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredFacts(JsonRecord):
    """Facts of a drop that its procedure judges, computed from its traces and stored."""

    OPTIONAL_KEYS: ClassVar[frozenset[str]] = frozenset({"rejected"})

    version: int
    """Version of the computation, see `pfwd.analysis.drop_facts.FACTS_VERSION`."""
    peak_load_n: float | None = None
    pulse_peak_n: float | None = None
    """Peak load without single-sample spikes, N, by which the drops of a point are compared."""
    deflection_m: float | None = None
    """Peak deflection in the centre, m, with the geophone response below removed."""
    velocity_m_per_s: float | None = None
    duration_s: float | None = None
    offset_over_peak: float | None = None
    return_over_peak: float | None = None
    geophone_natural_frequency_hz: float | None = None
    """Natural frequency of the geophone response that was removed, Hz; None: none was."""
    geophone_damping: float | None = None
    rejected: Notice | None = None
    """Reason why the drop is rejected, in which case the other facts are None; None: it is not."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class DropResult(InversionResult, Displayable):
    """Properties of the ground under one drop, or the reason why the drop has none.

    Each key of ``pfwd invert --json`` is an attribute, with its SI unit: ``result.viscosity_pa_s``.
    The most used ones have a second name without the unit: ``result.viscosity``. ``result.history``
    has measured and fitted traces; it is None for a rejected drop and for a stored result.
    """

    OPTIONAL_KEYS: ClassVar[frozenset[str]] = frozenset(
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

    file: str = ""
    """File with the drop."""
    point: str | int | float | None = None
    """Name of the test point."""
    drop: int = 0
    """Number of the drop at its point."""
    status: DropStatus = "measured"
    reason: Notice | None = None
    """Reason why the drop was rejected."""
    peak_load_n: float | None = None
    """Peak of the measured load minus its offset, N."""
    deflection_recorded_m: float | None = None
    """Peak deflection in the centre as recorded, m."""
    deflection_corrected_m: float | None = None
    """Peak deflection in the centre, m, with the declared geophone response removed; procedures
    judge it."""
    facts: MeasuredFacts | None = None
    """Facts for the judgement of the point, so that the traces need not be read again."""
    refit: str | None = None
    """Settings of a trial, which is not in force; None: the result is no trial."""
    software: str | None = None
    """Name and version of the software that made it."""
    settings: str | None = None
    """Settings that differ from the default, as text."""
    question: str | None = None
    """Identifier of the request: samples, declarations and settings."""
    stored: bool | None = None
    """True: the result comes from the survey; None: it was computed now."""
    diagnosis: DropDiagnosis | None = None
    """Diagnosis of the point; None: none was requested."""
    in_force: bool = not_stored(False)
    """True: the result is in force for its drop, or would be if it were stored; False: it has other
    settings, its declarations have changed since, or there is no modulus."""
    read_history: Callable[[], TimeHistories | None] | None = not_stored()
    """Function that reads the traces of a stored drop, with the fit whose modulus is in force;
    None: the result is not in force, or not from a survey."""

    number: ClassVar[int] = alias("drop")
    """Number of the drop within its point, also as ``drop``."""
    modulus: ClassVar[float | None] = alias("modulus_pa")
    """Young's modulus of the ground, Pa, also as ``modulus_pa``; None: no modulus."""
    modulus_interval: ClassVar[Interval | None] = alias("modulus_interval_pa")
    """95 % interval of the modulus, Pa, also as ``modulus_interval_pa``; None: no modulus."""
    equivalent_modulus: ClassVar[float | None] = alias("equivalent_modulus_pa")
    """Modulus of the half-space that deflects as much under the plate, Pa, also as
    ``equivalent_modulus_pa``; None: no modulus, or no sensor on the plate."""
    equivalent_modulus_interval: ClassVar[Interval | None] = alias("equivalent_modulus_interval_pa")
    """95 % interval of the equivalent modulus, Pa."""
    viscosity: ClassVar[float | None] = alias("viscosity_pa_s")
    """Viscosity of the ground, Pa s, also as ``viscosity_pa_s``; None: not in the model."""
    density: ClassVar[float | None] = alias("density_kg_m3")
    """Density of the ground, kg/m3, also as ``density_kg_m3``; None: no modulus."""
    bedrock_depth: ClassVar[float | None] = alias("bedrock_depth_m")
    """Depth of the bedrock, m, also as ``bedrock_depth_m``; None: not in the model."""
    plate_radius: ClassVar[float | None] = alias("plate_radius_m")
    """Radius of the plate, m, also as ``plate_radius_m``; None: no modulus."""

    @property
    def is_trial(self) -> bool:
        """True if the result was made with other settings as a trial.

        Such a result is not in force.
        """
        return self.refit is not None

    @property
    def has_ground(self) -> bool:
        """True if a ground was fitted; the modulus of its lowest layer may be unknown."""
        return self.modulus_pa is not None or bool(self.layers)

    @classmethod
    def from_json(cls, written: object) -> Self:
        """Return the result that JSON contains, see `JsonRecord.from_json`.

        Raises
        ------
        RecordFormatError
            If the JSON is no valid record, or if a part that belongs to a fitted ground is missing.
        """
        result = super(DropResult, cls).from_json(written)
        if result.has_ground:
            for name in _PARTS_OF_FIT:
                if getattr(result, name) is None:
                    raise RecordFormatError(f"{name}: expected a value beside the modulus")
            depth = result.bedrock_depth_m
            if depth is not None and not depth > 0.0:
                raise RecordFormatError(f"bedrock_depth_m: expected a depth > 0, got {depth}")
            if result.modulus_sd_pa is None is result.modulus_interval_pa:
                raise RecordFormatError("expected a modulus with an uncertainty, got none")
        return result

    def to_json(self) -> dict[str, Any]:
        """Return the result as values that JSON can hold, in the order of its keys."""
        written = self.to_stored()
        return written if self.reason is None else written | {"reason": text_of(self.reason)}

    def to_stored(self) -> dict[str, Any]:
        """Return the result with the code of its reason, as a survey stores it."""
        return JsonRecord.to_json(self)

    @property
    def not_supported(self) -> Notice | None:
        """Reason why the data do not support the modulus, by the default limit; None: they do."""
        from pfwd.procedures.profile import OUR_TOLERANCES
        from pfwd.procedures.values import residual_fault

        if self.modulus_pa is None:
            return None
        limit = OUR_TOLERANCES["most_residual"]
        return fit_fault(self) or residual_fault(self.contact_residual_rms_over_peak, limit)

    def in_diagnosis(self, drop: DiagnosedDrop | None) -> DropResult:
        """Return the result with the residuals of a diagnosis, and without the fit of the drop."""
        no_fit: dict[str, Any] = dict.fromkeys(_FIT_FIELDS)
        whole, contact = None, None
        if drop is not None:
            whole, contact = drop.residual_rms_over_peak, drop.contact_residual_rms_over_peak
        return replace(
            self.without_ground(),
            **no_fit,
            warnings=(),
            residual_rms_over_peak=whole,
            contact_residual_rms_over_peak=contact,
        )

    def without_ground(self) -> DropResult:
        """Return the result without the fitted parameters of the ground."""
        names = (item.name for item in fields(self) if item.name.startswith(_GROUND_FIELDS))
        no_ground: dict[str, Any] = dict.fromkeys(names)
        return replace(self, **no_ground)

    @property
    def half_sine_load_n(self) -> float | None:
        """Peak of the half-sine fitted to the load, N."""
        pressure = None if self.half_sine is None else self.half_sine.peak_pressure_pa
        if pressure is None or self.plate_radius_m is None:
            return None
        return pressure * math.pi * self.plate_radius_m**2

    @property
    def assumptions(self) -> str:
        """Model, plate and Poisson's ratio of the modulus, as text."""
        depth = "" if self.bedrock_depth_m is None else f" {self.bedrock_depth_m:.3g} m deep"
        return _assumptions(self, f"{self.model}{depth}")

    @property
    def modulus_words(self) -> str:
        """Modulus with its interval, or else with its standard deviation, as text."""
        text = modulus_text(self.modulus_pa, self.modulus_interval_pa)
        if self.modulus_interval_pa is None and self.modulus_sd_pa is not None:
            return f"{text}, sd {significant(self.modulus_sd_pa / 1e6)} MPa"
        return text

    def __repr__(self) -> str:
        return f"Result({': '.join(self._lines())})"

    def _lines(self) -> tuple[str, str]:
        """Return the name of the drop, and its modulus with what belongs to it."""
        name = f"drop {self.drop}" + ("" if self.point is None else f" of {one_line(self.point)}")
        if self.modulus_pa is None:
            return name, f"{self.status}, {one_line(text_of(self.reason) or 'no modulus')}"
        warned = warning_count(self.warnings)
        return name, f"E {self.modulus_words}; {self.assumptions}; {warned}"

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """Return the row of the drop."""
        return [{**self.to_dict(), "in_force": self.in_force}]

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the measured and the fitted displacement, in µm over ms.

        For a result of a survey the fit is that whose modulus is in force; if it is a diagnosis,
        the fit without effects is drawn in grey.

        Parameters
        ----------
        ax : Axes of matplotlib, optional
            None: a new figure is made.

        Raises
        ------
        SurveyError
            If the result has no traces.
        """
        history = self.history
        if history is None and self.read_history is not None:
            history = self.read_history()
        if history is None:
            hint = text_of(self.reason) or "make a new one with pfwd.invert"
            expected = "a result with traces to draw"
            raise SurveyError(refusal(f"drop {self.drop}", expected, "one without", hint))
        title = "\n".join(self._lines())
        if history.before is not None:
            title += "\nin force is the modulus of the diagnosis of the point, whose fit is drawn"
        return draw_fit(axes_or_new(ax), history, title)


_PARTS_OF_FIT = (
    *("model", "viscosity_pa_s", "density_kg_m3", "poisson_ratio"),
    *("plate", "plate_radius_m"),
)
"""Fields that every fitted ground has."""

_GROUND_FIELDS = (
    *("modulus_", "viscosity_", "density_", "bedrock_depth_", "layers", "effective_"),
    "equivalent_",
)
"""Beginnings of the names of the fields of `DropResult` that a fit determines."""

_FIT_FIELDS = (
    *("method", "model", "structures", "added_mass_kg", "sensor_lag_s", "drift_m", "r_squared"),
    *("priors", "explained", "converged", "at_bound", "forward_solves", "seed"),
    *("window_end_s", "elapsed_s"),
)
"""Further fields that belong to the fit of a drop alone."""


def fit_fault(result: DropResult) -> Notice | None:
    """Return the reason why the data do not support a modulus; None: they do.

    It is the first warning that invalidates a fit, or else what the search reports. The size of the
    residual is judged by the procedure.
    """
    warning = invalidating(result.warnings, "fit")
    if warning is not None:
        return warning
    if result.converged is False:
        return Notice("not-converged")
    for name in result.at_bound or ():
        return Notice("parameter-on-bound", {"parameter": name})
    return None


@dataclass(frozen=True, slots=True)
class FileOutcome:
    """Results of one file, or the reason why there are none."""

    file: str
    """Path of the file, as the caller gave it."""
    error: str | None = None
    """Reason why the file is not valid, in one line; None: it is valid."""
    results: list[DropResult] = field(default_factory=list)
    """One for each drop; fitted traces are included unless it was rejected or stored before."""
    numbers: list[int | None] = field(default_factory=list, repr=False)
    """Number of each drop within its survey; None: the drop is in no survey."""

    @property
    def of_survey(self) -> list[tuple[int, DropResult]]:
        """Results of drops in a survey, with the numbers of the drops within it."""
        pairs = zip(self.numbers, self.results, strict=True) if self.numbers else ()
        return [(number, result) for number, result in pairs if number is not None]


def relative_spread(result: DropResult) -> float:
    """Return a lower bound of the relative uncertainty of fitted parameters.

    The standard deviations of viscosity, density and depth include the noise only. The interval of
    the modulus also includes the error of the model, and an unexplained residual may shift every
    parameter by as much.

    Parameters
    ----------
    result : DropResult

    Returns
    -------
    float
        0 if neither is known.
    """
    spread = 0.0
    if result.modulus_pa and result.modulus_interval_pa is not None:
        low, high = result.modulus_interval_pa
        spread = (high - low) / 2 / result.modulus_pa
    if result.explained is False:
        spread = max(spread, result.contact_residual_rms_over_peak or 0.0)
    return spread if math.isfinite(spread) else 0.0
