"""Calibration of an instrument with drops on spring test rigs whose stiffness is declared."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Literal

import numpy as np

from inversion import InversionError, notices
from inversion.calibration import Calibration, calibrate
from inversion.notices import Notice
from pfwd.analysis.diagnosis.device_file import DeviceEffect, write_effects
from pfwd.analysis.diagnosis.record import rig_drop
from pfwd.errors import SurveyError, refusal
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from pfwd.peaks.stiffness import stiffness_of

GainOf = Literal["sensor", "load"]

SEVERAL_RIGS = 0.1
"""Relative difference of the measured stiffness between sites for which the same stiffness is
declared, above which they must be different rigs. Drops on one rig repeat within a few percent."""


@dataclass(frozen=True, eq=False)
class InstrumentCalibration:
    """Calibration of an instrument: gain, geophone response, delay, and their files."""

    files: tuple[str, ...]
    device: str | None
    gain_of: GainOf
    fit: Calibration
    stiffness: tuple[float, ...]
    """Stiffness of each rig, N/m."""
    reasons: tuple[str, ...]
    """Reasons why the drops do not agree on one calibration; empty: they agree."""
    warnings: tuple[Notice, ...]

    @property
    def gain(self) -> tuple[float, float, tuple[float, float]]:
        """Gain of the channel `gain_of`: value, standard deviation and 95 % interval."""
        gain = self.fit.of("gain")
        if self.gain_of == "sensor":
            return gain.value, gain.deviation, gain.interval
        low, high = gain.interval
        return 1 / gain.value, gain.deviation / gain.value**2, (1 / high, 1 / low)

    def to_json(self) -> Mapping[str, Any]:
        """Return the calibration as the JSON values that ``pfwd calibrate --json`` prints."""
        value, deviation, interval = self.gain
        entry: dict[str, Any] = {
            "files": list(self.files),
            "device": self.device,
            "drops": self.fit.drops,
            "repeats": not self.reasons,
            "reasons": list(self.reasons),
            "gain_of": self.gain_of,
            "gain": {"value": value, "sd": deviation, "interval": list(interval)},
        }
        for name, key in (
            ("natural_frequency", "natural_frequency_hz"),
            ("damping", "damping"),
            ("delay", "delay_s"),
        ):
            effect = self.fit.of(name)
            entry[key] = {
                "value": effect.value,
                "sd": effect.deviation,
                "interval": list(effect.interval),
            }
        rigs = zip(self.stiffness, self.fit.masses, self.fit.damping_ratios, strict=True)
        entry["rigs"] = [
            {"stiffness_n_per_m": k, "mass_kg": mass, "damping_ratio": ratio}
            for k, mass, ratio in rigs
        ]
        entry["misfit_over_peak"] = self.fit.misfit
        return entry | notices.to_json(self.warnings)


def calibrate_files(
    files: Sequence[str],
    stiffness: float | None = None,
    *,
    point: str | None = None,
    gain_of: GainOf = "sensor",
    header: str | None = None,
) -> InstrumentCalibration:
    """Estimate the calibration of an instrument from drops on spring test rigs.

    Parameters
    ----------
    files : sequence of str
    stiffness : float, N/m, optional
        Stiffness of the rig, the same for all files; None: as the files declare it.
    point : str, optional
        Only points whose names begin with this text are used.
    gain_of : "sensor" or "load"
        Channel whose gain is estimated; the gain of the other one is taken as 1.
    header : path of a TOML file, optional
        Declarations for all files.

    Raises
    ------
    SurveyError
        If a file is not valid, a stiffness is not declared, or there are too few drops.
    """
    points = [
        (file, traces)
        for file in files
        for traces in read_points(file, header)
        if point is None or str(traces.setup.point or "").startswith(point)
    ]
    if not points:
        got = "none" if point is None else f"none whose name begins with {point}"
        raise SurveyError(refusal(", ".join(files), "points on a rig", got))
    per_point = [_stiffness(file, traces, stiffness) for file, traces in points]
    rigs = sorted(set(per_point))
    drops, warnings = [], []
    for (file, traces), value in zip(points, per_point, strict=True):
        for drop in traces.drops:
            name = f"{traces.setup.point or os.path.basename(file)}, drop {drop.number}"
            made = rig_drop(drop, value, rigs.index(value), name)
            if made is None:
                warnings.append(Notice("no-centre-trace", {"drop": name}))
            else:
                drops.append(made)
    devices = {str(traces.setup.device) for _, traces in points if traces.setup.device is not None}
    if len(devices) > 1:
        got = f"of {', '.join(sorted(devices))}"
        raise SurveyError(refusal(", ".join(files), "files of one device", got))
    try:
        result = calibrate(drops)
    except InversionError as err:
        raise SurveyError(f"{', '.join(files)}: {err}") from err
    groups = [
        (value, traces)
        for value, (_, traces) in zip(per_point, points, strict=True)
        if traces.drops
    ]
    return InstrumentCalibration(
        tuple(files),
        devices.pop() if devices else None,
        gain_of,
        result,
        tuple(rigs),
        (*_several_rigs(groups), *result.reasons),
        tuple(warnings),
    )


def write_calibration(path: str | os.PathLike[str], calibration: InstrumentCalibration) -> None:
    """Write the calibration to a file for the option ``--device``.

    Raises
    ------
    SurveyError
        If the drops do not agree on one calibration.
    OSError
        If the file cannot be written.
    """
    if calibration.reasons:
        got = f"drops that do not repeat: {'; '.join(calibration.reasons)}"
        raise SurveyError(refusal(os.fspath(path), "drops that agree on a calibration", got))
    value, deviation, _ = calibration.gain
    frequency, damping, delay = (
        calibration.fit.of(name) for name in ("natural_frequency", "damping", "delay")
    )
    count = calibration.fit.drops
    effects = [
        DeviceEffect(f"{calibration.gain_of}_gain", count, [("factor", "-", value, deviation)]),
        DeviceEffect(
            "geophone_response",
            count,
            [
                ("natural_frequency", "Hz", frequency.value, frequency.deviation),
                ("damping", "-", damping.value, damping.deviation),
            ],
        ),
        DeviceEffect("sensor_lag", count, [("delay", "s", delay.value, delay.deviation)]),
    ]
    write_effects(path, calibration.device, effects)


def _stiffness(file: str, point: TracePoint, declared: float | None) -> float:
    value = point.setup.rig_stiffness if declared is None else declared
    if value is None or not value > 0:
        where = f"{file}, point {point.setup.point}" if point.setup.point else file
        hint = "give --stiffness N/m, or declare stiffness_n_per_m"
        raise SurveyError(refusal(where, "the stiffness of the rig", "none", hint))
    return float(value)


def _several_rigs(groups: Sequence[tuple[float, TracePoint]]) -> list[str]:
    """Return a sentence for each declared stiffness that differs between sites as measured."""
    messages = []
    ordered = sorted(groups, key=lambda one: (one[0], str(one[1].setup.site)))
    for stiffness_of_rig, of_rig in groupby(ordered, key=lambda one: one[0]):
        median_by_site: dict[str, float] = {}
        for site, some in groupby(of_rig, key=lambda one: str(one[1].setup.site)):
            values = [
                one.secant_n_per_m
                for _, point in some
                for drop in point.drops
                if (one := stiffness_of(drop, point.setup)) is not None
            ]
            if values:
                median_by_site[site] = float(np.median(values))
        if median_by_site and max(median_by_site.values()) > (1 + SEVERAL_RIGS) * min(
            median_by_site.values()
        ):
            listed = ", ".join(
                f"{value / 1e6:.3g} MN/m on {site}" for site, value in median_by_site.items()
            )
            messages.append(
                f"one stiffness of {stiffness_of_rig / 1e6:.3g} MN/m is declared, at the peaks "
                f"there is {listed}: several rigs, choose the points of one with --point"
            )
    return messages
