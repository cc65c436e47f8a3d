"""Hum of the mains before the pulse: a line, which is an effect, and no noise.

What is there before the pulse is taken for noise.  Hum that fills it would be noise as slow as the
pulse, beside which nothing asks for an effect any more, not even the hum itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import FloatArray
from inversion.measured.record import PreparedDrop, Record, noise_before

# Hz: mains, and what generators make of them.
_MAINS = (50.0, 60.0)
_FREQUENCIES = np.concatenate([mains + np.arange(-1.0, 1.25, 0.25) for mains in _MAINS])
# Of a turn of the slowest line: what is shorter may be any slow noise.
_LEAST_TURN = 0.6
# Rectifiers and transformers make odd harmonics.
_HARMONICS = (1, 3, 5)
# Of the samples in a second, frequencies that they show: nearer to half of them all look alike.
_SHOWN = 0.45
# A line leaves no more than this part of what a straight one leaves (rms); slow noise, which so
# many numbers follow as far as it is smooth, leaves a fifth in one of a hundred records.
_MOST_LEFT = 0.15


@dataclass(frozen=True, eq=False)
class MainsLine:
    """Hum before the pulse.

    Parameters
    ----------
    amplitude : float, m/s, of the first one's velocity
    frequency : float, Hz
    phase : float, of its sine in the middle of the time before the pulse, turns
    harmonics : tuple of (order, share of the first one, phase against as many turns of it, rad),
        of the velocity
    left : (n,) ndarray of float, what it leaves
    """

    amplitude: float
    frequency: float
    phase: float
    harmonics: tuple[tuple[int, float, float], ...]
    left: FloatArray

    @property
    def told(self) -> tuple[float, float, float]:
        """Amplitude, m/s, frequency, Hz, and phase in that middle, turns."""
        return self.amplitude, self.frequency, self.phase


def without_mains_line(drop: PreparedDrop, record: Record) -> tuple[PreparedDrop, MainsLine | None]:
    """The drop with the noise of its channels as it is without hum, and that of the first with it.

    Parameters
    ----------
    drop : PreparedDrop, of the record
    record : Record
    """
    lines = [
        find_line(sensor.values[: channel.model.samples], drop.step, velocity=channel.integrates)
        for channel, sensor in zip(drop.channels, record.sensors, strict=True)
    ]
    channels = tuple(
        channel if line is None else replace(channel, model=noise_before(line.left))
        for channel, line in zip(drop.channels, lines, strict=True)
    )
    found = [line for line in lines if line is not None]
    if not found:
        return drop, None
    return replace(drop, channels=channels).with_tail(), found[0]


@dataclass(frozen=True)
class Hum:
    """What the time before the pulse says of hum.

    Parameters
    ----------
    most : float, m/s, how large it may be: the larger of what lines of 50 and 60 Hz fit there,
        with its deviation by what it leaves; inf: that tells nothing
    lines : of each mains amplitude (m/s), frequency (Hz) and phase of the velocity in the middle of
        that time (turns)
    """

    most: float = np.inf
    lines: tuple[tuple[float, float, float], ...] = ()


def hum_before(quiet: FloatArray, step: float, *, velocity: bool) -> Hum:
    """Hum of either mains that best fits the time before the pulse.

    Parameters
    ----------
    quiet : (n,) ndarray of float, m/s or m
    step : float, s
    velocity : bool, whether it is a velocity, else a displacement
    """
    time = step * (np.arange(quiet.size) - 0.5 * (quiet.size - 1))
    most, lines = 0.0, []
    for frequency in _MAINS:
        if frequency >= _SHOWN / step:
            # So few samples a second show it as something else.
            continue
        turn = 2.0 * np.pi * frequency * time
        columns = np.column_stack([np.ones_like(turn), np.cos(turn), np.sin(turn)])
        if quiet.size <= columns.shape[1]:
            return Hum()
        left, factors = _fitted(columns, quiet)
        variance = float(left @ left) / (quiet.size - columns.shape[1])
        deviations = variance * np.diag(np.linalg.inv(columns.T @ columns))[1:]
        (phasor,) = _phasors(factors[1:], frequency, velocity)
        in_velocity = 1.0 if velocity else (2.0 * np.pi * frequency) ** 2
        size = float(np.abs(phasor))
        most = max(most, float(np.sqrt(size**2 + in_velocity * deviations.sum())))
        lines.append((size, frequency, float(np.angle(phasor) / (2.0 * np.pi))))
    return Hum(most, tuple(lines))


def find_line(quiet: FloatArray, step: float, *, velocity: bool) -> MainsLine | None:
    """The line of the mains in the time before the pulse; None where there is none.

    Parameters
    ----------
    quiet : (n,) ndarray of float
    step : float, s
    velocity : bool, whether it is a velocity, else a displacement
    """
    if quiet.size * step * _FREQUENCIES[0] < _LEAST_TURN:
        return None
    # From the middle on, where phases are told best.
    time = step * (np.arange(quiet.size) - 0.5 * (quiet.size - 1))
    straight = np.stack([np.ones_like(time), time], axis=1)
    left, _ = _fitted(straight, quiet)
    most = _MOST_LEFT**2 * float(left @ left)
    found = None
    for frequency in _FREQUENCIES:
        turns = [2.0 * np.pi * harmonic * frequency * time for harmonic in _HARMONICS]
        waves = [wave(turn) for turn in turns for wave in (np.cos, np.sin)]
        left, factors = _fitted(np.column_stack([straight, *waves]), quiet)
        if float(left @ left) < most:
            most = float(left @ left)
            phasors = _phasors(factors[straight.shape[1] :], frequency, velocity)
            found = MainsLine(
                amplitude=float(np.abs(phasors[0])),
                frequency=float(frequency),
                phase=float(np.angle(phasors[0]) / (2.0 * np.pi)),
                harmonics=_harmonics(phasors),
                left=left,
            )
    return found


def _phasors(factors: FloatArray, frequency: float, velocity: bool) -> NDArray[np.complex128]:
    """Of the sines of the velocity, by the factors of cosine and sine of each, (n,), m/s."""
    phasors = factors[1::2] + 1j * factors[::2]
    if not velocity:
        phasors = phasors * 2j * np.pi * frequency * np.array(_HARMONICS[: phasors.size])
    return phasors


def _harmonics(phasors: NDArray[np.complex128]) -> tuple[tuple[int, float, float], ...]:
    """Of the first one, whose share is 1."""
    sizes, phases = np.abs(phasors), np.angle(phasors)
    return tuple(
        (order, float(size / sizes[0]), float(phase - order * phases[0]))
        for order, size, phase in zip(_HARMONICS, sizes, phases, strict=True)
    )[1:]


def _fitted(columns: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What columns (n, k) leave of values (n,), by least squares, and their factors (k,)."""
    factors, *_ = np.linalg.lstsq(columns, values, rcond=None)
    return values - columns @ factors, factors
