"""The model of a drop with effects: five stages, of which the slow one is remembered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from inversion.effects.base import DropContext, Effect, Ground, Values, geophone
from inversion.effects.parallel import Bending, effective_force, hat_response
from inversion.forward import Grounds, transfer_function
from inversion.kernel import ComplexArray, FloatArray
from inversion.laplace import DampedTransform
from inversion.misfit import model_floor
from inversion.record import PreparedDrop, Record, prepare
from inversion.surrogate import Surrogate

# Samples of a record that the diagnosis looks at: enough for a pulse of 8 ms in a record of 0.1 s.
MOST_SAMPLES = 180
# Hz; a pulse of 8 ms has a hundredth of its spectrum left there.
_BAND_HZ = 900.0
_REMEMBERED = 24
# 1/s; slow enough for the ground to be at rest.
_STILL = 1e-3
# Samples at the start whose middle is the offset of a channel.
_REST = 16
# A top is flat within so many times the noise, or this part of it, over at least so many samples;
# it is cut off when it is left so much more steeply than a rounded one.
_FLAT_SAMPLES = 4
_FLAT_NOISE, _FLAT_PART = 5.0, 0.015
_STEEPER = 2.5
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
        ramp = transform.synthesis(time) / self._s[:, None] ** 2
        self._ramp = np.vstack([ramp.real, -ramp.imag])
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
            flat=tuple(
                _flat_level(sensor.values - np.median(sensor.values[:_REST]), channel.model.rms)
                for sensor, channel in zip(record.sensors, drop.channels, strict=True)
            ),
        )
        floor = model_floor(drop, record.model_floor)
        self.noise: FloatArray = np.maximum(np.maximum(whole.noise, whole.quantisation), floor)
        self.peak: FloatArray = drop.peak_displacement
        self._memory: dict[tuple[object, ...], ComplexArray] = {}

    def predict(self, ground: Ground, active: Active) -> FloatArray:
        """What would be recorded, (n_sensors, n), m."""
        motion = self._linear(ground, active)
        motion = self._bent(motion, ground, active)
        for effect, values in active:
            motion = effect.motion(motion, values, self.context)
        instrument, step = self.record.instrument, self.context.step
        frequency, damping = instrument.geophone_natural_frequency, instrument.geophone_damping
        if frequency is not None and damping is not None:
            motion = geophone(motion, frequency, damping, step)
        for effect, values in active:
            motion = effect.record(motion, values, self.context)
        return motion

    def _bent(self, motion: FloatArray, ground: Ground, active: Active) -> FloatArray:
        """The motion of ground whose static resistance bends, from that of the linear one."""
        bending = Bending()
        for effect, values in active:
            bending = effect.bending(bending, values, self.context)
        if bending.straight:
            return motion
        compliance = self._compliance(ground, active, self._s)
        still = self._compliance(ground, active, np.array([_STILL + 0j]))
        plate = int(np.argmin(self.context.offsets))
        stiffness = 1.0 / float(still[plate, 0].real)
        parts = np.concatenate([compliance.real, compliance.imag], axis=1)
        hats = hat_response(parts @ self._ramp, self.context.step)
        load = self.context.load
        reference = self.context.largest_load / stiffness
        force = effective_force(hats[plate], load, bending, stiffness, reference)
        # What the samples of the load leave out is small and linear: it stays in the motion.
        change = force - load
        moved = np.stack([np.convolve(hat, change)[: load.size] for hat in hats])
        bent: FloatArray = motion + moved
        return bent

    def _compliance(self, ground: Ground, active: Active, s: ComplexArray) -> ComplexArray:
        """Displacement over load at every sensor, (n_sensors, n), m/N."""
        for effect, values in active:
            ground = effect.ground(ground, values, self.context)
        shaping = [(e, v) for e, v in active if type(e).compliance is not Effect.compliance]
        key = (s.size, ground, *((e.name, *v.values()) for e, v in shaping))
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
        every = transfer_function(self._surrogate, instrument, s, grounds)[0]
        compliance: ComplexArray = every[-self.context.offsets.size :]
        for effect, values in shaping:
            compliance = effect.compliance(compliance, s, values, self.context)
        if len(self._memory) >= _REMEMBERED:
            self._memory.pop(next(iter(self._memory)))
        self._memory[key] = compliance
        return compliance

    def _linear(self, ground: Ground, active: Active) -> FloatArray:
        """Motion of the linear ground under the load."""
        compliance = self._compliance(ground, active, self._s)
        parts = np.concatenate([compliance.real, compliance.imag], axis=1)
        motion: FloatArray = parts @ self._synthesis
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


def _flat_level(values: FloatArray, noise: float) -> float | None:
    """Level at which a record is cut off; None: it is not.

    The samples within a narrow band below the largest one are many, and the record leaves the band
    far more steeply than a rounded top of that width does: a parabola that falls by the band b
    within half the width n leaves it with a slope of 4 b / n.
    """
    for signed in (values, -values):
        top = int(np.argmax(signed))
        level = float(signed[top])
        band = max(_FLAT_NOISE * noise, _FLAT_PART * level)
        near = signed > level - band
        first, last = top, top
        while first > 0 and near[first - 1]:
            first -= 1
        while last < signed.size - 1 and near[last + 1]:
            last += 1
        width = last - first + 1
        if width < _FLAT_SAMPLES or first < 2 or last + 2 >= signed.size:
            continue
        rounded = 4.0 * band / width
        rise = 0.5 * (signed[first] - signed[first - 2])
        fall = 0.5 * (signed[last] - signed[last + 2])
        if min(rise, fall) > _STEEPER * rounded:
            return float(np.median(signed[first : last + 1]))
    return None
