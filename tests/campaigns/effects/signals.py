"""Signals of one drop inside a simulated instrument, before noise and conversion to counts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import cumulative_trapezoid

from simulators.drop import SimulatedDrop
from simulators.mesh import Array


@dataclass(frozen=True)
class Signals:
    """Signals of load and sensors in one drop, downward positive, before conversion to counts."""

    time: Array
    """Times (n,), s; 0 at the first touch, negative before."""
    load: Array
    """Load (n,), N."""
    velocity: Array
    """Velocities (n_sensors, n), m/s."""
    displacement: Array
    """Displacements (n_sensors, n), m, of instruments that store the integrated velocity."""

    @property
    def time_step(self) -> float:
        """Step between samples, s."""
        return float(self.time[1] - self.time[0])

    @property
    def peak_velocity(self) -> float:
        """Largest absolute velocity of the first sensor, m/s."""
        return float(np.max(np.abs(self.velocity[0])))

    @property
    def peak_load(self) -> float:
        """Largest load, N."""
        return float(np.max(self.load))

    def with_velocity(self, velocity: Array) -> Signals:
        """Return the signals with another velocity of the sensors, (n_sensors, n), m/s.

        The displacement changes by the integral of the change of velocity.
        """
        change = cumulative_trapezoid(velocity - self.velocity, dx=self.time_step, initial=0)
        return replace(self, velocity=velocity, displacement=self.displacement + change)


def signals_of(drop: SimulatedDrop, sensors: int, pre_trigger: float) -> Signals:
    """Return the signals of the sensors in a simulated drop, without errors of the instrument.

    Parameters
    ----------
    drop : SimulatedDrop
    sensors : int
        Number of sensors, from the plate centre outward.
    pre_trigger : float, s
        Time without motion before the drop.
    """
    step = float(drop.time[1] - drop.time[0])
    wait = round(pre_trigger / step)
    padding = ((0, 0), (wait, 0))
    return Signals(
        np.arange(-wait, drop.time.size, dtype=float) * step,
        np.pad(drop.load, (wait, 0)),
        np.pad(drop.ground_velocity[:sensors], padding),
        np.pad(drop.ground_displacement[:sensors], padding),
    )
