"""The model of a drop with effects: five stages, of which the slow one is remembered."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from inversion.arrays import ComplexArray, FloatArray
from inversion.diagnosis.channel import MotionChannel
from inversion.diagnosis.flat_tops import REST_SAMPLES, flat_level, flat_velocity
from inversion.diagnosis.ground_response import GroundResponse
from inversion.effects.base import DropContext, Effect, Ground, Values, geophone
from inversion.fitting.layered.first_look import FirstLook
from inversion.fitting.misfit import model_floor
from inversion.forward.laplace import DampedTransform
from inversion.forward.nonlinear_stiffness import (
    NonlinearStiffness,
    convolve_rows,
    effective_force,
    forces_nearby,
    hat_response,
)
from inversion.forward.surrogate import Surrogate
from inversion.measured.half_sine import fit_half_sine
from inversion.measured.record import PreparedDrop, Record, prepare

# Samples of a record that the diagnosis looks at: enough for a pulse of 8 ms in a record of 0.1 s.
MOST_SAMPLES = 180
# Hz; a pulse of 8 ms has a hundredth of its spectrum left there.
_BAND_HZ = 900.0
_REMEMBERED = 24
# 1/s; slow enough for the ground to be at rest.
_STILL = 1e-3
# The first sample is zero by construction.
_FROM_SAMPLE = 1
# Independent samples per second and sensor: twice the band in which ground and geophone move.
INDEPENDENT_HZ = 800.0
# The deflection has its peak within so many contact times.
_SOON = 1.3

Active = Sequence[tuple[Effect, Values]]
_Motion = tuple[FloatArray, FloatArray | None]


@dataclass(frozen=True)
class _Stages:
    """The ground of a drop with what its effects make of it.

    Parameters
    ----------
    key : tuple, tells it from others
    ground : Ground
    law : NonlinearStiffness
    shaping : effects that shape the compliance, with their values
    """

    key: tuple[object, ...]
    ground: Ground = field(compare=False)
    law: NonlinearStiffness = field(compare=False)
    shaping: Active = field(compare=False)


@dataclass(frozen=True)
class FitScope:
    """What of a record counts for a fit, and how.

    Parameters
    ----------
    contact_only : bool, no more than the contact phase
    plain : bool, every sample from the pulse on alike, as if the noise were white
    """

    contact_only: bool = False
    plain: bool = False


WHOLE = FitScope()


@dataclass(frozen=True, eq=False)
class PointRecords:
    """The drops of a point, as they enter the diagnosis.

    Parameters
    ----------
    name : str
    records : tuple of Record, measured drops in their order, all with the same declarations
    numbers : tuple of int, of the drops
    elastic : bool, whether the base model has no dashpot
    half_sine : bool, whether a half-sine stands in for the measured load
    """

    name: str
    records: tuple[Record, ...]
    numbers: tuple[int, ...]
    elastic: bool = False
    half_sine: bool = False


class DropModel:
    """Predicts one record.

    Parameters
    ----------
    record : Record
    surrogate : Surrogate, for offset 0 and every sensor; for all depths, or the declared one
    largest_load : float, N, of the point's drops
    index : int, of the drop within the point
    point : PointRecords
    layers : FirstLook or None, the point's drops as layered ground
    response : GroundResponse or None, which the drops of a point share
    duration : float or None, s, of the longest record of the point: what is shared has one length
    """

    def __init__(
        self,
        record: Record,
        surrogate: Surrogate,
        largest_load: float,
        index: int,
        point: PointRecords,
        layers: FirstLook | None = None,
        response: GroundResponse | None = None,
        duration: float | None = None,
    ) -> None:
        # The surrogate answers in this order, whatever order the record has.
        record = record.nearest_first()
        drop = prepare(record)
        self._layers = layers
        whole = drop.with_tail()
        self.drop: PreparedDrop = whole
        self.record = record
        # What the geophone does belongs to the record stage, behind what the ground does in time.
        self._instrument = replace(
            record.instrument, geophone_natural_frequency=None, geophone_damping=None
        )
        self.response = response or GroundResponse(surrogate, self._instrument, drop.offsets)
        self._duration = duration
        count_samples = int(np.searchsorted(drop.time, whole.tail_end * (1 + 1e-9)))
        stride = max(1, -(-count_samples // MOST_SAMPLES))
        self.rows = np.arange(0, count_samples, stride)
        load = fit_half_sine(drop.time, drop.load).load(drop.time) if point.half_sine else drop.load
        self._prepare_transform(load)
        first = int(np.searchsorted(record.time, drop.start - 0.5 * drop.step))
        # Samples before the pulse, where nothing moves but drift, hum and noise show.
        self.before = first // stride
        samples = first + np.concatenate([np.arange(-self.before, 0) * stride, self.rows])
        self.channels = tuple(
            MotionChannel(sensor, noise, first, samples, drop.step)
            for sensor, noise in zip(record.sensors, drop.channels, strict=True)
        )
        self._everywhere = np.stack([channel.observed for channel in self.channels])
        self.observed = self._everywhere[:, self.before :]
        self.context = self._make_context(load, largest_load, index, point)
        self._recorded = replace(self.context, time=drop.step * (samples - first))
        floor = model_floor(whole, record.model_floor)
        self.noise: FloatArray = np.maximum(np.maximum(whole.noise, whole.quantisation), floor)
        self._floor = floor
        self._whiteners: dict[FitScope, tuple[FloatArray, ...]] = {}
        self.peak: FloatArray = drop.peak_displacement
        self._memory: dict[tuple[object, ...], ComplexArray] = {}
        self._motions: dict[tuple[object, ...], _Motion] = {}
        self._last_displacement: FloatArray | None = None
        self._plate = int(np.argmin(self.context.offsets))
        self._under_plate = self.context.offsets < self.context.plate_radius
        self.nonlinear_solves = 0
        """How often nonlinear ground was solved for: six times the work of linear ground."""

    def _prepare_transform(self, load: FloatArray) -> None:
        """From compliances at Laplace frequencies to motions under the load, and under a ramp."""
        time = self.drop.time[self.rows]
        band = min(_BAND_HZ, 0.5 / self.drop.step)
        if self.record.instrument.load_filter is not None:
            band = min(band, 2.0 * self.record.instrument.load_filter)
        transform = DampedTransform(self._duration or float(time[-1]), band)
        self._s = transform.s
        spectrum = transform.of_samples(self.drop.time, load)
        spectrum = spectrum * self._instrument.response(self._s)
        synthesis = spectrum[:, None] * transform.synthesis(time)
        self._synthesis = np.vstack([synthesis.real, -synthesis.imag])
        ramp = transform.synthesis(time) / self._s[:, None] ** 2
        self._ramp = np.vstack([ramp.real, -ramp.imag])

    def _make_context(
        self, load: FloatArray, largest_load: float, index: int, point: PointRecords
    ) -> DropContext:
        """What effects may know of the drop."""
        drop, record = self.drop, self.record
        noises = [channel.model.rms for channel in drop.channels]
        return DropContext(
            time=drop.time[self.rows],
            offsets=drop.offsets,
            load=load[self.rows],
            peak_load=drop.peak_load,
            largest_load=largest_load,
            plate_radius=record.instrument.plate_radius,
            poisson_ratio=record.poisson_ratio,
            quantities=tuple(sensor.quantity for sensor in record.sensors),
            contact_end=drop.contact_end,
            index=index,
            count=len(point.records),
            elastic=point.elastic,
            density_given=record.density is not None,
            load_left=(drop.load - load)[self.rows] if point.half_sine else None,
            layers=self._layers,
            plate_mass=record.instrument.plate_mass,
            has_bedrock=record.bedrock_depth is not None and not np.isinf(record.bedrock_depth),
            flat=tuple(
                flat_velocity(sensor, noise, drop.step, drop.peak_load >= largest_load)
                for sensor, noise in zip(record.sensors, noises, strict=True)
            ),
            flat_load=flat_level(
                record.load - np.median(record.load[:REST_SAMPLES]), drop.load_noise.rms, both=False
            ),
            rest=tuple(float(np.median(sensor.values[:REST_SAMPLES])) for sensor in record.sensors),
        )

    def predict(self, ground: Ground, active: Active) -> FloatArray:
        """What would be recorded, (n_sensors, n), m; the samples before the pulse stand first."""
        stages = self._stages(ground, active)
        motion = self._ground_motion(stages)
        for effect, values in active:
            motion = effect.motion(
                motion, values, self.context, partial(self._impulse_response, stages)
            )
        found: FloatArray = self._read(self._record(motion[None], active))[0]
        return found

    def _record(self, motions: FloatArray, active: Active) -> FloatArray:
        """Motions (m, n_sensors, n) as sensors and processing show them, m.

        Effects that treat every row alike see all of them at once.
        """
        count, sensors, size = motions.shape
        records = np.zeros((count, sensors, self.before + size))
        records[:, :, self.before :] = motions
        rows = records.reshape(count * sensors, -1)
        instrument, step = self.record.instrument, self.context.step
        frequency, damping = instrument.geophone_natural_frequency, instrument.geophone_damping
        if frequency is not None and damping is not None:
            rows = geophone(rows, frequency, damping, step)
        for effect, values in active:
            if type(effect).record is Effect.record:
                continue
            if effect.rows_alike:
                rows = effect.record(rows, values, self._recorded)
            else:
                each = [
                    effect.record(record, values, self._recorded)
                    for record in rows.reshape(count, sensors, -1)
                ]
                rows = np.concatenate(each)
        return rows.reshape(count, sensors, -1)

    def _read(self, records: FloatArray) -> FloatArray:
        """Records (m, n_sensors, n) as their displacements come out."""
        return np.stack(
            [channel.read(records[:, row]) for row, channel in enumerate(self.channels)], axis=1
        )

    def predict_nearby(
        self, ground: Ground, active: Active, moved: Sequence[tuple[Ground, Active]]
    ) -> FloatArray:
        """`predict` for what is a small step away, (m, n_sensors, n), m.

        The ground's responses come by derivatives (`GroundResponse.prime`), nonlinear resistance
        by one step of Newton's method for all, and each stage is gone through once where its
        effects are as they were.
        """
        self.predict(ground, active)
        motions = self._motions_nearby(ground, active, moved)
        here = _of_stage(active, "record")
        result = np.empty((len(moved), *self._everywhere.shape))
        stages = [_of_stage(other, "record") for _, other in moved]
        alike = [i for i, stage in enumerate(stages) if stage == here]
        if alike:
            result[alike] = self._read(self._record(motions[alike], active))
        for index, (_, other) in enumerate(moved):
            if stages[index] != here:
                result[index] = self._read(self._record(motions[index][None], other))[0]
        return result

    def _motions_nearby(
        self, ground: Ground, active: Active, moved: Sequence[tuple[Ground, Active]]
    ) -> FloatArray:
        """Motions of the ground a small step away, (m, n_sensors, n), m."""
        start = self._stages(ground, active)
        stages = [self._stages(*other) for other in moved]
        self.response.prime(start.ground, [stage.ground for stage in stages], self._s)
        nonlinear = not start.law.linear or any(not stage.law.linear for stage in stages)
        if nonlinear:
            at_rest = np.array([(0.0 if start.ground.above else _STILL) + 0j])
            self.response.prime(start.ground, [stage.ground for stage in stages], at_rest)
        unique = list(dict.fromkeys([start, *stages]))
        compliances = [self._compliance(u.ground, u.shaping, self._s) for u in unique]
        parts = np.stack([np.concatenate([c.real, c.imag], axis=1) for c in compliances])
        found: FloatArray = parts @ self._synthesis
        forced = any(type(effect).motion is not Effect.motion for effect, _ in active)
        hats: FloatArray = np.zeros_like(found)
        if nonlinear or forced:
            hats = hat_response(
                (parts @ self._ramp).reshape(-1, self._ramp.shape[1]), self.context.step
            ).reshape(found.shape)
        if nonlinear and len(unique) > 1:
            found = self._bent_nearby(unique, found, hats)
        elif nonlinear:
            found = self._ground_motion(start)[None]
        by_stage = {stage: index for index, stage in enumerate(unique)}
        result = np.empty((len(moved), *found.shape[1:]))
        for row, stage, (_, other) in zip(result, stages, moved, strict=True):
            motion = found[by_stage[stage]]
            impulse = partial(np.divide, hats[by_stage[stage]], self.context.step)
            for effect, values in other:
                if type(effect).motion is not Effect.motion:
                    motion = effect.motion(motion, values, self.context, impulse)
            row[:] = motion
        return result

    def _bent_nearby(
        self, stages: Sequence[_Stages], motions: FloatArray, hats: FloatArray
    ) -> FloatArray:
        """Motions (m, n_sensors, n) of linear grounds with their nonlinear resistance.

        The first is the ground that was solved for; `hats` as `hat_response` gives them.
        """
        load, plate = self.context.load, self._plate
        self._ground_motion(stages[0])
        motion, solution = self._motions[stages[0].key]
        if solution is None:
            solution = convolve_rows(hats[0, plate], load)
        laws = []
        for stage in stages:
            stiffness = self._static_stiffness(stage)
            laws.append((stage.law, stiffness, self.context.largest_load / stiffness))
        forces = forces_nearby(
            hats[0, plate],
            load,
            laws[0],
            solution,
            [(hat[plate], *law) for hat, law in zip(hats[1:], laws[1:], strict=True)],
        )
        change = np.zeros_like(motions)
        change[1:, self._under_plate] = (forces - load)[:, None]
        result = motions + convolve_rows(hats, change)
        result[0] = motion
        return result

    def _stages(self, ground: Ground, active: Active) -> _Stages:
        """What the ground does: its parameters, its law, and what shapes its compliance."""
        law = NonlinearStiffness()
        for effect, values in active:
            ground = effect.ground(ground, values, self.context)
            law = effect.nonlinear_stiffness(law, values, self.context)
        shaping = [(e, v) for e, v in active if type(e).compliance is not Effect.compliance]
        key = (ground, law, *((e.name, *v.values()) for e, v in shaping))
        return _Stages(key, ground, law, shaping)

    def _ground_motion(self, stages: _Stages) -> FloatArray:
        """Motion of the ground, whose static resistance may be nonlinear.

        Remembered, because later effects are tried many times on the same motion.
        """
        known = self._motions.get(stages.key)
        if known is not None:
            return known[0]
        compliance = self._compliance(stages.ground, stages.shaping, self._s)
        parts = np.concatenate([compliance.real, compliance.imag], axis=1)
        motion: FloatArray = parts @ self._synthesis
        solution = None
        if not stages.law.linear:
            bent, solution = self._nonlinear_motion(parts, stages)
            motion = motion + bent
        if len(self._motions) >= _REMEMBERED:
            self._motions.pop(next(iter(self._motions)))
        self._motions[stages.key] = motion, solution
        return motion

    def _impulse_response(self, stages: _Stages) -> FloatArray:
        """Motion after an impulse of 1 N s on the plate, (n_sensors, n), m."""
        compliance = self._compliance(stages.ground, stages.shaping, self._s)
        parts = np.concatenate([compliance.real, compliance.imag], axis=1)
        return hat_response(parts @ self._ramp, self.context.step) / self.context.step

    def _static_stiffness(self, stages: _Stages) -> float:
        """Of the linear ground, N/m."""
        still = np.array([(0.0 if stages.ground.above else _STILL) + 0j])
        compliance = self._compliance(stages.ground, stages.shaping, still)
        return 1.0 / float(compliance[self._plate, 0].real)

    def _nonlinear_motion(
        self, parts: FloatArray, stages: _Stages
    ) -> tuple[FloatArray, FloatArray]:
        """What the nonlinear static resistance adds to the motion of the linear ground.

        And the displacement of the plate that it was solved for, (n,), m.
        """
        self.nonlinear_solves += 1
        stiffness = self._static_stiffness(stages)
        hats = hat_response(parts @ self._ramp, self.context.step)
        load = self.context.load
        reference = self.context.largest_load / stiffness
        force, solution = effective_force(
            hats[self._plate], load, stages.law, stiffness, reference, self._last_displacement
        )
        self._last_displacement = solution
        # What the samples of the load leave out is small and linear: it stays in the motion.
        change = np.zeros_like(hats)
        # Ground beside the plate feels the force on it, not how far it deflects under it.
        change[self._under_plate] = force - load
        return convolve_rows(hats, change), solution

    def _compliance(self, ground: Ground, shaping: Active, s: ComplexArray) -> ComplexArray:
        """Displacement over load at every sensor, (n_sensors, n), m/N."""
        key = (s.size, ground, *((e.name, *v.values()) for e, v in shaping))
        known = self._memory.get(key)
        if known is not None:
            return known
        compliance = self.response.compliance(ground, s)
        for effect, values in shaping:
            compliance = effect.compliance(compliance, s, values, self.context)
        if len(self._memory) >= _REMEMBERED:
            self._memory.pop(next(iter(self._memory)))
        self._memory[key] = compliance
        return compliance

    @property
    def peak_in_contact(self) -> float:
        """Largest deflection of the innermost sensor until shortly after the contact, m."""
        row = self.observed[int(np.argmin(self.context.offsets))]
        return float(row[self.context.time <= _SOON * self.context.contact_end].max())

    def independent(self, scope: FitScope = WHOLE) -> float:
        """Number of independent samples that count, all sensors."""
        part = self._part(scope)
        count = part.stop - part.start
        seconds = count * self.context.step
        return float(min(max(INDEPENDENT_HZ * seconds, 8.0), count) * self.observed.shape[0])

    def weighted_residual(
        self, predicted: FloatArray, scope: FitScope = WHOLE, silent: Collection[int] = ()
    ) -> FloatArray:
        r"""What a prediction leaves, (n,): noise would leave a sum of squares of `independent`.

        Noise is coloured: a velocity's becomes a random walk when it is integrated, whose slow
        part must not be taken for an effect. With C the covariance of noise, quantisation and
        the model's own error, the residual is :math:`\sqrt{N/n} L^{-1} r`, :math:`L L^T = C`,
        N of n samples being independent as far as the model's own error goes. Sensors that are
        ``silent`` count for nothing.
        """
        found: FloatArray = self.weighted_residuals(predicted[None], scope, silent)[0]
        return found

    def weighted_residuals(
        self, predicted: FloatArray, scope: FitScope = WHOLE, silent: Collection[int] = ()
    ) -> FloatArray:
        """`weighted_residual` of many predictions (m, n_sensors, before + n), (m, n)."""
        part = self._part(scope)
        left = (predicted - self._everywhere)[:, :, part]
        left[:, list(silent)] = 0.0
        share = np.sqrt(self.independent(scope) / left[0].size)
        if scope.plain:
            plain: FloatArray = share * (left / self.noise[:, None])
            return plain.reshape(left.shape[0], -1)
        parts = [
            share * (left[:, row] @ whitener.T)
            for row, whitener in enumerate(self._whiteners_of(scope, part))
        ]
        return np.concatenate(parts, axis=1)

    def _whiteners_of(self, scope: FitScope, part: slice) -> tuple[FloatArray, ...]:
        """Of each sensor, see `MotionChannel.whitener`."""
        known = self._whiteners.get(scope)
        if known is not None:
            return known
        moving = (np.arange(part.start, part.stop) >= self.before).astype(float)
        # Too short a rest tells no noise: then it counts no more than the rest of the record.
        found = tuple(
            channel.whitener(
                part,
                np.hypot(
                    floor * (moving if noise.model.samples else np.ones_like(moving)), quantum
                ),
            )
            for channel, noise, floor, quantum in zip(
                self.channels, self.drop.channels, self._floor, self.drop.quantisation, strict=True
            )
        )
        self._whiteners[scope] = found
        return found

    def weighted_size(self, scope: FitScope = WHOLE) -> int:
        """Number of values that `weighted_residual` gives."""
        part = self._part(scope)
        return int((part.stop - part.start) * self.observed.shape[0])

    def _part(self, scope: FitScope) -> slice:
        """Samples that count for a fit, those before the pulse among them unless all are alike."""
        window = self.window(contact_only=scope.contact_only)
        return slice(self.before + window.start if scope.plain else 0, self.before + window.stop)

    def window(self, *, contact_only: bool) -> slice:
        """Samples that count, of the model's."""
        if not contact_only:
            return slice(_FROM_SAMPLE, self.rows.size)
        end = int(np.searchsorted(self.context.time, self.drop.contact_end * (1 + 1e-9)))
        return slice(_FROM_SAMPLE, max(end, _FROM_SAMPLE + 8))

    def residual_over_peak(
        self, predicted: FloatArray, *, contact_only: bool, sensors: Sequence[int] | None = None
    ) -> float:
        """Rms over all sensors, or some, each over its own peak, from the trigger on."""
        part = self.context.time >= self.drop.trigger
        if contact_only:
            part &= self.context.time <= self.drop.contact_end * (1 + 1e-9)
        left = (predicted - self.observed)[:, part] / self.peak[:, None]
        chosen = left if sensors is None else left[list(sensors)]
        return float(np.sqrt(np.mean(chosen**2)))


def _of_stage(active: Active, stage: str) -> list[tuple[object, ...]]:
    """Effects of one stage with their values, to be compared."""
    base = getattr(Effect, stage)
    return [(e.name, *v.values()) for e, v in active if getattr(type(e), stage) is not base]
