"""The model of a drop with effects: four stages, of which the slow one is remembered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from inversion.effects.base import DropContext, Effect, Ground, Values, geophone
from inversion.forward import Grounds, transfer_function
from inversion.kernel import FloatArray
from inversion.laplace import DampedTransform
from inversion.misfit import model_floor
from inversion.record import PreparedDrop, Record, prepare
from inversion.surrogate import Surrogate

# Samples of a record that the diagnosis looks at: enough for a pulse of 8 ms in a record of 0.1 s.
MOST_SAMPLES = 180
# Hz; a pulse of 8 ms has a hundredth of its spectrum left there.
_BAND_HZ = 900.0
_REMEMBERED = 12
_FLAT_SAMPLES = 4
_FLAT_OVER_SPREAD = 1.5
# The first sample is zero by construction.
_FROM_SAMPLE = 1

Active = Sequence[tuple[Effect, Values]]


@dataclass(frozen=True, eq=False)
class PointRecords:
    """The drops of a point, as they enter the diagnosis.

    Parameters
    ----------
    name : str
    records : tuple of Record, measured drops in their order, all with the same declarations
    numbers : tuple of int, of the drops
    """

    name: str
    records: tuple[Record, ...]
    numbers: tuple[int, ...]


class DropModel:
    """Predicts one record.

    Parameters
    ----------
    record : Record
    surrogate : Surrogate, for offset 0 and every sensor; for all depths, or the declared one
    largest_load : float, N, of the point's drops
    index, count : int, of the drop within the point
    """

    def __init__(
        self,
        record: Record,
        surrogate: Surrogate,
        largest_load: float,
        index: int,
        count: int,
    ) -> None:
        drop = prepare(record)
        whole = drop.with_tail()
        self.drop: PreparedDrop = whole
        self.record = record
        self._surrogate = surrogate
        # What the geophone does belongs to the record stage, behind what the ground does in time.
        self._instrument = replace(
            record.instrument, geophone_natural_frequency=None, geophone_damping=None
        )
        count_samples = int(np.searchsorted(drop.time, whole.tail_end * (1 + 1e-9)))
        stride = max(1, -(-count_samples // MOST_SAMPLES))
        self.rows = np.arange(0, count_samples, stride)
        time = drop.time[self.rows]
        band = min(_BAND_HZ, 0.5 / drop.step)
        if record.instrument.load_filter is not None:
            band = min(band, 2.0 * record.instrument.load_filter)
        transform = DampedTransform(float(time[-1]), band)
        self._s = transform.s
        spectrum = transform.of_samples(drop.time, drop.load)
        spectrum = spectrum * self._instrument.response(self._s)
        synthesis = spectrum[:, None] * transform.synthesis(time)
        self._synthesis = np.vstack([synthesis.real, -synthesis.imag])
        self.observed = drop.displacement[:, self.rows]
        self.context = DropContext(
            time=time,
            offsets=drop.offsets,
            load=drop.load[self.rows],
            peak_load=drop.peak_load,
            largest_load=largest_load,
            plate_radius=record.instrument.plate_radius,
            poisson_ratio=record.poisson_ratio,
            quantities=tuple(sensor.quantity for sensor in record.sensors),
            contact_end=drop.contact_end,
            index=index,
            count=count,
            flat=tuple(_flat_level(sensor.values) for sensor in record.sensors),
        )
        floor = model_floor(drop, record.model_floor)
        self.noise: FloatArray = np.maximum(np.maximum(whole.noise, whole.quantisation), floor)
        self.peak: FloatArray = drop.peak_displacement
        self._memory: dict[tuple[object, ...], FloatArray] = {}

    def predict(self, ground: Ground, active: Active) -> FloatArray:
        """What would be recorded, (n_sensors, n), m."""
        motion = self._linear(ground, active)
        for effect, values in active:
            motion = effect.motion(motion, values, self.context)
        instrument, step = self.record.instrument, self.context.step
        frequency, damping = instrument.geophone_natural_frequency, instrument.geophone_damping
        if frequency is not None and damping is not None:
            motion = geophone(motion, frequency, damping, step)
        for effect, values in active:
            motion = effect.record(motion, values, self.context)
        return motion

    def _linear(self, ground: Ground, active: Active) -> FloatArray:
        """Motion of the linear ground under the load."""
        for effect, values in active:
            ground = effect.ground(ground, values, self.context)
        shaping = [(e, v) for e, v in active if type(e).compliance is not Effect.compliance]
        key = (ground, *((e.name, *v.values()) for e, v in shaping))
        known = self._memory.get(key)
        if known is not None:
            return known
        grounds = Grounds(
            np.array([ground.modulus]),
            np.array([ground.viscosity]),
            np.array([ground.density]),
            np.array([ground.inverse_depth]),
        )
        instrument = replace(self._instrument, plate_mass=ground.plate_mass)
        compliance = transfer_function(self._surrogate, instrument, self._s, grounds)[0]
        compliance = compliance[-self.context.offsets.size :]
        for effect, values in shaping:
            compliance = effect.compliance(compliance, self._s, values, self.context)
        parts = np.concatenate([compliance.real, compliance.imag], axis=1)
        motion: FloatArray = parts @ self._synthesis
        if len(self._memory) >= _REMEMBERED:
            self._memory.pop(next(iter(self._memory)))
        self._memory[key] = motion
        return motion

    def window(self, *, contact_only: bool) -> slice:
        """Samples that count, of the model's."""
        if not contact_only:
            return slice(_FROM_SAMPLE, self.rows.size)
        end = int(np.searchsorted(self.context.time, self.drop.contact_end * (1 + 1e-9)))
        return slice(_FROM_SAMPLE, max(end, _FROM_SAMPLE + 8))

    def residual_over_peak(self, predicted: FloatArray, *, contact_only: bool) -> float:
        """Rms over all sensors, each over its own peak, from the trigger on."""
        part = self.context.time >= self.drop.trigger
        if contact_only:
            part &= self.context.time <= self.drop.contact_end * (1 + 1e-9)
        left = (predicted - self.observed)[:, part] / self.peak[:, None]
        return float(np.sqrt(np.mean(left**2)))


def _flat_level(values: FloatArray) -> float | None:
    """Largest level, of either sign, at which a record is flat over several samples; None: none."""
    inner = values[1:-1]
    for signed in (inner, -inner):
        top = float(signed.max())
        flat = signed >= top - 1e-9 * abs(top)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], flat, [False]]).astype(np.int8)))
        longest = int(np.max(edges[1::2] - edges[::2])) if edges.size else 0
        if longest >= _FLAT_SAMPLES and top > _FLAT_OVER_SPREAD * float(np.std(inner)):
            return top
    return None
