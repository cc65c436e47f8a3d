r"""Fit of a half-sine to a load pulse.

.. math:: F(t) = F_{max} \sin(\pi t / T_0), \quad 0 \le t \le T_0
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from inversion.arrays import FloatArray
from inversion.errors import RecordError

Load = Literal["measured", "half-sine", "half-sine-equal-area"]
"""Load of a model: as measured, or a half-sine by least squares or with the measured area."""


@dataclass(frozen=True)
class HalfSineFit:
    """Half-sine with its misfit to the load.

    Parameters
    ----------
    peak_load : float, N
    duration : float, s
    start : float, s, on the time axis of the load
    rms_over_peak : float, root mean square misfit over the pulse, over the peak load
    """

    peak_load: float
    duration: float
    start: float
    rms_over_peak: float

    def load(self, time: FloatArray) -> FloatArray:
        """Return the load of the half-sine, (n,), N, at ``time``, (n,), s."""
        phase = (time - self.start) / self.duration
        inside = (phase > 0.0) & (phase < 1.0)
        return np.where(inside, self.peak_load * np.sin(np.pi * phase), 0.0)


def model_load(time: FloatArray, load: FloatArray, kind: Load) -> FloatArray:
    """Return the load that drives a model, (n,), N, from the measured one."""
    if kind == "measured":
        return load
    fit = fit_half_sine if kind == "half-sine" else fit_half_sine_equal_area
    return fit(time, load).load(time)


def fit_half_sine_equal_area(time: FloatArray, load: FloatArray) -> HalfSineFit:
    r"""Return the half-sine with the measured peak and the measured area under the load.

    This is the one of the published method (doi 10.11835/j.issn.2096-6717.2022.021, note of Fig.
    2).

    .. math:: T_0 = \frac{\pi}{2 F_{max}} \int F \, dt

    over the contact. It is centred on the pulse's centre of area.
    """
    part = _contact(load)
    peak = float(load[part].max())
    area = float(np.trapezoid(load[part], time[part]))
    if not (peak > 0.0 and area > 0.0):
        raise RecordError("half-sine: expected a positive load pulse, got none")
    duration = np.pi * area / (2.0 * peak)
    centre = float(np.trapezoid(load[part] * time[part], time[part])) / area
    return _with_misfit(time, load, peak, duration, centre - 0.5 * duration)


def fit_half_sine(time: FloatArray, load: FloatArray) -> HalfSineFit:
    """Return the half-sine of least squares in peak, duration and start."""
    first = fit_half_sine_equal_area(time, load)
    scale = np.array([first.peak_load, first.duration, first.duration])
    x = np.array([1.0, 1.0, first.start / first.duration])
    part = _contact(load)
    at, target = time[part], load[part] / first.peak_load

    def curve(values: FloatArray) -> FloatArray:
        phase = (at / scale[1] - values[2]) / values[1]
        inside = (phase > 0.0) & (phase < 1.0)
        return np.where(inside, values[0] * np.sin(np.pi * phase), 0.0)

    # Gauss-Newton with halved steps; the equal-area half-sine is near the minimum.
    cost = float(np.sum((curve(x) - target) ** 2))
    for _ in range(30):
        base = curve(x)
        jacobian = np.stack([(curve(x + step) - base) / 1e-6 for step in 1e-6 * np.eye(3)], axis=1)
        move = np.linalg.lstsq(jacobian, target - base, rcond=None)[0]
        while True:
            new = float(np.sum((curve(x + move) - target) ** 2))
            if new <= cost or np.max(np.abs(move)) < 1e-9:
                break
            move = 0.5 * move
        gained = cost - new
        if gained < 1e-12 * cost:
            break
        x, cost = x + move, new
    return _with_misfit(time, load, x[0] * scale[0], x[1] * scale[1], x[2] * scale[2])


def _contact(load: FloatArray) -> slice:
    """Return the samples around the peak where the load is above 1 % of it."""
    peak = int(np.argmax(load))
    low = load <= 0.01 * load[peak]
    before = np.flatnonzero(low[: peak + 1])
    after = np.flatnonzero(low[peak:])
    return slice(
        int(before[-1]) if before.size else 0,
        peak + int(after[0]) + 1 if after.size else load.size,
    )


def _with_misfit(
    time: FloatArray, load: FloatArray, peak: float, duration: float, start: float
) -> HalfSineFit:
    fit = HalfSineFit(float(peak), float(duration), float(start), 0.0)
    part = _contact(load)
    rms = np.sqrt(np.mean((fit.load(time[part]) - load[part]) ** 2))
    return HalfSineFit(fit.peak_load, fit.duration, fit.start, float(rms / peak))
