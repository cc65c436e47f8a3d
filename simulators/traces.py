r"""Simulated drops as an instrument would record them, written as a trace file.

A trace file is a text file with a header of declared values and a table of samples. Its header has
the values that an operator knows of the instrument, and never the simulated ground. Noise,
quantisation, samples before the trigger and the response of a geophone are added here, as
`simulators.drop` computes ideal signals.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import expm

from pfwd_plugins.quantities import Measurand, MotionName, motion
from simulators.drop import SimulatedDrop
from simulators.mesh import Array, Plate, require

FORMAT_VERSION = 1


@dataclass(frozen=True)
class Geophone:
    """Properties of a geophone, which acts as a second-order high-pass of the velocity."""

    natural_frequency: float
    """Natural frequency, Hz, > 0."""
    damping: float
    """Damping as a fraction of critical damping, >= 0."""


@dataclass(frozen=True)
class Recording:
    """Properties of a simulated instrument that alter the true signals."""

    quantity: MotionName = "velocity"
    """Quantity of the sensor channels."""
    pre_trigger: float = 0.015
    """Recorded rest before the first touch, s."""
    load_noise: float = 0.0
    """Root mean square of white noise on the load, N."""
    sensor_noise: float | tuple[float, ...] = 0.0
    """Noise of the sensors, one value for all or one each, m/s or m."""
    load_resolution: float = 0.0
    """Load per count of the converter, N; 0: not quantised."""
    sensor_resolution: float = 0.0
    """Reading of the sensors per count, m/s or m; 0: not quantised."""
    geophone: Geophone | None = None
    """Geophone whose response is in the velocities; None: the record is corrected."""


@dataclass(frozen=True)
class SensedDrop:
    """Recorded channels of one drop, with the errors of the instrument."""

    time: Array
    """Times (n,), s; 0 at the first touch, negative before."""
    load: Array
    """Load (n,), N."""
    sensors: Array
    """Signals of the sensors (n_offsets, n), m/s or m."""


def geophone_output(velocity: Array, time_step: float, geophone: Geophone) -> Array:
    r"""Return the output of a geophone, for ground at rest before the first sample.

    .. math::
        \ddot x + 2 \zeta \omega_0 \dot x + \omega_0^2 x = v, \qquad
        y = v - 2 \zeta \omega_0 \dot x - \omega_0^2 x
        \quad\Leftrightarrow\quad Y/V = s^2 / (s^2 + 2 \zeta \omega_0 s + \omega_0^2)

    The state equation is solved exactly for a velocity that is linear between samples
    (first-order hold, by one matrix exponential).

    Parameters
    ----------
    velocity : (..., n) ndarray of float, m/s
    time_step : float, s

    Returns
    -------
    (..., n) ndarray of float, m/s
    """
    omega = 2 * math.pi * geophone.natural_frequency
    friction = 2 * geophone.damping * omega
    system = np.zeros((4, 4))  # x, dx/dt, v, v(next) - v
    system[0, 1] = 1.0
    system[1] = [-(omega**2), -friction, 1.0, 0.0]
    system[2, 3] = 1 / time_step
    step = expm(system * time_step)[:2]
    output = np.array(velocity, dtype=float)
    state = np.zeros((*output.shape[:-1], 2))
    for k in range(output.shape[-1]):
        if k > 0:
            before, change = velocity[..., k - 1], velocity[..., k] - velocity[..., k - 1]
            state = state @ step[:, :2].T
            state = state + before[..., None] * step[:, 2] + change[..., None] * step[:, 3]
        output[..., k] -= omega**2 * state[..., 0] + friction * state[..., 1]
    return output


def record_drop(
    drop: SimulatedDrop, recording: Recording, generator: np.random.Generator
) -> SensedDrop:
    """Return a simulated drop as an instrument records it.

    Samples at rest before the trigger, the response of the geophone, noise and quantisation are
    added.

    Parameters
    ----------
    drop : SimulatedDrop
    recording : Recording
        Properties of the instrument.
    generator : numpy.random.Generator
        Source of the noise.
    """
    time_step = float(drop.time[1] - drop.time[0])
    wait = round(recording.pre_trigger / time_step)
    quantity = motion(recording.quantity)
    is_velocity = quantity is Measurand.VELOCITY
    require(
        is_velocity or recording.geophone is None, "geophone", "velocity channels", quantity.value
    )
    match quantity:
        case Measurand.DISPLACEMENT:
            signals = drop.ground_displacement
        case Measurand.ACCELERATION:
            signals = CubicSpline(drop.time, drop.ground_velocity, axis=1).derivative()(drop.time)
        case _:
            signals = drop.ground_velocity
    sensors = np.pad(signals, ((0, 0), (wait, 0)))
    load = np.pad(drop.load, (wait, 0))
    if recording.geophone is not None:
        sensors = geophone_output(sensors, time_step, recording.geophone)
    noise = np.broadcast_to(np.asarray(recording.sensor_noise, dtype=float), len(sensors))
    load = load + recording.load_noise * generator.standard_normal(load.size)
    sensors = sensors + noise[:, None] * generator.standard_normal(sensors.shape)
    return SensedDrop(
        np.arange(-wait, drop.time.size, dtype=float) * time_step,
        _quantised(load, recording.load_resolution),
        _quantised(sensors, recording.sensor_resolution),
    )


def write_traces(
    path: Path,
    drops: Sequence[SimulatedDrop],
    plate: Plate,
    poisson_ratio: float,
    recording: Recording | None = None,
    seed: int = 0,
    declared: Mapping[str, str | float | int] | None = None,
) -> Path:
    """Write the trace file of one test point and return its path.

    Parameters
    ----------
    path : Path
        File to write; an existing file is replaced.
    drops : sequence of SimulatedDrop
        One drop or more, with equal times and offsets.
    plate : Plate
        Plate whose radius and mass are in the header.
    poisson_ratio : float
        Poisson's ratio that the operator assumes.
    recording : Recording, optional
        Properties of the instrument; by default an ideal one.
    seed : int
        Seed of the noise.
    declared : mapping, optional
        Further keys of the header, for example `bedrock_depth_m`, `device`, `site`.
    """
    recording = recording or Recording()
    require(len(drops) > 0, "drops", "at least one", drops)
    for drop in drops:
        same = np.array_equal(drop.offsets, drops[0].offsets)
        require(same, "offsets", "the same in every drop", drop.offsets)
    header: dict[str, str | float | int] = {
        "pfwd-traces": FORMAT_VERSION,
        "plate_radius_m": plate.radius,
        "plate_mass_kg": plate.mass,
        "poisson_ratio": poisson_ratio,
    }
    if recording.geophone is not None:
        header["geophone_natural_frequency_hz"] = recording.geophone.natural_frequency
        header["geophone_damping"] = recording.geophone.damping
    elif motion(recording.quantity) is Measurand.VELOCITY:
        header["geophone_natural_frequency_hz"] = 0.0  # corrected
    header.update(declared or {})
    column = motion(recording.quantity).column
    columns = ["drop", "time_s", "load_N", *(f"{column}@{r:.4f}" for r in drops[0].offsets)]
    generator = np.random.default_rng(seed)
    with path.open("w", encoding="utf-8", newline="\n") as file:
        for key, value in header.items():
            # A JSON string is a TOML string; `inf` and `nan` are TOML floats.
            text = json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)
            file.write(f"# {key} = {text}\n")
        file.write(",".join(columns) + "\n")
        for number, drop in enumerate(drops, start=1):
            record = record_drop(drop, recording, generator)
            index = np.full(record.time.size, number)
            table = np.column_stack([index, record.time, record.load, record.sensors.T])
            formats = ["%d", "%.9g", "%.7g", *["%.9g"] * len(record.sensors)]
            np.savetxt(file, table, delimiter=",", fmt=formats)
    return path


def _quantised(signal: Array, resolution: float) -> Array:
    return signal if resolution == 0 else np.round(signal / resolution) * resolution
