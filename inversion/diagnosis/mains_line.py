"""Detection of mains hum before the pulse: a spectral line, which is an effect and not noise.

The signal before the pulse is used to estimate the noise. Hum in it would count as noise as slow as
the pulse, compared with which no effect would be significant, not even the hum itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import FloatArray
from inversion.measured.record import PreparedDrop, Record, noise_before

# Mains frequencies, Hz, and the frequencies that are tried, with the deviations of generators.
_MAINS = (50.0, 60.0)
_FREQUENCIES = np.concatenate([mains + np.arange(-1.0, 1.25, 0.25) for mains in _MAINS])
# Shortest usable record before the pulse, in periods of the lowest frequency. In a shorter one a
# line cannot be distinguished from slow noise.
_MIN_TURNS = 0.6
# Orders of the harmonics: rectifiers and transformers cause odd ones.
_HARMONICS = (1, 3, 5)
# Largest frequency over the sampling rate; nearer to one half, frequencies cannot be separated.
_MAX_FREQUENCY_RATIO = 0.45
# Largest root mean square residual of a mains line over that of a straight line. For slow noise,
# which this number of parameters fits well, the ratio is below a fifth in one of a hundred records.
_MAX_RESIDUAL_RATIO = 0.15


@dataclass(frozen=True, eq=False)
class MainsLine:
    """Mains hum before the pulse, with its harmonics.

    Parameters
    ----------
    amplitude : float, m/s, of the velocity of the fundamental
    frequency : float, Hz
    phase : float, in turns, of its sine in the middle of the record before the pulse
    harmonics : tuple of (order, amplitude over that of the fundamental, phase relative to that
        multiple of the fundamental's phase, rad), of the velocity
    residual : (n,) ndarray of float, signal before the pulse without the line
    """

    amplitude: float
    frequency: float
    phase: float
    harmonics: tuple[tuple[int, float, float], ...]
    residual: FloatArray

    @property
    def as_tuple(self) -> tuple[float, float, float]:
        """Amplitude, m/s, frequency, Hz, and phase, turns, in the middle of the quiet part."""
        return self.amplitude, self.frequency, self.phase


def without_mains_line(drop: PreparedDrop, record: Record) -> tuple[PreparedDrop, MainsLine | None]:
    """Return a drop whose noise excludes hum, and the line of the first channel with hum or None.

    Parameters
    ----------
    drop : PreparedDrop, of the record
    record : Record
    """
    lines = [
        find_line(sensor.values[: channel.model.samples], drop.step, channel.integrations)
        for channel, sensor in zip(drop.channels, record.sensors, strict=True)
    ]
    channels = tuple(
        channel if line is None else replace(channel, model=noise_before(line.residual))
        for channel, line in zip(drop.channels, lines, strict=True)
    )
    detected = [line for line in lines if line is not None]
    if not detected:
        return drop, None
    return replace(drop, channels=channels).with_tail(), detected[0]


@dataclass(frozen=True)
class Hum:
    """Estimate of mains hum from the record before the pulse.

    Parameters
    ----------
    max_amplitude : float, m/s, upper limit: the largest of the fitted amplitudes at 50 and 60 Hz,
        each with its standard deviation added; inf: no estimate
    lines : for each mains frequency the amplitude (m/s), frequency (Hz) and phase (turns) of the
        velocity in the middle of that record
    """

    max_amplitude: float = np.inf
    lines: tuple[tuple[float, float, float], ...] = ()


def hum_before(quiet: FloatArray, step: float, integrations: int) -> Hum:
    """Fit mains hum of 50 and 60 Hz to the record before the pulse, by least squares.

    Parameters
    ----------
    quiet : (n,) ndarray of float, in the unit of the channel
    step : float, s, sampling interval
    integrations : int, number of integrations from the channel to a displacement
    """
    time = step * (np.arange(quiet.size) - 0.5 * (quiet.size - 1))
    max_amplitude, lines = 0.0, []
    for frequency in _MAINS:
        if frequency >= _MAX_FREQUENCY_RATIO / step:
            # At this sampling rate the hum is aliased.
            continue
        turn = 2.0 * np.pi * frequency * time
        columns = np.column_stack([np.ones_like(turn), np.cos(turn), np.sin(turn)])
        if quiet.size <= columns.shape[1]:
            return Hum()
        residual, factors = _fit_columns(columns, quiet)
        variance = float(residual @ residual) / (quiet.size - columns.shape[1])
        deviations = variance * np.diag(np.linalg.inv(columns.T @ columns))[1:]
        (phasor,) = _phasors(factors[1:], frequency, integrations)
        in_velocity = (2.0 * np.pi * frequency) ** (2 * (1 - integrations))
        size = float(np.abs(phasor))
        max_amplitude = max(max_amplitude, float(np.sqrt(size**2 + in_velocity * deviations.sum())))
        lines.append((size, frequency, float(np.angle(phasor) / (2.0 * np.pi))))
    return Hum(max_amplitude, tuple(lines))


def find_line(quiet: FloatArray, step: float, integrations: int) -> MainsLine | None:
    """Return the mains line in the record before the pulse; None: there is none.

    Parameters
    ----------
    quiet : (n,) ndarray of float, in the unit of the channel
    step : float, s, sampling interval
    integrations : int, number of integrations from the channel to a displacement
    """
    if quiet.size * step * _FREQUENCIES[0] < _MIN_TURNS:
        return None
    # Time 0 is in the middle of the record, where phases are determined best.
    time = step * (np.arange(quiet.size) - 0.5 * (quiet.size - 1))
    straight = np.stack([np.ones_like(time), time], axis=1)
    residual, _ = _fit_columns(straight, quiet)
    min_squares = _MAX_RESIDUAL_RATIO**2 * float(residual @ residual)
    best = None
    for frequency in _FREQUENCIES:
        turns = [2.0 * np.pi * harmonic * frequency * time for harmonic in _HARMONICS]
        waves = [wave(turn) for turn in turns for wave in (np.cos, np.sin)]
        residual, factors = _fit_columns(np.column_stack([straight, *waves]), quiet)
        if float(residual @ residual) < min_squares:
            min_squares = float(residual @ residual)
            phasors = _phasors(factors[straight.shape[1] :], frequency, integrations)
            best = MainsLine(
                amplitude=float(np.abs(phasors[0])),
                frequency=float(frequency),
                phase=float(np.angle(phasors[0]) / (2.0 * np.pi)),
                harmonics=_harmonics(phasors),
                residual=residual,
            )
    return best


def _phasors(factors: FloatArray, frequency: float, integrations: int) -> NDArray[np.complex128]:
    """Return the complex amplitudes (n,), m/s, of a velocity from its Fourier factors."""
    phasors = factors[1::2] + 1j * factors[::2]
    if integrations == 1:
        return phasors
    turns = 2j * np.pi * frequency * np.array(_HARMONICS[: phasors.size])
    return np.asarray(phasors * turns ** (1 - integrations))


def _harmonics(phasors: NDArray[np.complex128]) -> tuple[tuple[int, float, float], ...]:
    """Return order, relative amplitude and relative phase of each harmonic of the fundamental."""
    sizes, phases = np.abs(phasors), np.angle(phasors)
    return tuple(
        (order, float(size / sizes[0]), float(phase - order * phases[0]))
        for order, size, phase in zip(_HARMONICS, sizes, phases, strict=True)
    )[1:]


def _fit_columns(columns: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the residual of values (n,) after a fit of columns (n, k), and their factors (k,)."""
    factors, *_ = np.linalg.lstsq(columns, values, rcond=None)
    return values - columns @ factors, factors
