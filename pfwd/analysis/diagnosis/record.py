"""Results of diagnoses, with the keys of ``pfwd diagnose --json``, for ground and for test rigs."""

import math
from typing import Any

import numpy as np

from inversion import InversionError
from inversion.calibration import Rig, RigDrop, estimate_rig
from inversion.diagnosis.findings import PointDiagnosis, Verdict
from inversion.effects import BY_NAME
from inversion.notices import Notice, Value, text_notice, text_of
from pfwd.analysis.diagnosed_drop import DiagnosedDrop
from pfwd.analysis.diagnosis.entries import DiagnosisPoint
from pfwd.analysis.result_store import software_name
from pfwd.analysis.results import (
    DiagnosisResult,
    EffectParameter,
    EffectResult,
    FittedState,
)
from pfwd.analysis.screening.drops import NO_DROP, unbroken_part
from pfwd.files.traces import TracePoint
from pfwd.peaks.stiffness import stiffness_of
from pfwd_device import Drop
from pfwd_device.signals import remove_offset, velocity_of


def diagnosis_result(
    entry: DiagnosisPoint, diagnosis: PointDiagnosis | None, question: str | None = None
) -> DiagnosisResult:
    """Return the result for one point.

    Parameters
    ----------
    entry : DiagnosisPoint
    diagnosis : PointDiagnosis or None
        None: none of its drops was measured.
    question : str or None
        Identifier of the request; None: no drop was measured.
    """
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
    if diagnosis is None:
        false_trigger = EffectResult(name="false_trigger")
        is_false_trigger = any(
            isinstance(reason := drop.values["reason"], Notice) and reason.code in NO_DROP
            for drop in entry.rejected
        )
        return DiagnosisResult(
            file=entry.file,
            point=entry.point,
            device=entry.device,
            drops=(),
            rejected=tuple(map(text_of, entry.rejected)),
            **conditions,
            verdict="unexplained",
            corrected=False,
            effects=(false_trigger,) if is_false_trigger else (),
            warnings=(*entry.warnings, *entry.rejected, Notice("no-measured-drop")),
        )
    return DiagnosisResult(
        file=entry.file,
        point=entry.point,
        device=entry.device,
        drops=tuple(diagnosis.numbers),
        rejected=tuple(map(text_of, entry.rejected)),
        **conditions,
        verdict=diagnosis.verdict,
        corrected=diagnosis.corrected,
        noise_rms_m=diagnosis.noise_rms,
        before=diagnosis.before,
        effects=diagnosis.effects,
        after=diagnosis.after,
        held_out=diagnosis.held_out,
        elapsed_s=diagnosis.elapsed if math.isfinite(diagnosis.elapsed) else None,
        warnings=(*entry.warnings, *diagnosis.warnings, *_open_modulus_warning(diagnosis.after)),
        software=software_name(),
        question=question,
        basis=entry.basis,
        left_out=entry.left_out,
        fits=tuple(map(DiagnosedDrop.of, diagnosis.curves)),
        curves=diagnosis.curves,
    )


def _open_modulus_warning(after: FittedState) -> list[Notice]:
    """Return the warning that the data do not determine the modulus; empty: they do."""
    if after.modulus_interval_pa is None or not after.is_undetermined:
        return []
    low, high = after.modulus_interval_pa
    return [Notice("modulus-left-open", {"low_pa": low, "high_pa": high})]


MAX_RIG_RESIDUAL = 0.02
"""Largest residual, over the peak displacement, at which the model of the rig explains the record;
the same limit as for ground."""


def rig_result(entry: DiagnosisPoint, point: TracePoint) -> DiagnosisResult:
    """Return stiffness, moving mass and damping of a spring test rig; there is no modulus."""
    drops, rejected = _drops(point)
    if not drops:
        return _rig_result(entry, (), rejected, None, "no trace of a sensor in the centre")
    try:
        rig = estimate_rig(drops)
    except InversionError as err:
        return _rig_result(entry, (), rejected, None, str(err))
    numbers = tuple(
        drop.number for drop in point.drops if f"drop {drop.number}" in {d.name for d in drops}
    )
    return _rig_result(entry, numbers, rejected, (rig, _residual(rig, drops)), None)


def _drops(point: TracePoint) -> tuple[list[RigDrop], tuple[Notice, ...]]:
    rig_drops, rejected = [], []
    for drop in point.drops:
        name = f"drop {drop.number}"
        stiffness = stiffness_of(drop, point.setup)
        made = None if stiffness is None else rig_drop(drop, stiffness.secant_n_per_m, 0, name)
        if made is None:
            values: dict[str, Value] = {
                "drop": drop.number,
                "reason": Notice("no-centre-trace-of-drop"),
            }
            rejected.append(Notice("drop-rejected", values))
        else:
            rig_drops.append(made)
    # All drops of a rig have the same stiffness, from which the search starts.
    first = float(np.median([drop.stiffness for drop in rig_drops])) if rig_drops else 0.0
    same = [RigDrop(drop.time, drop.load, drop.velocity, first, 0, drop.name) for drop in rig_drops]
    return same, tuple(rejected)


def _residual(rig: Rig, drops: list[RigDrop]) -> float:
    """Return the root mean square residual of the displacement over its peak, over all drops."""
    parts = []
    for drop, residual in zip(drops, rig.residuals, strict=True):
        step = float(drop.time[1] - drop.time[0])
        moved, off = np.cumsum(drop.velocity) * step, np.cumsum(residual) * step
        parts.append(float(np.mean((off / np.abs(moved).max()) ** 2)))
    return float(np.sqrt(np.mean(parts)))


def _rig_result(
    entry: DiagnosisPoint,
    numbers: tuple[int, ...],
    rejected: tuple[Notice, ...],
    fit: tuple[Rig, float] | None,
    fault: str | None,
) -> DiagnosisResult:
    effects: tuple[EffectResult, ...] = ()
    after: FittedState | None = None
    verdict: Verdict = "unexplained"
    warnings = list(entry.warnings)
    if fit is None:
        warnings += [*rejected, Notice("no-measured-drop") if fault is None else text_notice(fault)]
    else:
        rig, residual = fit
        numbers_of = (
            ("stiffness", rig.stiffness, rig.deviation, "N/m"),
            ("moving_mass", rig.mass, math.nan, "kg"),
            ("damping_ratio", rig.damping_ratio, math.nan, "-"),
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
                advice=BY_NAME["spring_rig"].advice,
            ),
        )
        after = FittedState(model="rig", residual_rms_over_peak=residual)
        if residual <= MAX_RIG_RESIDUAL:
            verdict = "explained"
        else:
            warnings.append(Notice("rig-not-explained", {"residual_over_peak": residual}))
    return DiagnosisResult(
        file=entry.file,
        point=entry.point,
        device=entry.device,
        drops=numbers,
        rejected=tuple(map(text_of, rejected)),
        verdict=verdict,
        corrected=False,
        effects=effects,
        after=after,
        warnings=tuple(warnings),
    )


def rig_drop(drop: Drop, stiffness: float, rig: int, name: str) -> RigDrop | None:
    """Return a drop on a rig as input of its fit; None without complete traces of a centre sensor.

    Parameters
    ----------
    drop : Drop
    stiffness : float, N/m
        Declared stiffness of the rig.
    rig : int
        Index of the rig, if there are several.
    name : str
        Name of the drop in messages.
    """
    unbroken, reason, _ = unbroken_part(drop)
    channel = next(
        (candidate for candidate in unbroken.channels if abs(candidate.offset) < 1e-3), None
    )
    if reason is not None or channel is None:
        return None
    values = velocity_of(channel, unbroken.time)
    # Some devices store a last sample of 0, which is no measurement.
    load = remove_offset(unbroken.time, unbroken.load)[:-1]
    return RigDrop(unbroken.time[:-1], load, values[:-1], stiffness, rig, name)
