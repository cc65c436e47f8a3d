"""What is told of a point where the weight is known to have fallen on a rig of springs."""

import numpy as np

from inversion import InversionError
from inversion.calibration import Rig, RigDrop, describe
from inversion.effects import BY_NAME
from inversion.notices import Notice, Value, other
from pfwd.analysis.diagnosis.entries import DiagnosisPoint
from pfwd.analysis.diagnosis.result import (
    DiagnosisResult,
    EffectParameter,
    EffectResult,
    FittedState,
)
from pfwd.analysis.rig_drops import rig_drop
from pfwd.files.traces import TracePoint
from pfwd.peaks.stiffness import stiffness_of

ENOUGH = 0.02
"""Residual over the peak of the displacement up to which the rig is all there is: what the model
of the ground is granted too."""


def rig_result(entry: DiagnosisPoint, point: TracePoint) -> DiagnosisResult:
    """The rig behind a point: its stiffness, moving mass and damping; there is no modulus."""
    drops, rejected = _drops(point)
    if not drops:
        return _told(entry, (), rejected, None, "no trace of a sensor in the centre")
    try:
        rig = describe(drops)
    except InversionError as err:
        return _told(entry, (), rejected, None, str(err))
    numbers = tuple(
        drop.number for drop in point.drops if f"drop {drop.number}" in {d.name for d in drops}
    )
    return _told(entry, numbers, rejected, (rig, _residual(rig, drops)), None)


def _drops(point: TracePoint) -> tuple[list[RigDrop], tuple[Notice, ...]]:
    found, rejected = [], []
    for drop in point.drops:
        name = f"drop {drop.number}"
        shown = stiffness_of(drop, point.setup)
        made = None if shown is None else rig_drop(drop, shown.secant_n_per_m, 0, name)
        if made is None:
            values: dict[str, Value] = {
                "drop": drop.number,
                "reason": "no trace of a sensor in the centre",
            }
            rejected.append(Notice("drop-rejected", values))
        else:
            found.append(made)
    # One rig has one stiffness, which is where the search begins.
    first = float(np.median([drop.stiffness for drop in found])) if found else 0.0
    same = [RigDrop(drop.time, drop.load, drop.velocity, first, 0, drop.name) for drop in found]
    return same, tuple(rejected)


def _residual(rig: Rig, drops: list[RigDrop]) -> float:
    """Root mean square over the drops, in displacement over its peak."""
    parts = []
    for drop, left in zip(drops, rig.residuals, strict=True):
        step = float(drop.time[1] - drop.time[0])
        moved, off = np.cumsum(drop.velocity) * step, np.cumsum(left) * step
        parts.append(float(np.mean((off / np.abs(moved).max()) ** 2)))
    return float(np.sqrt(np.mean(parts)))


def _told(
    entry: DiagnosisPoint,
    numbers: tuple[int, ...],
    rejected: tuple[Notice, ...],
    found: tuple[Rig, float] | None,
    fault: str | None,
) -> DiagnosisResult:
    effects: tuple[EffectResult, ...] = ()
    after, verdict = None, "unexplained"
    warnings = list(entry.warnings)
    if found is None:
        warnings += [*rejected, Notice("no-measured-drop") if fault is None else other(fault)]
    else:
        rig, residual = found
        numbers_of = (
            ("stiffness", rig.stiffness, rig.deviation, "N/m"),
            ("moving_mass", rig.mass, None, "kg"),
            ("damping_ratio", rig.damping_ratio, None, "-"),
        )
        effects = (
            EffectResult(
                name="spring_rig",
                scope="point",
                value=rig.stiffness,
                sd=rig.deviation,
                unit="N/m",
                parameters=tuple(
                    EffectParameter(name=name, value=value, sd=sd, unit=unit)
                    for name, value, sd, unit in numbers_of
                ),
                alternatives=(),
                advice=BY_NAME["spring_rig"].advice,
            ),
        )
        after = FittedState(model="rig", residual_rms_over_peak=residual)
        if residual <= ENOUGH:
            verdict = "explained"
        else:
            warnings.append(Notice("rig-not-explained", {"residual_over_peak": residual}))
    return DiagnosisResult(
        file=entry.file,
        point=entry.point,
        device=entry.device,
        drops=numbers,
        rejected=tuple(map(str, rejected)),
        verdict=verdict,
        corrected=False,
        effects=effects,
        after=after,
        warnings=tuple(warnings),
    )
