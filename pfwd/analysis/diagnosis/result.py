"""What a diagnosis says of a point, without loading what found it."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from inversion.diagnosis.findings import EffectParameter as EffectParameter
from inversion.diagnosis.findings import EffectResult as EffectResult
from inversion.diagnosis.findings import FittedState as FittedState
from inversion.diagnosis.findings import HeldOut as HeldOut
from inversion.diagnosis.findings import HeldOutPart as HeldOutPart
from inversion.notices import Notice
from pfwd.analysis.stored import StoredRecord

if TYPE_CHECKING:
    from pfwd.procedures.point import Use

NARROW_FOR_DESIGN = 0.3
"""Half-width of the interval over the modulus of a design value, either side."""

EXPLAINED_WITH_CARE = 0.03
"""Largest discrepancy over the peak of an unexplained point whose modulus may be used with care."""

WIDEST_WITH_CARE = 2.0
"""Upper over lower end of the interval of such a modulus."""


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


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
    warnings: tuple[Notice, ...] | None = None
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
        """Discrepancy over the peak of the point; None: nothing was fitted.

        Diagnoses of earlier versions have none: then the residual beyond the noise.
        """
        after = self.after
        if after is not None and after.discrepancy_over_peak is not None:
            return after.discrepancy_over_peak
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
