"""Screening of drops: rejection of records that are no valid drop, and warnings about the others.

A rejected drop is a normal outcome and no error. The limits were set on raw and processed records
of portable and heavy devices and on computed drops: no genuine drop among them is rejected, and
every rebound and false trigger is.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from inversion.notices import Notice, Value
from pfwd.analysis.screening.centre_sensor import Response, centre_sensor_fault
from pfwd.files.header import PointSetup
from pfwd.files.plausible_units import SUSPECT_DEFLECTION, SUSPECT_LOAD
from pfwd.files.traces import TracePoint
from pfwd_device import Channel, Drop
from pfwd_device.signals import channels_outward as channels_outward
from pfwd_device.signals import displacement_of as displacement_of
from pfwd_device.signals import quiet_samples
from pfwd_device.signals import remove_offset as remove_offset

NEEDED_BEFORE = 0.003
"""Time before the trigger, s, in which no sample may be missing: the pulse begins before the
trigger, and the offset is estimated from the samples before the pulse."""

NEEDED_AFTER = 0.050
"""Time after the trigger, s, in which no sample may be missing: the longest pulses take 30 ms, and
the response of the ground to them is most of what the fit uses."""


def unbroken_part(drop: Drop) -> tuple[Drop, Notice | None, Notice | None]:
    """Return the part of a drop around its trigger in which no sample is missing.

    Parameters
    ----------
    drop : Drop
        NaN where samples are missing.

    Returns
    -------
    drop : Drop
        The part without missing samples if it is long enough, otherwise the whole drop.
    reason : Notice or None
        Reason why the drop cannot be used; None: it can.
    warning : Notice or None
        Warning about the part that was cut off.
    """
    if drop.only_peaks is not None:
        return drop, Notice("peaks-only"), None
    values = np.array([drop.load, *(channel.values for channel in drop.channels)])
    missing: NDArray[np.bool_] = np.isnan(values).max(axis=0)
    if not missing.any():
        return drop, None, None
    count = int(missing.sum())
    first_missing = float(drop.time[int(np.argmax(missing))])
    trigger = int(np.argmin(np.abs(drop.time)))
    before = np.flatnonzero(missing[: trigger + 1])
    after = np.flatnonzero(missing[trigger:])
    start = int(before[-1]) + 1 if before.size else 0
    end = trigger + int(after[0]) if after.size else missing.size
    step = 1.0 / drop.sampling_rate
    # A record that is short because of its settings is not damaged.
    first = max(-NEEDED_BEFORE, drop.time[0]) + step / 2
    last = min(NEEDED_AFTER, drop.time[-1]) - step / 2
    numbers = {"missing": count, "samples": missing.size, "first_missing_s": first_missing}
    if end <= start or drop.time[start] > first or drop.time[end - 1] < last:
        return drop, Notice("record-damaged", numbers), None
    part = slice(start, end)
    part_drop = Drop(
        drop.number,
        drop.time[part],
        drop.load[part],
        tuple(dataclasses.replace(c, values=c.values[part]) for c in drop.channels),
    )
    return part_drop, None, Notice("drop-incomplete", numbers)


MIN_CLIPPED_SAMPLES = 3
"""Smallest number of equal samples at a peak that count as clipped; two may be equal by chance."""

STEEP_FLANK = 10.0
"""Smallest fall beside a clipped top, in steps of the quantisation. A parabola that rounding makes
flat over n samples falls by at most 6.5 steps within n/2 samples beside the flat part (at n = 4). A
clipped one meets its level at an angle and falls by more, unless hardly more than a step was
clipped."""


def clipped_samples(values: NDArray[np.float64]) -> int:
    """Return the number of samples in the longest clipped top of a trace; 0: no top is clipped.

    A flat stretch at either end of the trace does not count: a sensor may be at rest there.

    Parameters
    ----------
    values : (n,) ndarray of float

    Returns
    -------
    int

    Examples
    --------
    >>> pulse = np.sin(np.linspace(0, np.pi, 100))
    >>> [clipped_samples(values) for values in (pulse, pulse.round(2), pulse.clip(max=0.9))]
    [0, 0, 28]
    """
    start, end = _longest_flat_top(values)
    length = end - start
    if length < MIN_CLIPPED_SAMPLES:
        return 0
    reach = min(length // 2, start, values.size - end)
    foot = max(values[start - reach : start].min(), values[end : end + reach].min())
    fall = values[start] - foot
    levels = np.unique(values[max(0, start - 2 * length) : end + 2 * length])
    step = float(np.diff(levels).min())
    return length if fall > STEEP_FLANK * step else 0


def _longest_flat_top(values: NDArray[np.float64]) -> tuple[int, int]:
    """Return the first index of the longest run of the largest value, and the index after its last.

    Runs at the ends of the record are ignored; (0, 0): there is no other.
    """
    at_top = np.concatenate([[False], values == values.max(), [False]])
    edges = np.flatnonzero(np.diff(at_top.astype(np.int8)))
    starts, ends = edges[::2], edges[1::2]
    inside = (starts > 0) & (ends < values.size)
    if not inside.any():
        return 0, 0
    starts, ends = starts[inside], ends[inside]
    longest = int(np.argmax(ends - starts))
    return int(starts[longest]), int(ends[longest])


DropStatus = Literal["measured", "seating", "rejected"]

NO_PULSE_LOAD = 100.0
"""Change of the load, N, below which there is no pulse; a hand on the guide rod causes more. A load
channel in kN stays below it, and is reported as such."""

NO_PULSE_OVER_NOISE = 6.0
"""Change of the load, over its noise, below which there is no pulse; pure noise without spikes
changes by 4 to 5."""

FALSE_TRIGGER_LOAD = 1500.0
"""Peak load, N, below which a record is a false trigger: rebounds and knocks peak at 0.3 to 1.2 kN,
drops from a low height begin at 3 kN, and light deflectometers are made for 7 kN and more."""

SHORTEST_PULSE = 2e-3
"""Duration above half of the peak, s, below which a record is a false trigger: a weight on a spring
takes 5 to 15 ms, a hammer on steel or an electric spike less than this."""

SHORT_PULSE = 7.5e-3
SMALL_PLATE = 0.1
"""Duration of the half-sine with the same peak and impulse, s, below which the time axis is
suspect, for plates of at least this radius, m. Portable and heavy devices load such plates for 10.9
to 29 ms, light hammers on stiff springs for 8 ms."""

SECOND_PULSE = 0.5
PULSE_GAP = 0.25
"""A record has two pulses if the load falls below this fraction of the peak and then rises again
above `SECOND_PULSE`. Such a record is no drop: to return with half the force the weight has to
bounce off with half its speed, and is then in the air for 0.2 s or more, longer than a record.
Second contacts stay below a tenth of the peak."""

PULSE_EDGE = 0.1
"""Fraction of the peak to which the load has to fall within the record; at most 0.3 % of the
impulse is then missing."""

PULSE_START = 0.2
"""Largest fraction of the peak at which the record may begin, for devices that store nothing before
their trigger level; at most 1 % of the impulse is then missing."""

MIN_REVERSED_LOAD = 2.0
"""Ratio of upward to downward load from which the polarity is wrong; no load swings back so far."""

DEAD_OVER_NOISE = 2.0
"""A channel is dead if its root mean square is less than this multiple of its noise before the
trigger."""

DEAD_DEFLECTION = 1e-7
"""Deflection, m, below which the centre sensor is dead: even on sound rock (50 GPa) a plate under
1.5 kN moves this much."""

MIN_QUIET_SAMPLES = 8
"""Smallest number of samples before the pulse from which a noise level is estimated."""

CENTRE = 1e-3
"""Distance from the plate centre, m, below which a sensor is the centre sensor."""

CLIPPING_SCATTER = 0.01
"""Fraction by which the level of clipping may differ between drops, because their offsets were
subtracted."""

REBOUND_OVER_LARGEST = 0.2
"""Peak load, over the largest of the point, below which a drop is a rebound or a knock. The lowest
of several drop heights gives a quarter or more, rebounds and false triggers a seventh or less."""

PARTIAL_OVER_LARGEST = 0.7
"""Peak load, over the largest of the point, below which a drop from another height is reported;
drops from one height repeat within a quarter."""


NO_DROP = frozenset(
    {
        *("no-pulse", "no-pulse-in-newton", "load-too-small", "several-pulses", "pulse-too-short"),
        "rebound",
    }
)
"""Codes of the reasons that nothing fell, or that it was a rebound or a knock."""


@dataclass(frozen=True, slots=True)
class Screening:
    """Result of the screening of a drop's record."""

    status: DropStatus
    """Kind of the drop at its point: measured, seating or rejected."""
    reason: Notice | None = None
    """Reason why it was rejected; None: it was not."""
    warnings: tuple[Notice, ...] = ()
    """Warnings about a drop that was not rejected."""
    left_out: tuple[float, ...] = ()
    """Offsets, m, of the sensors beside the centre that are excluded from the fit, because they
    measured nothing or are faulty."""
    clipped: bool = False
    """True if a fitted channel has flat tops, where the true values were larger."""


@dataclass(frozen=True, slots=True)
class _Pulse:
    """Load pulse of a record."""

    load: NDArray[np.float64]
    """Load without offset, single-sample spikes and last sample, (n - 1,), N."""
    noise: float
    """Root mean square of the load's noise, N; 0 when it cannot be estimated."""
    top: int
    """Index of the peak."""
    start: int
    """Index of the first sample of the pulse: from there to the peak the load stays above
    `PULSE_EDGE` of the peak."""
    end: int
    """Index after the last sample of the pulse, for which the same holds after the peak."""

    @property
    def peak(self) -> float:
        """Largest downward load, N."""
        return float(self.load[self.top])


def screen(drop: Drop, setup: PointSetup) -> Screening:
    """Screen a drop by its own record: measured, seating, or rejected with a reason.

    Parameters
    ----------
    drop : Drop
    setup : PointSetup
        Declares the number of seating drops.

    Returns
    -------
    Screening
    """
    if setup.is_stiffness_test:
        return Screening("rejected", Notice("stiffness-test"))
    drop, reason, incomplete = unbroken_part(drop)
    if reason:
        return Screening("rejected", reason)
    pulse = _find_pulse(drop)
    reason = (
        _load_fault(pulse, drop)
        or _centre_fault(pulse, drop)
        or _centre_motion_fault(pulse, drop, setup)
    )
    if reason:
        return Screening("rejected", reason)
    status: DropStatus = "seating" if drop.number <= setup.seating_drops else "measured"
    dead = tuple(channel.offset for channel in drop.channels if _dead_extra(channel, pulse, drop))
    warnings = [incomplete] if incomplete else []
    clipped = [warning for warning, _, _ in _clipped_channels(drop, dead)]
    all_warnings = (*warnings, *clipped, *_warnings(pulse, drop, setup))
    return Screening(status, None, all_warnings, dead, clipped=bool(clipped))


def screen_point(point: TracePoint) -> tuple[Screening, ...]:
    """Screen every drop of a point by its record and by comparison with the other drops.

    A drop with a small fraction of the largest load is a rebound or a false trigger; one with a
    larger fraction fell from another height, which is reported.

    Parameters
    ----------
    point : TracePoint

    Returns
    -------
    tuple of Screening
        In the order of the drops.
    """
    screenings = [screen(drop, point.setup) for drop in point.drops]
    screenings = _without_refuted_clipping(point.drops, screenings)
    peaks = [
        0.0 if screening.status == "rejected" else pulse_peak(drop)
        for drop, screening in zip(point.drops, screenings, strict=True)
    ]
    largest = max(peaks, default=0.0)
    compared = [
        compare(screening, peak, largest) for screening, peak in zip(screenings, peaks, strict=True)
    ]
    marked, rejected = [], 0
    for drop, screening in zip(point.drops, compared, strict=True):
        marked.append(counted(screening, drop.number, rejected, point.setup))
        rejected += screening.status == "rejected"
    return tuple(marked)


def counted(screening: Screening, number: int, rejected: int, setup: PointSetup) -> Screening:
    """Return a screening with its drop counted as seating or measured, as the procedure requires.

    A rejected drop does not load the ground as a drop does, and hence does not seat the plate.
    Without a procedure the number of the drop alone decides, as in trace files.

    Parameters
    ----------
    screening : Screening
    number : int
        Number of the drop at its point.
    rejected : int
        Number of drops before it at the point that were rejected.
    setup : PointSetup
    """
    if setup.procedure is None or screening.status == "rejected":
        return screening
    seating = number - rejected <= setup.seating_drops
    return dataclasses.replace(screening, status="seating" if seating else "measured")


def pulse_peak(drop: Drop) -> float:
    """Return the peak load without single-sample spikes, N, for comparing drops."""
    return _find_pulse(unbroken_part(drop)[0]).peak


def rebound_reason(peak: float, largest: float) -> Notice | None:
    """Return the reason why a drop is a rebound or a knock, compared with its point.

    The result is None if the drop is accepted.

    Parameters
    ----------
    peak, largest : float, N
        `pulse_peak` of the drop, and the largest one of the point.
    """
    if peak >= REBOUND_OVER_LARGEST * largest:
        return None
    return Notice("rebound", _compared(peak, largest))


def _compared(peak: float, largest: float) -> dict[str, Value]:
    return {"peak_load_n": peak, "share": peak / largest, "largest_load_n": largest}


def compare(screening: Screening, peak: float, largest: float) -> Screening:
    """Return the screening of a drop after the comparison with the other drops of its point.

    Parameters
    ----------
    screening : Screening
        Screening by its record alone.
    peak, largest : float, N
        `pulse_peak` of the drop, and the largest one of the point, this drop included.
    """
    if screening.status == "rejected":
        return screening
    reason = rebound_reason(peak, largest)
    if reason is not None:
        return Screening("rejected", reason)
    if peak < PARTIAL_OVER_LARGEST * largest:
        warning = Notice("partial-drop", _compared(peak, largest))
        return dataclasses.replace(screening, warnings=(*screening.warnings, warning))
    return screening


def _find_pulse(drop: Drop) -> _Pulse:
    # Some devices store a last sample of 0, which is no measurement.
    load = _without_spikes(remove_offset(drop.time, drop.load)[:-1])
    quiet = quiet_samples(drop.time)
    # Estimated from differences, which a slow drift or the beginning of the pulse hardly changes.
    noise = float(np.diff(drop.load[:quiet]).std()) / np.sqrt(2) if quiet > 1 else 0.0
    top = int(np.argmax(load))
    low = load < PULSE_EDGE * load[top]
    before = np.flatnonzero(low[:top])
    after = np.flatnonzero(low[top:])
    start = int(before[-1]) + 1 if before.size else 0
    end = top + int(after[0]) if after.size else load.size
    return _Pulse(load, noise, top, start, end)


def _without_spikes(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the running median of three samples."""
    padded = np.pad(values, 1, mode="edge")
    return np.median([padded[:-2], padded[1:-1], padded[2:]], axis=0)


def _load_fault(pulse: _Pulse, drop: Drop) -> Notice | None:
    """Return the reason why the load is not that of a drop; None: it is."""
    change = float(np.ptp(pulse.load))
    if change < max(NO_PULSE_LOAD, NO_PULSE_OVER_NOISE * pulse.noise):
        may_be_kilonewton = 1.0 < change < NO_PULSE_LOAD
        code = "no-pulse-in-newton" if may_be_kilonewton else "no-pulse"
        return Notice(code, {"change_n": change})
    upward = float(-pulse.load.min())
    excursion = max(pulse.peak, upward)
    if excursion < FALSE_TRIGGER_LOAD:
        loads = {"peak_load_n": excursion, "least_n": FALSE_TRIGGER_LOAD}
        return Notice("load-too-small", loads)
    late = _late_start(pulse, drop, excursion)
    if late:  # tested first: with an offset from within the pulse the later load seems upward
        return late
    if upward > MIN_REVERSED_LOAD * pulse.peak:
        return Notice("load-upward", {"upward_n": upward})
    pulses = _count_pulses(pulse)
    if pulses > 1:
        return Notice("several-pulses", {"pulses": pulses})
    if pulse.end == pulse.load.size:
        remaining = float(pulse.load[-1]) / pulse.peak
        return Notice("pulse-end-missing", {"share": remaining})
    return _too_short(pulse, drop)


def _late_start(pulse: _Pulse, drop: Drop, excursion: float) -> Notice | None:
    """Return the reason why the record lacks the start of the pulse; None: it has it.

    ``excursion`` is the largest absolute load, N.
    """
    quiet = max(quiet_samples(drop.time), 1)
    last = max(pulse.load.size // 10, 1)
    # If the samples before the trigger hold part of the pulse, the subtracted offset is wrong: then
    # the load changes among them, or ends below zero.
    begins = max(
        float(np.ptp(pulse.load[:quiet])),
        float(pulse.load[0]),
        -float(np.median(pulse.load[-last:])),
    )
    if begins > PULSE_START * excursion:
        return Notice("pulse-start-missing", {"share": begins / excursion})
    return None


def _count_pulses(pulse: _Pulse) -> int:
    """Return how often the load exceeds `SECOND_PULSE` after it was below `PULSE_GAP`."""
    high = pulse.load > SECOND_PULSE * pulse.peak
    low = pulse.load < PULSE_GAP * pulse.peak
    decided = high[high | low]  # samples between the two levels are ignored
    return int(np.count_nonzero(decided[1:] & ~decided[:-1])) + int(decided[0])


def _too_short(pulse: _Pulse, drop: Drop) -> Notice | None:
    above = pulse.load[pulse.start : pulse.end] > pulse.peak / 2
    duration = float(np.count_nonzero(above)) / drop.sampling_rate
    if duration < SHORTEST_PULSE:
        return Notice("pulse-too-short", {"duration_s": duration})
    return None


def _centre_fault(pulse: _Pulse, drop: Drop) -> Notice | None:
    """Return the reason why the centre deflection cannot be used; None: it can."""
    centre = [channel for channel in drop.channels if _is_centre(channel)]
    if not centre:
        return Notice("no-centre-channel")
    for channel in centre:
        fault = _silent(channel, drop, pulse.start, pulse.end)
        if fault:
            return Notice("centre-dead", {"fault": fault})
        deflection = float(np.abs(displacement_of(channel, drop.time)[: pulse.end]).max())
        if deflection < DEAD_DEFLECTION:
            fault = Notice("motion-too-small", {"deflection_m": deflection})
            return Notice("centre-dead", {"fault": fault})
    return None


def _centre_motion_fault(pulse: _Pulse, drop: Drop, setup: PointSetup) -> Notice | None:
    """Return the reason why the motion of the centre sensor is not that of the plate.

    The result is None if the motion is that of the plate.
    """
    frequency, damping = setup.geophone_natural_frequency, setup.geophone_damping
    response = None
    if frequency is not None and damping is not None:
        response = Response(frequency, damping)
    # Some devices store a last sample of 0, which is no measurement.
    time = drop.time[:-1]
    outward = channels_outward(drop)
    neighbours = [
        displacement_of(channel, drop.time)[:-1] for channel in outward if not _is_centre(channel)
    ][:2]
    for channel in outward:
        if _is_centre(channel):
            centre = displacement_of(channel, drop.time)[:-1]
            fault = centre_sensor_fault(time, pulse.load, centre, neighbours, response)
            if fault:
                return Notice("centre-not-credible", {"fault": fault})
    return None


def _is_centre(channel: Channel) -> bool:
    return abs(channel.offset) < CENTRE


def _silent(channel: Channel, drop: Drop, start: int, end: int) -> Notice | None:
    """Return the reason why a channel measured nothing between two samples; None: it measured."""
    part = channel.values[start:end]
    if np.ptp(part) == 0:
        return Notice("constant", {"value": float(part[0])})
    quiet = quiet_samples(drop.time)
    if quiet < MIN_QUIET_SAMPLES:
        return None
    signal = remove_offset(drop.time, channel.values)
    noise = float(np.sqrt(np.mean(signal[:quiet] ** 2)))
    if np.sqrt(np.mean(signal[start:end] ** 2)) < DEAD_OVER_NOISE * noise:
        return Notice("only-noise")
    return None


def _clipped_channels(drop: Drop, dead: Sequence[float]) -> list[tuple[Notice, str, float]]:
    """Return warning, name and signed level of each channel that ends in a flat top."""
    clipped = []
    load = drop.load[:-1]
    count = clipped_samples(load)
    if count:
        warning = Notice("load-clipped", {"samples": count})
        clipped.append((warning, "load", float(load.max())))
    for channel in drop.channels:
        values = channel.values[:-1]
        above, below = clipped_samples(values), clipped_samples(-values)
        if above + below and channel.offset not in dead:
            name = f"{channel.quantity} at {channel.offset:g} m"
            warning = Notice("sensor-clipped", {**_channel(channel), "samples": above + below})
            clipped.append((warning, name, float(values.max() if above else values.min())))
    return clipped


def _without_refuted_clipping(
    drops: Sequence[Drop], screenings: Sequence[Screening]
) -> list[Screening]:
    """Return the screenings without warnings of clipping that another drop of the point disproves.

    The level at which a channel is clipped is a property of the device: a channel that exceeds it
    in another drop was not clipped there.
    """
    recorded = [drop for drop in drops if drop.only_peaks is None]
    result = []
    for drop, screening in zip(drops, screenings, strict=True):
        if screening.clipped:
            channels = _clipped_channels(unbroken_part(drop)[0], screening.left_out)
            refuted = {
                warning
                for warning, name, level in channels
                if any(
                    _exceeds(neighbour, name, level)
                    for neighbour in recorded
                    if neighbour is not drop
                )
            }
            screening = dataclasses.replace(
                screening,
                warnings=tuple(w for w in screening.warnings if w not in refuted),
                clipped=len(refuted) < len(channels),
            )
        result.append(screening)
    return result


def _exceeds(drop: Drop, name: str, level: float) -> bool:
    """Return whether a channel of a drop exceeds a level, which has the sign of the excursion."""
    recorded = {"load": drop.load}
    recorded |= {f"{c.quantity} at {c.offset:g} m": c.values for c in drop.channels}
    if name not in recorded:
        return False
    signed = np.sign(level) * recorded[name]
    return bool(np.nanmax(signed) > (1.0 + CLIPPING_SCATTER) * abs(level))


def _warnings(pulse: _Pulse, drop: Drop, setup: PointSetup) -> list[Notice]:
    warnings = []
    impulse = float(pulse.load[pulse.start : pulse.end].sum()) / drop.sampling_rate
    duration = np.pi / 2 * impulse / pulse.peak
    if duration < SHORT_PULSE and setup.plate_radius >= SMALL_PLATE:
        values = {"pulse_duration_s": float(duration), "plate_radius_m": setup.plate_radius}
        warnings.append(Notice("time-axis-suspect", values))
    if pulse.peak > SUSPECT_LOAD:
        warnings.append(Notice("load-suspect", {"peak_load_n": pulse.peak}))
    for channel in drop.channels:
        warnings += _channel_warnings(channel, pulse, drop)
    return warnings


def _channel_warnings(channel: Channel, pulse: _Pulse, drop: Drop) -> list[Notice]:
    fault = _dead_extra(channel, pulse, drop)
    if fault:
        return [Notice("sensor-dead", {**_channel(channel), "fault": fault})]
    warnings = []
    moved = displacement_of(channel, drop.time)[: pulse.end]
    deflection = float(np.abs(moved).max())
    if deflection > SUSPECT_DEFLECTION:
        unit = channel.quantity.unit
        values = {**_channel(channel), "deflection_m": deflection, "unit": unit}
        warnings.append(Notice("deflection-suspect", values))
    if _is_centre(channel) and moved[pulse.start :].mean() < 0:
        warnings.append(Notice("polarity-suspect", _channel(channel)))
    return warnings


def _channel(channel: Channel) -> dict[str, Value]:
    """Return quantity and offset of a sensor as values of a warning."""
    return {"quantity": channel.quantity.value, "offset_m": channel.offset}


def _dead_extra(channel: Channel, pulse: _Pulse, drop: Drop) -> Notice | None:
    """Return the reason why a sensor beside the centre measured nothing; None: it measured."""
    if _is_centre(channel):
        return None
    # The wave may reach a distant sensor after the end of the load.
    return _silent(channel, drop, pulse.start, pulse.load.size)


def duplicate_drops(drops: Sequence[Drop], screenings: Sequence[Screening]) -> dict[int, Notice]:
    """Return the measured drops that have the same samples as an earlier one, with the reason.

    A copy is no second measurement: counted as one, it would make intervals too narrow.

    Parameters
    ----------
    drops : sequence of Drop
    screenings : sequence of Screening
        One for each drop.

    Returns
    -------
    dict of int to Notice
        Reason by the index of the drop.
    """
    reasons: dict[int, Notice] = {}
    originals: list[Drop] = []
    for index, (drop, screening) in enumerate(zip(drops, screenings, strict=True)):
        if screening.status != "measured":
            continue
        original = next((earlier for earlier in originals if earlier.has_samples_of(drop)), None)
        if original is None:
            originals.append(drop)
        else:
            reasons[index] = Notice("samples-copied", {"drop": original.number})
    return reasons
