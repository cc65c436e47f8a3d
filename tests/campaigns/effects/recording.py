"""Noise, conversion to counts and writing of the trace file, the last steps of a simulated record.

A trace file has a header of declared values and a table of samples.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from simulators.mesh import Array
from tests.campaigns.effects.signals import Signals


@dataclass(frozen=True)
class Converter:
    """Noise, sampling and quantisation of a simulated instrument."""

    quantity: str
    """`velocity` or `displacement`, the quantity of the sensor columns."""
    noise: float
    """Root mean square over the peak of each channel."""
    colour: float
    """Correlation between successive samples; 0: white."""
    decimation: int
    """Steps of the simulation per stored sample."""
    bits: int
    """Bits of the converter, whose range is plus and minus twice the peak."""

    @classmethod
    def drawn(
        cls, generator: np.random.Generator, device: np.random.Generator, noise: float | None
    ) -> Converter:
        """Return a converter with random properties.

        Parameters
        ----------
        generator : numpy.random.Generator
            Random numbers of the point, which give the noise.
        device : numpy.random.Generator
            Random numbers of the instrument, which give quantity, sampling and bits.
        noise : float or None
            Fixed root mean square of the noise over the peak; None: random.
        """
        quantity = "velocity" if device.random() < 0.6 else "displacement"
        decimation = int(device.choice([2, 4, 4, 6]))
        bits = int(device.choice([14, 16, 24]))
        drawn = float(np.exp(generator.uniform(math.log(5e-4), math.log(5e-3))))
        colour = float(generator.choice([0.0, 0.0, 0.5, 0.8]))
        return cls(quantity, drawn if noise is None else noise, colour, decimation, bits)

    def noise_of(self, shape: tuple[int, ...], generator: np.random.Generator) -> Array:
        """Return noise with a root mean square of 1, correlated along the last axis by `colour`."""
        settling = 60
        white = generator.standard_normal((*shape[:-1], shape[-1] + settling))
        size = math.sqrt(1 - self.colour**2)
        coloured: Array = size * lfilter([1.0], [1.0, -self.colour], white, axis=-1)
        return coloured[..., settling:]

    def stored(self, signals: Signals, generator: np.random.Generator) -> tuple[Array, Array]:
        """Return the stored samples: time (n,), s, and load and sensors (1 + n_sensors, n).

        The load is in N, the sensors are in m/s or m according to `quantity`.
        """
        origin = int(np.argmin(np.abs(signals.time)))
        is_stored = slice(origin % self.decimation, None, self.decimation)
        sensors = signals.velocity if self.quantity == "velocity" else signals.displacement
        table = np.vstack([signals.load, sensors])[:, is_stored]
        peaks = np.max(np.abs(table), axis=1, keepdims=True)
        # all sensors have similar noise, although distant ones measure less motion
        peaks[1:] = np.sqrt(peaks[1:] * peaks[1])
        table = table + self.noise * peaks * self.noise_of(table.shape, generator)
        count = 4 * np.where(peaks > 0, peaks, 1.0) / 2**self.bits
        return signals.time[is_stored], np.round(table / count) * count


def write_signals(
    path: Path,
    signals: Sequence[Signals],
    offsets: Sequence[float],
    header: Mapping[str, str | float | int],
    converter: Converter,
    generator: np.random.Generator,
) -> None:
    """Write the trace file of a test point.

    Parameters
    ----------
    path : Path
        File to write.
    signals : sequence of Signals
        Signals of each drop.
    offsets : sequence of float, m
        Distances of the sensors from the plate centre.
    header : mapping
        Declared values with their keys.
    converter : Converter
        Noise, sampling and quantisation of the instrument.
    generator : numpy.random.Generator
        Source of the noise.
    """
    unit = "velocity_m_s" if converter.quantity == "velocity" else "displacement_m"
    columns = ["drop", "time_s", "load_N", *(f"{unit}@{offset:.4f}" for offset in offsets)]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        for key, value in header.items():
            # a JSON string is a TOML string; `inf` is a TOML float
            text = json.dumps(value) if isinstance(value, str) else repr(value)
            file.write(f"# {key} = {text}\n")
        file.write(",".join(columns) + "\n")
        for number, drop in enumerate(signals, start=1):
            time, table = converter.stored(drop, generator)
            rows = np.column_stack([np.full(time.size, number), time, table.T])
            formats = ["%d", "%.9g", "%.7g", *["%.9g"] * len(offsets)]
            np.savetxt(file, rows, delimiter=",", fmt=formats)
