"""What a measuring procedure has to know of a drop, from its record and its result."""

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfwd_device import Channel, Drop
from pfwd_device.drop import Peaks
from pfwd_device.response import correct_response
from pfwd_survey.files.header import PointSetup
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.inverting.screening.drops import CENTRE, Screening
from pfwd_survey.inverting.screening.missing import whole_part
from pfwd_survey.inverting.screening.signals import displacement_of, quiet_samples, remove_offset
from pfwd_survey.procedures import Kind, PointDrop

PULSE_EDGE = 0.03
"""Part of the peak load between which the pulse lies."""

PEAK_WITHIN = 2.0
"""Pulse durations after the start of the pulse within which the deflection has its peak: it lags
the load by a fraction of one. Later maxima are rebounds, or drift of an integrated velocity."""

END_PART = 0.05
"""Part of the record at its end, over which what is left of a deflection is averaged."""


def point_drop(
    drop: Drop,
    setup: PointSetup,
    screening: Screening,
    result: DropResult | None = None,
    discarded: str | None = None,
) -> PointDrop:
    """A drop as a procedure sees it.

    Parameters
    ----------
    drop : Drop
    setup : PointSetup
        Its declared geophone response is taken out of the peak: uncorrected, a geophone of 4.5 Hz
        lowers the peak of a 17 ms pulse by 18 %.
    screening : Screening
    result : DropResult, optional
    discarded : str, optional
        Why a person discarded it; "" without a reason, None: nobody did.

    Returns
    -------
    PointDrop
    """
    if drop.only_peaks is not None and not setup.is_stiffness_test:
        return _of_peaks(drop.number, drop.only_peaks, setup, discarded)
    if screening.status == "rejected":
        return PointDrop(drop.number, Kind.REJECTED, reason=screening.reason)
    kind = Kind.DISCARDED if discarded is not None else Kind(screening.status)
    whole = whole_part(drop)[0]
    load = remove_offset(whole.time, whole.load)
    start, end = _pulse(load)
    peak = float(load.max())
    area = float(np.trapezoid(load[start:end], whole.time[start:end]))
    duration = math.pi * area / (2 * peak) if peak > 0 else None
    facts: dict[str, Any] = {"peak_load": peak, "pulse_duration": duration}
    centre = [channel for channel in whole.channels if abs(channel.offset) < CENTRE]
    if centre and duration:
        facts |= _deflection(whole, centre[0], setup, start, duration)
    found = PointDrop(drop.number, kind, reason=discarded or None, **facts)
    return found if result is None else with_modulus(found, result)


def _of_peaks(number: int, peaks: Peaks, setup: PointSetup, discarded: str | None) -> PointDrop:
    """A drop without traces, which are rejected for the inversion alone."""
    kind = Kind.SEATING if number <= setup.seating_drops else Kind.MEASURED
    if discarded is not None:
        kind = Kind.DISCARDED
    centre = peaks.centre
    return PointDrop(
        number,
        kind,
        peak_load=peaks.load,
        peak_deflection=centre if centre is not None and centre > 0 else None,
        reason=discarded or None,
    )


def with_modulus(facts: PointDrop, result: DropResult) -> PointDrop:
    """The same drop with the modulus of a result, where that has one."""
    if result.modulus_pa is None:
        return facts
    return dataclasses.replace(
        facts, modulus=result.modulus_pa, modulus_interval=result.modulus_interval_pa
    )


def _pulse(load: NDArray[np.float64]) -> tuple[int, int]:
    """First sample of the pulse and the one past its last."""
    top = int(load.argmax())
    low = load < PULSE_EDGE * load[top]
    before, after = np.flatnonzero(low[:top]), np.flatnonzero(low[top:])
    start = int(before[-1]) + 1 if before.size else 0
    return start, top + int(after[0]) if after.size else load.size


def _deflection(
    drop: Drop, channel: Channel, setup: PointSetup, start: int, duration: float
) -> dict[str, float]:
    frequency, damping = setup.geophone_natural_frequency, setup.geophone_damping
    if channel.quantity == "velocity" and frequency is not None and damping is not None:
        velocity = remove_offset(drop.time, channel.values)
        velocity = correct_response(velocity, drop.sampling_rate, frequency, damping)
        steps = np.diff(drop.time) * (velocity[1:] + velocity[:-1]) / 2
        moved = np.concatenate([[0.0], np.cumsum(steps)])
    else:
        moved = displacement_of(channel, drop.time)
        velocity = np.gradient(moved, drop.time)
        if channel.quantity == "velocity":
            velocity = remove_offset(drop.time, channel.values)
    until = drop.time[start] + PEAK_WITHIN * duration
    part = slice(start, max(start + 2, int(np.searchsorted(drop.time, until))))
    peak = float((moved[part] - moved[start]).max())
    if peak <= 0:
        return {}
    facts = {"peak_deflection": peak, "peak_velocity": float(velocity[part].max())}
    if channel.quantity == "displacement":
        # Of an integrated velocity both would be the drift of the integration.
        quiet = quiet_samples(drop.time)
        if quiet:
            facts["offset_over_peak"] = abs(float(channel.values[:quiet].mean())) / peak
        last = max(1, int(END_PART * moved.size))
        facts["return_over_peak"] = abs(float(moved[-last:].mean())) / peak
    return facts
