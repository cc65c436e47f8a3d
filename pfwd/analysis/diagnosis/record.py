"""Results of diagnoses, with the keys of ``pfwd diagnose --json``: on the ground and on a rig."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from inversion import InversionError
from inversion.calibration import Rig, RigDrop, describe
from inversion.diagnosis import PointDiagnosis
from inversion.effects import BY_NAME
from inversion.notices import Notice, Value, other
from inversion.records import known
from pfwd.analysis.diagnosis.entries import DiagnosisPoint
from pfwd.analysis.results import (
    DiagnosisResult,
    EffectParameter,
    EffectResult,
    FittedState,
)
from pfwd.analysis.screening.drops import whole_part
from pfwd.files.traces import TracePoint
from pfwd.peaks.stiffness import stiffness_of
from pfwd_device import Drop
from pfwd_device.signals import remove_offset

# How the screening says that nothing fell.
_NO_DROP = ("false trigger", "no pulse")


def diagnosis_result(entry: DiagnosisPoint, found: PointDiagnosis | None) -> DiagnosisResult:
    """Return the result of one point; the diagnosis is None where no drop of it was measured."""
    if entry.rig is not None:
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


def rig_drop(drop: Drop, stiffness: float, rig: int, name: str) -> RigDrop | None:
    """A drop on a rig; None without whole traces of a sensor in the centre.

    Parameters
    ----------
    drop : Drop
    stiffness : float, N/m
    rig : int
        Which rig it was.
    name : str
        For messages.
    """
    whole, reason, _ = whole_part(drop)
    channel = next((one for one in whole.channels if abs(one.offset) < 1e-3), None)
    if reason is not None or channel is None:
        return None
    values = remove_offset(whole.time, channel.values)
    if channel.quantity == "displacement":
        values = np.asarray(np.gradient(values, whole.time), np.float64)
    # Some devices store a last sample of 0, which is no measurement.
    load = remove_offset(whole.time, whole.load)[:-1]
    return RigDrop(whole.time[:-1], load, values[:-1], stiffness, rig, name)
