"""Preparation of a recorded drop for the fit: baseline, integration, noise, contact, window."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from inversion.arrays import FloatArray
from inversion.errors import RecordError
from inversion.forward.model import Instrument
from pfwd_plugins.quantities import Measurand, motion

CALIBRATED_ERROR = 0.028
"""Relative error (95 %) of a modulus due to the instrument, where a calibration is recorded: gains
of load cell and sensors, each of the 2 % that ASTM D4694 allows."""
UNCALIBRATED_ERROR = 0.055
"""The same where none is recorded, which includes tilt, clock and linearity."""

# The load has ended when it has fallen to this fraction of its peak.
CONTACT_END_FRACTION = 0.03
# A later load above this fraction of the peak is a second contact and ends the usable window.
_SECOND_CONTACT_FRACTION = 0.08
# The pulse starts where the load last passed this fraction of the peak before it.
_ONSET_FRACTION = 0.01
_MARGIN_BEFORE_ONSET_S = 1.0e-3
# A channel moves if it exceeds this number of standard deviations of its baseline, and this
# fraction of its largest value, for at least this number of samples; fewer are a spike.
_MIN_MOTION_DEVIATIONS, _MIN_MOTION_OVER_PEAK, _MIN_MOVING_SAMPLES = 8.0, 0.01, 3
# Trailing samples in which every channel is constant are padding of the recorder, if there are at
# least this number of them, after a last step of more than this multiple of the smallest step.
_MIN_PADDING_SAMPLES, _MAX_QUANTA_AT_REST = 5, 3.0
_MIN_BASELINE_SAMPLES = 8
# The zero of a displacement channel is its mean over this time before the start.
_ZERO_S = 2.0e-3
# Sensors on two sides whose distances differ by less than this count as at one distance. Positions
# are given to the millimetre; at 2 radii of a plate of 0.15 m a deflection changes by 0.4 % in
# 1 mm.
MAX_SIDE_DIFFERENCE_M = 1.0e-3
# A sensor rises if its largest downward motion is less than this fraction of its largest motion.
_MIN_DOWNWARD_SHARE = 0.2


@dataclass(frozen=True, eq=False)
class Sensor:
    """One motion channel of a drop.

    Parameters
    ----------
    offset : float, m, distance from the plate centre; negative: on the other side of the plate. The
        model depends on the distance only
    quantity : Measurand of a motion, or its name
    values : (n,) ndarray of float, in the SI unit of the quantity, downward positive
    """

    offset: float
    quantity: Measurand
    values: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "quantity", motion(self.quantity))


@dataclass(frozen=True, eq=False)
class Record:
    """One recorded drop with the declared values of device and ground: the input of the inversion.

    Parameters
    ----------
    time : (n,) ndarray of float, s, uniform; 0 = trigger
    load : (n,) ndarray of float, N, downward positive
    sensors : tuple of Sensor
    instrument : Instrument
    poisson_ratio : float, 0 <= value < 0.5
    density : float, kg/m3, or None: fitted
    bedrock_depth : float, m; inf: none; None: unknown
    model_floor : float, m, or None: declared error of the model's displacement
    modulus_error : float, relative error (95 %) of a modulus due to the instrument, which changes
        the whole record by one factor and leaves no residual
    """

    time: FloatArray
    load: FloatArray
    sensors: tuple[Sensor, ...]
    instrument: Instrument
    poisson_ratio: float = 0.35
    density: float | None = None
    bedrock_depth: float | None = None
    model_floor: float | None = None
    modulus_error: float = UNCALIBRATED_ERROR

    def __post_init__(self) -> None:
        count = self.time.size
        if count < 16:
            raise RecordError(f"record: expected at least 16 samples, got {count}")
        if not self.sensors:
            raise RecordError("record: expected at least one motion sensor, got none")
        for name, values in (
            ("load", self.load),
            *((f"sensor at {s.offset:g} m", s.values) for s in self.sensors),
        ):
            if values.shape != (count,):
                raise RecordError(f"{name}: expected {count} samples, got shape {values.shape}")
            if not np.all(np.isfinite(values)):
                raise RecordError(f"{name}: expected finite values, got NaN or infinity")
        if not all(np.isfinite(s.offset) for s in self.sensors):
            raise RecordError("sensor offsets: expected finite distances, got NaN or infinity")
        steps = np.diff(self.time)
        if not (steps[0] > 0.0 and np.all(np.abs(steps - steps[0]) <= 0.011 * steps[0])):
            raise RecordError("time: expected uniform, rising steps (within 1 %)")

    def nearest_first(self) -> Record:
        """Return the same drop with its sensors from the plate centre outward.

        Of two sensors at one distance that on the negative side comes last. Predictions have this
        order.
        """
        return replace(
            self, sensors=tuple(sorted(self.sensors, key=lambda s: (abs(s.offset), s.offset < 0)))
        )


@dataclass(frozen=True, eq=False)
class PreparedDrop:
    """Record prepared for the fit.

    Parameters
    ----------
    time : (n,) ndarray of float, s, from 0 at a start shortly before the pulse
    start : float, s, of that start on the time axis of the record
    load : (n,) ndarray of float, N, without offset
    displacement : (n_sensors, n) ndarray of float, m, zero before the pulse
    offsets : (n_sensors,) ndarray of float, m, >= 0: distances from the plate centre
    positions : (n_sensors,) ndarray of float, m: the same, negative on the other side of the plate
    noise : (n_sensors,) ndarray of float, m: root mean square noise of the displacement over the
        window, estimated before the pulse and integrated like the signal
    quantisation : (n_sensors,) ndarray of float, m: root mean square error of the displacement due
        to the resolution of the channel
    peak_load, peak_displacement : float N and (n_sensors,) ndarray m, largest downward
    contact_end : float, s, on ``time``: the load has fallen to 3 % of its peak
    window_end : float, s, on ``time``: last sample that is fitted
    tail_end : float, s, on ``time``: last sample before a second contact, before the padding of all
        channels, or of the record
    trigger : float, s, on ``time``
    channels : tuple of ChannelNoise, noise of the channels as recorded, for the uncertainty
    load_noise : NoiseModel of the load, N
    """

    time: FloatArray
    start: float
    load: FloatArray
    displacement: FloatArray
    offsets: FloatArray
    positions: FloatArray
    noise: FloatArray
    quantisation: FloatArray
    peak_load: float
    peak_displacement: FloatArray
    contact_end: float
    window_end: float
    tail_end: float
    trigger: float
    channels: tuple[ChannelNoise, ...]
    load_noise: NoiseModel

    @property
    def step(self) -> float:
        """Sampling interval, s."""
        return float(self.time[1] - self.time[0])

    def with_tail(self) -> PreparedDrop:
        """Return the same drop, fitted up to a second contact or the end of the record.

        Otherwise the fit ends with the contact, because real plates then bounce and tip, and the
        load cell does not measure that.
        """
        count = int(np.searchsorted(self.time, self.tail_end * (1 + 1e-9)))
        noise = np.array([displacement_rms(c, count, self.step) for c in self.channels])
        return replace(self, window_end=self.tail_end, noise=noise)

    @property
    def side_floor(self) -> FloatArray:
        r"""Error of each sensor by that on the other side of the plate, (n_sensors,), m.

        .. math:: \sigma = \mathrm{rms}(w_+ - w_-) / \sqrt 2

        over the fitted window; 0 where there is no sensor on the other side. In the model ground
        and plate are the same on all sides. Hence a difference of two sides at one distance is due
        to tilt, uneven contact, or errors of the sensors, and not to a missing effect. With
        independent errors of equal size on each side the difference has twice the variance of one.
        The model that fits two sides best is their mean, and leaves at least half of the
        difference.
        """
        result = np.zeros(self.positions.size)
        moved = self.displacement[:, self.window]
        for pair in self.opposite_sensors:
            result[list(pair)] = np.sqrt(np.mean(np.subtract(*moved[list(pair)]) ** 2) / 2.0)
        return result

    @property
    def opposite_sensors(self) -> list[tuple[int, int]]:
        """Pairs of indices of sensors at one distance on both sides of the plate."""
        return [
            (one, other)
            for one, other in combinations(range(self.positions.size), 2)
            if abs(self.positions[one] + self.positions[other]) < MAX_SIDE_DIFFERENCE_M
            and self.offsets[one] >= MAX_SIDE_DIFFERENCE_M
        ]

    @property
    def window(self) -> slice:
        """Samples of the fit, from the start to the end of the fitted window."""
        return slice(1, int(np.searchsorted(self.time, self.window_end * (1 + 1e-9))))


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Autocovariance of the noise of a channel, estimated before the pulse.

    Parameters
    ----------
    autocovariance : (m,) ndarray, lag 0 first, in the channel's unit squared
    samples : int, number of samples it was estimated from; 0: the noise is unknown
    """

    autocovariance: FloatArray
    samples: int

    @property
    def rms(self) -> float:
        """Root mean square of the noise, in the channel's unit."""
        return float(np.sqrt(self.autocovariance[0]))

    @classmethod
    def pooled(cls, models: Sequence[NoiseModel]) -> NoiseModel:
        """Return first-order autoregressive noise, estimated from several drops of one channel.

        The record before one pulse holds only a few periods of slow noise. Correlation and variance
        are therefore averaged over all drops, weighted by their samples.
        """
        estimated = [model for model in models if model.samples]
        if len(estimated) < 2:
            return estimated[0] if estimated else models[0]
        counts = np.array([model.samples for model in estimated], dtype=float)
        variance = float(counts @ [model.autocovariance[0] for model in estimated]) / counts.sum()
        if variance == 0.0:
            return estimated[0]
        neighbours = [m.autocovariance[1] if m.autocovariance.size > 1 else 0.0 for m in estimated]
        correlation = float(counts @ neighbours) / counts.sum() / variance
        return _autoregressive(variance, correlation, int(counts.sum()))

    def quadratic_form(self, rows: FloatArray) -> FloatArray:
        """Return the covariance (k, k) of ``rows`` (k, n) applied to the noise: rows C rows^T."""
        size = 1 << int(np.ceil(np.log2(rows.shape[1] + self.autocovariance.size)))
        circulant = np.zeros(size)
        lags = min(self.autocovariance.size, size // 2)
        circulant[:lags] = self.autocovariance[:lags]
        circulant[size - lags + 1 :] = self.autocovariance[1:lags][::-1]
        spectrum = np.fft.rfft(circulant).real.clip(min=0.0)
        shaped = np.fft.irfft(np.fft.rfft(rows, size, axis=1) * np.sqrt(spectrum), size, axis=1)
        result: FloatArray = shaped @ shaped.T
        return result


@dataclass(frozen=True, eq=False)
class ChannelNoise:
    """Noise of one channel as recorded, and how it enters the displacement.

    Parameters
    ----------
    model : NoiseModel in m/s or m
    integrations : int, number of integrations to a displacement
    baseline_samples : int, samples before the pulse whose mean was subtracted
    """

    model: NoiseModel
    integrations: int
    baseline_samples: int = field(default=0)


def prepare(record: Record) -> PreparedDrop:
    """Remove offsets, integrate velocities, and estimate noise and windows of a drop.

    Raises
    ------
    RecordError
        If the load has no positive pulse.
    """
    time, step = record.time, float(record.time[1] - record.time[0])
    baseline = _baseline_samples(time, record.load)
    load = record.load - (record.load[:baseline].mean() if baseline else 0.0)
    peak = int(np.argmax(load))
    if not load[peak] > 0.0:
        raise RecordError("load: expected a positive pulse (downward is positive), got none")
    below = np.flatnonzero(load[: peak + 1] < _ONSET_FRACTION * load[peak])
    onset = int(below[-1]) if below.size else 0
    first = max(0, onset - int(np.ceil(_MARGIN_BEFORE_ONSET_S / step)))
    if baseline:
        first = min(
            [first, *(_start_of_motion(s.values, baseline, first, step) for s in record.sensors)]
        )
    displacement = np.stack([_displacement(s, baseline, first, step) for s in record.sensors])
    drop_time = step * np.arange(time.size - first)
    recorded = max(_recorded_samples(record), peak + 2)
    contact_end, tail_end = (
        step * i for i in _contact_and_tail(load[first:recorded], peak - first)
    )
    count = max(2, int(np.searchsorted(drop_time, contact_end)))
    channels = tuple(
        ChannelNoise(
            # All samples before the pulse are used: slow noise needs a long time.
            noise_before(s.values[: max(baseline, first) if baseline else 0]),
            s.quantity.integrations,
            baseline if s.quantity.integrations else _settled_samples(first, step),
        )
        for s in record.sensors
    )
    noise = np.array([displacement_rms(c, count, step) for c in channels])
    quantum = np.array(
        [_quantum(s.values) * _growth(s.quantity.integrations, count, step) for s in record.sensors]
    )
    return PreparedDrop(
        time=drop_time,
        start=float(time[first]),
        load=load[first:],
        displacement=displacement,
        offsets=np.array([abs(s.offset) for s in record.sensors]),
        positions=np.array([s.offset for s in record.sensors]),
        noise=noise,
        quantisation=quantum / np.sqrt(12.0),
        peak_load=float(load[peak]),
        # Peaks are taken up to a second contact: distant sensors peak after the end of the load.
        peak_displacement=_peaks(displacement[:, : round(tail_end / step) + 1]),
        contact_end=contact_end,
        window_end=contact_end,
        tail_end=tail_end,
        trigger=max(0.0, -float(time[first])),
        channels=channels,
        load_noise=noise_before(record.load[:baseline]),
    )


def displacement_rms(channel: ChannelNoise, count: int, step: float) -> float:
    """Return the root mean square noise of the displacement over ``count`` samples, m.

    A velocity is integrated by the trapezoidal rule after its mean over the baseline was
    subtracted. White noise then becomes a random walk, and the error of the mean a ramp.
    """
    if channel.model.samples == 0:
        return 0.0
    picks = np.linspace(1, count - 1, min(16, count - 1)).astype(int)
    rows = np.zeros((picks.size, count))
    rows[np.arange(picks.size), picks] = 1.0
    native = native_rows(rows, channel, step)
    return float(np.sqrt(np.mean(np.diag(channel.model.quadratic_form(native)))))


def native_rows(rows: FloatArray, channel: ChannelNoise, step: float) -> FloatArray:
    """Return weights on the samples as recorded, from weights ``rows`` (k, n) on the displacement.

    It is the adjoint of baseline removal and trapezoidal integration, (k, baseline + n).
    """
    weights = rows
    for _ in range(channel.integrations):
        # w_j = step * (v_0/2 + v_1 + ... + v_j/2), so each v_i contributes to all later w_j.
        later = np.cumsum(weights[:, ::-1], axis=1)[:, ::-1]
        first = 0.5 * step * (later[:, 0] - weights[:, 0])
        weights = step * (later - 0.5 * weights)
        weights[:, 0] = first
    before = channel.baseline_samples
    result = np.zeros((rows.shape[0], before + rows.shape[1]))
    result[:, before:] = weights
    if before:
        result[:, :before] = -weights.sum(axis=1, keepdims=True) / before
    return result


def _baseline_samples(time: FloatArray, load: FloatArray) -> int:
    """Return the number of samples for the baseline: the first half of those before the trigger.

    The trigger is a threshold, so that the pulse begins some milliseconds before time 0.
    """
    before = int(np.searchsorted(time, 0.0))
    quiet = before // 2
    return quiet if quiet >= _MIN_BASELINE_SAMPLES else 0


def _displacement(sensor: Sensor, baseline: int, first: int, step: float) -> FloatArray:
    if not sensor.quantity.integrations:
        # An integrated channel may have drifted: its zero is taken just before the pulse.
        settled = _settled_samples(first, step)
        rest = sensor.values[first - settled : first].mean() if settled else sensor.values[first]
        return np.asarray(sensor.values[first:] - rest)
    values = sensor.values - (sensor.values[:baseline].mean() if baseline else 0.0)
    result = values[first:]
    for _ in range(sensor.quantity.integrations):
        steps = 0.5 * step * (result[1:] + result[:-1])
        result = np.concatenate([[0.0], np.cumsum(steps)])
    return result


def _settled_samples(first: int, step: float) -> int:
    """Return the number of samples over which a displacement's zero is averaged."""
    return min(first, max(1, round(_ZERO_S / step)))


def _peaks(displacement: FloatArray) -> FloatArray:
    """Return the largest downward displacement of each sensor, m.

    For a sensor that rises it is the largest displacement of either sign.

    At a distance from the plate, on shallow rock, the ground rises and hardly sinks.
    """
    downward = displacement.max(axis=1)
    largest: FloatArray = np.abs(displacement).max(axis=1)
    return np.where(downward > _MIN_DOWNWARD_SHARE * largest, downward, largest)


def _contact_and_tail(load: FloatArray, peak: int) -> tuple[int, int]:
    """Return the last samples of the contact, and before a second contact."""
    after = np.flatnonzero(load[peak:] <= CONTACT_END_FRACTION * load[peak])
    end = peak + int(after[0]) if after.size else load.size - 1
    second = np.flatnonzero(load[end:] > _SECOND_CONTACT_FRACTION * load[peak])
    return end, max(end, end + int(second[0]) - 1) if second.size else load.size - 1


def _recorded_samples(record: Record) -> int:
    """Return the number of samples without the recorder's padding at the end of the record."""
    size = record.time.size
    ends = []
    for values in (record.load, *(sensor.values for sensor in record.sensors)):
        steps = np.abs(np.diff(values))
        moving = np.flatnonzero(steps)
        if moving.size == 0 or steps[moving[-1]] <= _MAX_QUANTA_AT_REST * _quantum(values):
            return size
        ends.append(int(moving[-1]) + 1)
    # The padding repeats the last recorded sample, so that the ends may differ by one.
    is_padded = max(ends) - min(ends) <= 1 and size - max(ends) >= _MIN_PADDING_SAMPLES
    return max(ends) if is_padded else size


def _start_of_motion(values: FloatArray, baseline: int, first: int, step: float) -> int:
    """Return the sample before a channel begins to move, or ``first`` if the load rises earlier."""
    moved = np.abs(values - values[:baseline].mean())
    threshold = max(
        _MIN_MOTION_DEVIATIONS * float(values[:baseline].std()),
        _MIN_MOTION_OVER_PEAK * float(moved.max()),
        _quantum(values),
    )
    still = np.flatnonzero(moved[baseline:first] <= threshold)
    onset = baseline + (int(still[-1]) if still.size else 0)
    if first - 1 - onset < _MIN_MOVING_SAMPLES:
        return first
    return max(baseline, onset - int(np.ceil(_MARGIN_BEFORE_ONSET_S / step)))


def noise_before(quiet: FloatArray) -> NoiseModel:
    r"""Return first-order autoregressive noise :math:`\gamma_k = \sigma^2 \rho^k` of quiet samples.

    A straight line is subtracted first, because drift is an effect and not noise. This removes slow
    noise as well, so that variance and correlation are corrected for it (Kendall's bias of a
    detrended series, :math:`\rho - (2 + 4 \rho)/n`; variance lost to two parameters that average
    :math:`(1 + \rho)/(1 - \rho)` correlated samples). A sample autocovariance would lose the slow
    part, which integration amplifies most.
    """
    count = quiet.size
    if count < _MIN_BASELINE_SAMPLES:
        return NoiseModel(np.zeros(1), 0)
    place = np.arange(count) - 0.5 * (count - 1)
    detrended = quiet - quiet.mean() - place * (place @ quiet) / (place @ place)
    power = float(detrended @ detrended)
    if power == 0.0:
        return NoiseModel(np.zeros(1), count)
    biased = float(detrended[1:] @ detrended[:-1]) / power
    correlation = float(np.clip((biased + 2.0 / count) / (1.0 - 4.0 / count), 0.0, 0.98))
    memory = (1.0 + correlation) / (1.0 - correlation)
    variance = power / count / max(0.3, 1.0 - 2.0 * memory / count)
    return _autoregressive(variance, correlation, count)


def _autoregressive(variance: float, correlation: float, samples: int) -> NoiseModel:
    lags = 1 if correlation == 0.0 else 1 + int(np.ceil(np.log(1e-3) / np.log(correlation)))
    return NoiseModel(variance * correlation ** np.arange(lags), samples)


def _growth(integrations: int, count: int, step: float) -> float:
    """Return the factor from independent errors of the samples to those of the displacement.

    It is above the root mean square over ``count`` samples.
    """
    if not integrations:
        return 1.0
    once = math.sqrt(count) * step / 2
    return once * (step * count / math.sqrt(6)) ** (integrations - 1)


def _quantum(values: FloatArray) -> float:
    """Return the smallest step between values of a channel: the resolution of converter or text."""
    distinct = np.unique(values)
    if distinct.size < 3:
        return 0.0
    return float(np.min(np.diff(distinct)))
