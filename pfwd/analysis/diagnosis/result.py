"""Result of the diagnosis of a point. It is read without loading the inversion."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

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
    """Return a share in percent with two digits, without powers of ten."""
    percent = 100.0 * share
    return f"{percent:.0f} %" if percent >= 10.0 else f"{percent:.2g} %"


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosisResult(StoredRecord):
    """Diagnosis of a point: the keys of ``pfwd diagnose --json``, in their order."""

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
    def from_json(cls, written: object, where: str = "a stored record") -> Self:
        """Read the record from JSON, see `StoredRecord.from_json`."""
        if isinstance(written, dict):
            written = {key: value for key, value in written.items() if key not in cls.DERIVED}
        return super(DiagnosisResult, cls).from_json(written, where)

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
        return self._assess_use().use

    @property
    def use_reason(self) -> str:
        """Reason for `use`, in one sentence."""
        return self._assess_use().reason

    @property
    def remedy(self) -> str:
        """What to do about a modulus that is not to be used; empty: it may be used."""
        return self._assess_use().remedy

    def _assess_use(self) -> "_UseAssessment":
        after, explained_to = self.after, self.explained_to
        ends = None if after is None else after.modulus_interval_pa
        value = None if after is None else after.modulus_pa
        if value is None or ends is None or explained_to is None or not 0.0 < value < math.inf:
            reason = "the diagnosis leaves the modulus open"
            return _UseAssessment("do-not-use", reason, self._remedy(_REMEDY_OPEN))
        low, high = ends
        if self.verdict in ("clean", "explained"):
            reach = max(high - value, value - low) / value
            if reach < NARROW_FOR_DESIGN:
                reason = f"the record is {self.verdict} and the interval is narrow"
                return _UseAssessment("design", reason)
            reason = (
                f"the interval of the modulus reaches {_percent(reach)} from it, at most "
                f"{_percent(NARROW_FOR_DESIGN)} is allowed"
            )
            return _UseAssessment("do-not-use", reason, self._remedy(_REMEDY_WIDE))
        if explained_to > EXPLAINED_WITH_CARE:
            reason = (
                f"{_percent(explained_to)} of the peak is not explained, at most "
                f"{_percent(EXPLAINED_WITH_CARE)} is allowed"
            )
            return _UseAssessment("do-not-use", reason, self._remedy(_REMEDY_UNEXPLAINED))
        if not high < WIDEST_WITH_CARE * low:
            reason = f"the interval of the modulus spans more than a factor of {WIDEST_WITH_CARE:g}"
            return _UseAssessment("do-not-use", reason, self._remedy(_REMEDY_WIDE))
        reason = f"{_percent(explained_to)} of the peak is not explained, the interval covers it"
        return _UseAssessment("with-care", reason)

    def _remedy(self, usual: str) -> str:
        """Return the remedy of a warning, else of the strongest effect, else the usual one."""
        codes = {warning.code for warning in self.warnings or () if isinstance(warning, Notice)}
        for warned, remedy in _REMEDIES_OF_WARNINGS.items():
            if warned in codes:
                return remedy
        strongest = next(iter(self.effects or ()), None)
        if strongest is not None and strongest.scope == "drop" and strongest.advice:
            return f"measure again: {strongest.advice}"
        return usual


class _UseAssessment(NamedTuple):
    """What the modulus of a diagnosis may be used for."""

    use: "Use"
    reason: str
    remedy: str = ""


_REMEDY_OPEN = (
    "measure again with one more sensor beside the plate and a longer record, or declare the depth "
    "of rock"
)
_REMEDY_WIDE = "measure again with one more sensor beside the plate"
_REMEDY_UNEXPLAINED = (
    "measure again with the plate and the sensors seated anew; if as much is left, with one more "
    "sensor beside the plate"
)
_REMEDY_DECLARATION = "correct the declaration that the warning names and diagnose again"
_REMEDY_GAPS = "measure again: samples of the record are missing, or its range was switched"
_REMEDIES_OF_WARNINGS = {
    "sensor-upside-down": _REMEDY_DECLARATION,
    "sensors-exchanged": _REMEDY_DECLARATION,
    "bedrock-elsewhere": _REMEDY_DECLARATION,
    "bedrock-contradicted": _REMEDY_DECLARATION,
    "load-steps": _REMEDY_GAPS,
    "sensor-steps": _REMEDY_GAPS,
}
"""Remedies by the code of the warning that calls for them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DropDiagnosis(StoredRecord):
    """Diagnosis of the point of a drop, as `pfwd invert --diagnose` reports it with the drop."""

    verdict: str | None = None
    """clean, explained or unexplained."""
    corrected: bool | None = None
    effects: tuple[EffectResult, ...] | None = None
    """Strongest first."""
    after: FittedState | None = None
