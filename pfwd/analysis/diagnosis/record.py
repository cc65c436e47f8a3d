"""The result of a diagnosis as it is told, with the keys of ``pfwd diagnose --json``."""

import math
from collections.abc import Sequence
from typing import Any

from inversion.diagnosis import PointDiagnosis
from inversion.diagnosis.findings import EffectResult, FittedState
from inversion.notices import Notice
from inversion.records import known
from pfwd.analysis.diagnosis.entries import DiagnosisPoint
from pfwd.analysis.diagnosis.result import DiagnosisResult

# How the screening says that nothing fell.
_NO_DROP = ("false trigger", "no pulse")


def diagnosis_result(entry: DiagnosisPoint, found: PointDiagnosis | None) -> DiagnosisResult:
    """What is told of one point; `found` is None where no drop of it was measured."""
    if entry.rig is not None:
        # Loaded here: on the ground nobody needs it.
        from pfwd.analysis.diagnosis.rig import rig_result

        return rig_result(entry, entry.rig)
    conditions: dict[str, Any] = {}
    if entry.records is not None:
        first = entry.records.records[0]
        conditions = {
            "plate": "rigid-rough",
            "plate_radius_m": first.instrument.plate_radius,
            "poisson_ratio": first.poisson_ratio,
        }
    if found is None:
        return DiagnosisResult(
            file=entry.file,
            point=entry.point,
            device=entry.device,
            drops=(),
            rejected=tuple(map(str, entry.rejected)),
            **conditions,
            verdict="unexplained",
            corrected=False,
            effects=(_false_trigger(),) if _nothing_fell(entry.rejected) else (),
            warnings=(*entry.warnings, *entry.rejected, Notice("no-measured-drop")),
        )
    return DiagnosisResult(
        file=entry.file,
        point=entry.point,
        device=entry.device,
        drops=tuple(found.numbers),
        rejected=tuple(map(str, entry.rejected)),
        **conditions,
        verdict=found.verdict,
        corrected=found.corrected,
        noise_rms_m=found.noise_rms,
        before=found.before,
        effects=found.effects,
        after=found.after,
        held_out=found.held_out,
        elapsed_s=found.elapsed if math.isfinite(found.elapsed) else None,
        warnings=(*entry.warnings, *found.warnings, *_left_open(found.after)),
    )


def _left_open(after: FittedState) -> list[Notice]:
    """Return the warning that there is ground and no modulus."""
    if not after.left_open:
        return []
    low, high = known(after.modulus_interval_pa)
    return [Notice("modulus-left-open", {"low_pa": low, "high_pa": high})]


def _nothing_fell(rejected: Sequence[Notice]) -> bool:
    """Return whether the screening rejected a record because nothing fell."""
    return any(str(drop.values["reason"]).startswith(_NO_DROP) for drop in rejected)


def _false_trigger() -> EffectResult:
    return EffectResult(name="false_trigger", unit="-", parameters=(), alternatives=())
