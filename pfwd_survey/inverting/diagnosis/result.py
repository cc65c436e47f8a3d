"""What a diagnosis says of a point, without loading what found it."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from inversion.records import Interval
from pfwd_survey.inverting.stored import StoredRecord

if TYPE_CHECKING:
    from pfwd_survey.procedures.point import Use

LEFT_OPEN = 10.0
"""Times as high as low, from which on an interval says nothing of a modulus."""

# As the inversion names it.
_CHOICE_OF_EFFECTS = "choice of effects"
_WITH_FITTED = (
    "contact_before",
    "contact_after",
    "scaled_record",
    "contact_scaled_record",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedState(StoredRecord):
    """The point before or after the effects were added."""

    LEFT_OUT: ClassVar[frozenset[str]] = frozenset({"stress_pa", "modulus_100kpa_pa"})

    model: str | None = None
    """half-space or layer; rig where there is no ground."""
    modulus_pa: float | None = None
    """Pa; None without ground, and where the interval leaves it open."""
    modulus_sd_pa: float | None = None
    """Pa."""
    modulus_interval_pa: Interval | None = None
    """95 %, with what is left unexplained, over all sets of effects that fit nearly as well, Pa."""
    stress_pa: float | None = None
    """Mean contact pressure at the peak of the last drop, Pa: the modulus is the secant one there;
    of the point after the effects were added."""
    modulus_100kpa_pa: float | None = None
    """The secant modulus at 100 kPa, Pa; of the point after the effects were added."""
    residual_rms_m: float | None = None
    """m."""
    residual_over_noise: float | None = None
    residual_rms_over_peak: float | None = None
    """From the trigger to the end of the record."""
    contact_residual_rms_over_peak: float | None = None
    """To the end of the contact."""

    @property
    def left_open(self) -> bool:
        """Whether the interval is so wide that a modulus within it would say nothing."""
        low, high = self.modulus_interval_pa or (0.0, 0.0)
        return all(map(math.isfinite, (low, high))) and high > LEFT_OPEN * low


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectParameter(StoredRecord):
    """One number of an effect."""

    LEFT_OUT: ClassVar[frozenset[str]] = frozenset({"drop", "spread"})

    name: str | None = None
    value: float | None = None
    """In the unit."""
    sd: float | None = None
    """Its standard deviation; None: not known."""
    unit: str | None = None
    """SI; - for none."""
    drop: int | None = None
    """Number of the drop that it belongs to; None: to all."""
    spread: float | None = None
    """By which the points of the device differ, each by itself, in the unit; None: not asked."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectResult(StoredRecord):
    """An effect that the residual asks for."""

    LEFT_OUT: ClassVar[frozenset[str]] = frozenset(
        {"scope", "probability", "advice", "residual_without_over_peak"}
    )

    name: str | None = None
    scope: str | None = None
    """What shares it: device, point or drop."""
    value: float | None = None
    """Of its first parameter, the middle over the drops."""
    sd: float | None = None
    """Its standard deviation; None: not known."""
    unit: str | None = None
    """SI; - for none."""
    parameters: tuple[EffectParameter, ...] | None = None
    evidence: float | None = None
    """Drop of the Bayesian information criterion; None: shared by the points of the device."""
    probability: float | None = None
    """Share of the sets of effects that fit nearly as well which have it, by their weight."""
    residual_without_over_peak: float | None = None
    """What is left when it alone is taken away; None: shared by the points of the device."""
    alternatives: tuple[str, ...] | None = None
    """Effects that would do in its place, at most two."""
    advice: str | None = None
    """What to do in the field."""


NARROW_FOR_DESIGN = 0.3
"""Half-width of the interval over the modulus of a design value, either side."""

EXPLAINED_WITH_CARE = 0.03
"""Largest discrepancy over the peak of an unexplained point whose modulus may be used with care."""

WIDEST_WITH_CARE = 2.0
"""Upper over lower end of the interval of such a modulus."""


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutOne(StoredRecord):
    """A held-out drop, sensor or point; errors are rms over its peak."""

    LEFT_OUT: ClassVar[frozenset[str]] = frozenset({"fitted"})

    name: str | None = None
    fitted: tuple[str, ...] | None = None
    """Every number that was fitted to the held-out data."""
    before: float | None = None
    """By the base model."""
    after: float | None = None
    """With the effects."""
    contact_before: float | None = None
    contact_after: float | None = None
    scaled_record: float | None = None
    """By the preceding record, scaled by the peak loads; None: there is none."""
    contact_scaled_record: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the record with the keys of its JSON, in their order."""
        return _as_written(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOut(StoredRecord):
    """How well held-out drops, sensors or points are predicted; errors are rms over the peak."""

    LEFT_OUT: ClassVar[frozenset[str]] = frozenset({"mode", "fitted", "by"})

    mode: str | None = None
    """next, drop, sensor or point."""
    fitted: tuple[str, ...] | None = None
    """Every number that was fitted to the held-out data; none: a prediction."""
    before: float | None = None
    after: float | None = None
    contact_before: float | None = None
    contact_after: float | None = None
    scaled_record: float | None = None
    contact_scaled_record: float | None = None
    by: tuple[HeldOutOne, ...] | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the record with the keys of its JSON, in their order."""
        return _as_written(self)

    @property
    def is_prediction(self) -> bool:
        """Whether the held-out data had no part in the choice of the effects."""
        return self.fitted is not None and _CHOICE_OF_EFFECTS not in self.fitted


def _as_written(record: HeldOutOne | HeldOut) -> dict[str, Any]:
    """Return the JSON of a record; one without ``fitted`` is older than the keys beside it."""
    written = StoredRecord.to_json(record)
    newer = () if record.fitted is not None else _WITH_FITTED
    return {key: value for key, value in written.items() if key not in newer or value is not None}


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosisResult(StoredRecord):
    """What is behind the residual of a point: the keys of ``pfwd diagnose --json``, in order."""

    LEFT_OUT: ClassVar[frozenset[str]] = frozenset(
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
        }
    )

    file: str | None = None
    point: str | None = None
    """Name of the test point."""
    device: str | None = None
    """Name of the device that measured it."""
    drops: tuple[int, ...] | None = None
    """Numbers of the drops that were fitted."""
    rejected: tuple[str, ...] | None = None
    """Drops that were not, and why."""
    plate: str | None = None
    plate_radius_m: float | None = None
    poisson_ratio: float | None = None
    verdict: str | None = None
    """clean, explained or unexplained."""
    corrected: bool | None = None
    """Whether the modulus after may be taken for corrected."""
    noise_rms_m: float | None = None
    """m."""
    before: FittedState | None = None
    """None: no drop was measured."""
    effects: tuple[EffectResult, ...] | None = None
    """Strongest first."""
    after: FittedState | None = None
    held_out: HeldOut | None = None
    """None: nothing was held out."""
    elapsed_s: float | None = None
    """s, without start-up."""
    warnings: tuple[str, ...] | None = None
    software: str | None = None
    """That made it, with its version."""
    question: str | None = None
    """Tells what was asked: the points of the device, what was declared, given, and left out."""
    basis: str | None = None
    """Tells what was declared of the point apart."""
    left_out: tuple[int, ...] | None = None
    """Numbers of drops that were there and took no part."""
    stored: bool | None = None
    """Whether the survey kept it from before; None: no."""

    DERIVED: ClassVar[tuple[str, ...]] = ("use", "use_reason", "explained_to")
    """Keys of the JSON that follow from the others; those that a file has are not read."""

    def to_json(self) -> dict[str, Any]:
        """Return the record with the keys of its JSON, in their order."""
        return StoredRecord.to_json(self) | {key: getattr(self, key) for key in self.DERIVED}

    @classmethod
    def from_json(cls, said: object, where: str = "a stored record") -> Self:
        """Read the record from JSON, see `StoredRecord.from_json`."""
        if isinstance(said, dict):
            said = {key: value for key, value in said.items() if key not in cls.DERIVED}
        return super(DiagnosisResult, cls).from_json(said, where)

    @property
    def explained_to(self) -> float | None:
        """Residual beyond the noise over the peak of the point; None: nothing was fitted."""
        after = self.after
        if after is None or after.residual_rms_over_peak is None:
            return None
        ratio = after.residual_over_noise
        if ratio is None or not math.isfinite(ratio):
            return after.residual_rms_over_peak
        beyond = math.sqrt(max(0.0, 1.0 - (1.0 / ratio) ** 2)) if ratio > 1.0 else 0.0
        return after.residual_rms_over_peak * beyond

    @property
    def use(self) -> "Use":
        """What the modulus after the diagnosis may be used for."""
        return self._use_and_reason[0]

    @property
    def use_reason(self) -> str:
        """Why, in one sentence."""
        return self._use_and_reason[1]

    @property
    def _use_and_reason(self) -> "tuple[Use, str]":
        after, explained_to = self.after, self.explained_to
        ends = None if after is None else after.modulus_interval_pa
        if after is None or after.modulus_pa is None or ends is None or explained_to is None:
            return "do-not-use", "the diagnosis leaves the modulus open"
        value, (low, high) = after.modulus_pa, ends
        if not 0.0 < value < math.inf:
            return "do-not-use", "the diagnosis leaves the modulus open"
        if self.verdict in ("clean", "explained"):
            reach = max(high - value, value - low) / value
            if reach < NARROW_FOR_DESIGN:
                return "design", f"the record is {self.verdict} and the interval is narrow"
            return "do-not-use", (
                f"the interval of the modulus reaches {_percent(reach)} from it, at most "
                f"{_percent(NARROW_FOR_DESIGN)} is allowed"
            )
        if explained_to > EXPLAINED_WITH_CARE:
            return "do-not-use", (
                f"{_percent(explained_to)} of the peak is not explained, at most "
                f"{_percent(EXPLAINED_WITH_CARE)} is allowed"
            )
        if not high < WIDEST_WITH_CARE * low:
            return "do-not-use", (
                f"the interval of the modulus spans more than a factor of {WIDEST_WITH_CARE:g}"
            )
        return "with-care", (
            f"{_percent(explained_to)} of the peak is not explained, the interval covers it"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class DropDiagnosis(StoredRecord):
    """What a drop's line says of the diagnosis of its point, `pfwd invert --diagnose`."""

    verdict: str | None = None
    """clean, explained or unexplained."""
    corrected: bool | None = None
    effects: tuple[EffectResult, ...] | None = None
    """Strongest first."""
    after: FittedState | None = None
