r"""Natural frequency and damping of a geophone from the decay of its oscillation after a release.

The mass is displaced and released, or the coil is fed a current that is switched off. Displacement
of the mass and voltage of the coil then have the form

.. math::
    x(t) = c + d t + e^{-h \omega t} (a \cos \omega' t + b \sin \omega' t), \quad
    \omega' = \omega \sqrt{1 - h^2}

with :math:`\omega` the natural frequency and h the damping. Both depend on the amplitude in real
sensors, so a long decay is divided into windows. In each only :math:`\omega` and h are unknowns of
the search; c, d, a and b follow by linear least squares.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import least_squares
from scipy.special import stdtrit  # the same function in scipy.stats takes 0.3 s to import

from inversion.arrays import FloatArray
from inversion.errors import InversionError

MAX_WINDOWS = 5
MIN_CYCLES = 3.0
"""Smallest number of oscillations in a window; a stronger decay has a single window."""
MIN_SAMPLES_PER_CYCLE = 8.0
_END_OVER_NOISE = 5.0
"""A decay ends where its amplitude is this multiple of the noise at its end."""
_DAMPINGS = (0.01, 0.05, 0.2, 0.5, 0.7, 0.9)
"""Starting points of the damping."""
_LARGEST_DAMPING = 0.99
_FREQUENCY_STEP = 0.05
"""Relative step of the frequencies of the starting points."""
_BEST_STARTS = 4


@dataclass(frozen=True)
class Decay:
    """Natural frequency and damping in one window of a decay."""

    start: float
    """Start of the window, s."""
    end: float
    """End of the window, s."""
    amplitude: float
    """Amplitude at the start of the window, in the unit of the values."""
    natural_frequency: float
    """Hz."""
    natural_frequency_interval: tuple[float, float]
    """95 % interval, Hz."""
    damping: float
    """Fraction of critical damping."""
    damping_interval: tuple[float, float]
    """95 % interval."""
    misfit: float
    """Root mean square residual over the amplitude."""


def decays(time: FloatArray, values: FloatArray) -> list[Decay]:
    """Return natural frequency and damping over a decay, for each window from large to small.

    Parameters
    ----------
    time : (n,) ndarray of float, s
        Uniform times.
    values : (n,) ndarray of float
        Displacement of the mass or voltage of the coil, in any unit.

    Raises
    ------
    InversionError
        If the record has no decaying oscillation, or too few samples of it.
    """
    step = float(time[1] - time[0]) if len(time) > 1 else 0.0
    if len(time) < 4 * MIN_SAMPLES_PER_CYCLE or not step > 0 or not np.isfinite(values).all():
        raise InversionError(f"expected a decay of at least 32 samples, got {len(time)}")
    start = int(np.argmax(np.abs(values - np.median(values))))
    complete = _fit(time[start:], values[start:], None)
    cycle = 1 / complete.natural_frequency
    n_windows = int((time[-1] - time[start]) / (MIN_CYCLES * cycle))
    if n_windows < 2 or complete.damping > 0.15:
        return [_accepted(complete)]
    count = min(MAX_WINDOWS, n_windows)
    edges = np.linspace(start, len(time), count + 1).round().astype(int)
    noise = white_noise_of(values[edges[-2] :])
    parts: list[Decay] = []
    for first, last in pairwise(edges):
        part = _fit(time[first:last], values[first:last], complete)
        if part.amplitude > _END_OVER_NOISE * noise or not parts:
            parts.append(_accepted(part))
    return parts


def white_noise_of(values: FloatArray) -> float:
    """Return the standard deviation of independent noise, from second differences of the values."""
    return float(np.std(np.diff(values, 2)) / np.sqrt(6.0))


def _accepted(decay: Decay) -> Decay:
    """Return a decay; raise InversionError if the record does not follow the model."""
    if decay.misfit > 0.1 or not np.isfinite(decay.natural_frequency_interval).all():
        raise InversionError(
            f"expected a decaying oscillation from {decay.start:.3g} to {decay.end:.3g} s, got "
            f"a record that differs from it by {100 * decay.misfit:.0f} % of its amplitude"
        )
    return decay


def _fit(time: FloatArray, values: FloatArray, start_from: Decay | None) -> Decay:
    """Fit one window, from the values of a neighbouring one or from several starting points."""
    elapsed = time - time[0]
    scale = float(np.ptp(values)) or 1.0
    target = values / scale

    def basis(unknowns: FloatArray) -> FloatArray:
        omega, damping = np.exp(unknowns[0]), _LARGEST_DAMPING / (1 + np.exp(-unknowns[1]))
        decay = np.exp(-damping * omega * elapsed)
        phase = omega * np.sqrt(1 - damping**2) * elapsed
        constant = np.ones_like(elapsed)
        columns = [decay * np.cos(phase), decay * np.sin(phase), constant, elapsed / elapsed[-1]]
        return np.stack(columns, axis=1)

    def residual(unknowns: FloatArray) -> FloatArray:
        columns = basis(unknowns)
        return np.asarray(columns @ np.linalg.lstsq(columns, target, rcond=None)[0] - target)

    starts = (
        [_unknowns(start_from.natural_frequency, start_from.damping)]
        if start_from
        else _starts(elapsed)
    )
    if len(starts) > _BEST_STARTS:
        starts = sorted(starts, key=lambda start: float(np.sum(residual(start) ** 2)))
    fits = [least_squares(residual, start) for start in starts[:_BEST_STARTS]]
    best = min(fits, key=lambda fit: float(fit.cost))
    omega, damping = np.exp(best.x[0]), _LARGEST_DAMPING / (1 + np.exp(-best.x[1]))
    factors = np.linalg.lstsq(basis(best.x), target, rcond=None)[0]
    residuals = best.fun
    degrees = max(1, len(target) - 6)
    # Residuals of neighbouring samples are alike: they count as fewer independent ones.
    correlation = float(
        np.clip(residuals[1:] @ residuals[:-1] / (residuals @ residuals + 1e-300), 0.0, 0.99)
    )
    variance = (
        (residuals @ residuals + len(residuals) * 1e-20)
        / degrees
        * (1 + correlation)
        / (1 - correlation)
    )
    covariance = variance * np.linalg.pinv(best.jac.T @ best.jac)
    independent = max(2.0, degrees * (1 - correlation) / (1 + correlation))
    widths = float(stdtrit(independent, 0.975)) * np.sqrt(np.diag(covariance))
    slope = damping * (1 - damping / _LARGEST_DAMPING)
    frequency = float(omega / (2 * np.pi))
    amplitude = float(np.hypot(*factors[:2]))
    return Decay(
        float(time[0]),
        float(time[-1]),
        amplitude * scale,
        frequency,
        (frequency * float(np.exp(-widths[0])), frequency * float(np.exp(widths[0]))),
        float(damping),
        (float(damping - slope * widths[1]), float(damping + slope * widths[1])),
        float(np.sqrt(np.mean(residuals**2)) / max(amplitude, 1e-300)),
    )


def _starts(elapsed: FloatArray) -> list[FloatArray]:
    """Return starting points: logarithm of the angular frequency, logit of the damping."""
    lowest, highest = 1 / elapsed[-1], 1 / (MIN_SAMPLES_PER_CYCLE * elapsed[1])
    count = max(2, round(float(np.log(highest / lowest)) / _FREQUENCY_STEP))
    frequencies = np.geomspace(lowest, highest, count)
    return [_unknowns(frequency, damping) for frequency in frequencies for damping in _DAMPINGS]


def _unknowns(frequency: float, damping: float) -> FloatArray:
    return np.log([2 * np.pi * frequency, damping / (_LARGEST_DAMPING - damping)])
