"""The model of a drop with effects: five stages, of which the slow one is remembered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
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
from inversion.forward.nonlinear_stiffness import NonlinearStiffness, effective_force, hat_response
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
        self._motions: dict[tuple[object, ...], FloatArray] = {}
        self._last_displacement: FloatArray | None = None
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
        motion = self._ground_motion(ground, active)
        for effect, values in active:
            motion = effect.motion(
                motion, values, self.context, partial(self._impulse_response, ground, active)
            )
        motion = np.concatenate([np.zeros((motion.shape[0], self.before)), motion], axis=1)
        instrument, step = self.record.instrument, self.context.step
        frequency, damping = instrument.geophone_natural_frequency, instrument.geophone_damping
        if frequency is not None and damping is not None:
            motion = geophone(motion, frequency, damping, step)
        for effect, values in active:
            motion = effect.record(motion, values, self._recorded)
        return np.stack(
            [channel.read(row) for channel, row in zip(self.channels, motion, strict=True)]
        )

    def prime(self, ground: Ground, active: Active, moved: Sequence[tuple[Ground, Active]]) -> None:
        """Have the ground's responses a small step away ready, see `GroundResponse.prime`."""
        here = self._under(ground, active)
        there = [self._under(*other) for other in moved]
        self.response.prime(here, there, self._s)

    def _under(self, ground: Ground, active: Active) -> Ground:
        """The ground with what effects make of it."""
        for effect, values in active:
            ground = effect.ground(ground, values, self.context)
        return ground

    def _ground_motion(self, ground: Ground, active: Active) -> FloatArray:
        """Motion of the ground, whose static resistance may be nonlinear.

        Remembered, because later effects are tried many times on the same motion.
        """
        law = NonlinearStiffness()
        for effect, values in active:
            ground = effect.ground(ground, values, self.context)
            law = effect.nonlinear_stiffness(law, values, self.context)
        shaping = [(e, v) for e, v in active if type(e).compliance is not Effect.compliance]
        key = (ground, law, *((e.name, *v.values()) for e, v in shaping))
        known = self._motions.get(key)
        if known is not None:
            return known
        compliance = self._compliance(ground, shaping, self._s)
        parts = np.concatenate([compliance.real, compliance.imag], axis=1)
        motion: FloatArray = parts @ self._synthesis
        if not law.linear:
            self.nonlinear_solves += 1
            motion = motion + self._nonlinear_motion(parts, ground, shaping, law)
        if len(self._motions) >= _REMEMBERED:
            self._motions.pop(next(iter(self._motions)))
        self._motions[key] = motion
        return motion

    def _impulse_response(self, ground: Ground, active: Active) -> FloatArray:
        """Motion after an impulse of 1 N s on the plate, (n_sensors, n), m."""
        for effect, values in active:
            ground = effect.ground(ground, values, self.context)
        shaping = [(e, v) for e, v in active if type(e).compliance is not Effect.compliance]
        compliance = self._compliance(ground, shaping, self._s)
        parts = np.concatenate([compliance.real, compliance.imag], axis=1)
        return hat_response(parts @ self._ramp, self.context.step) / self.context.step

    def _nonlinear_motion(
        self, parts: FloatArray, ground: Ground, shaping: Active, law: NonlinearStiffness
    ) -> FloatArray:
        """What the nonlinear static resistance adds to the motion of the linear ground."""
        at_rest = 0.0 if ground.above else _STILL
        still = self._compliance(ground, shaping, np.array([at_rest + 0j]))
        plate = int(np.argmin(self.context.offsets))
        stiffness = 1.0 / float(still[plate, 0].real)
        hats = hat_response(parts @ self._ramp, self.context.step)
        load = self.context.load
        reference = self.context.largest_load / stiffness
        force, self._last_displacement = effective_force(
            hats[plate], load, law, stiffness, reference, self._last_displacement
        )
        # What the samples of the load leave out is small and linear: it stays in the motion.
        change = force - load
        # Ground beside the plate feels the force on it, not how far it deflects under it.
        under = self.context.offsets < self.context.plate_radius
        return np.stack(
            [
                np.convolve(hat, change)[: load.size] if below else np.zeros(load.size)
                for hat, below in zip(hats, under, strict=True)
            ]
        )

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

    def weighted_residual(self, predicted: FloatArray, scope: FitScope = WHOLE) -> FloatArray:
        r"""What a prediction leaves, (n,): noise would leave a sum of squares of `independent`.

        Noise is coloured: a velocity's becomes a random walk when it is integrated, whose slow
        part must not be taken for an effect. With C the covariance of noise, quantisation and
        the model's own error, the residual is :math:`\sqrt{N/n} L^{-1} r`, :math:`L L^T = C`,
        N of n samples being independent as far as the model's own error goes.
        """
        part = self._part(scope)
        left = (predicted - self._everywhere)[:, part]
        share = np.sqrt(self.independent(scope) / left.size)
        if scope.plain:
            return np.asarray(share * (left / self.noise[:, None]).ravel())
        whiteners = self._whiteners.get(scope)
        if whiteners is None:
            moving = (np.arange(part.start, part.stop) >= self.before).astype(float)
            # Too short a rest tells no noise: then it counts no more than the rest of the record.
            whiteners = tuple(
                channel.whitener(
                    part,
                    np.hypot(
                        floor * (moving if noise.model.samples else np.ones_like(moving)), quantum
                    ),
                )
                for channel, noise, floor, quantum in zip(
                    self.channels,
                    self.drop.channels,
                    self._floor,
                    self.drop.quantisation,
                    strict=True,
                )
            )
            self._whiteners[scope] = whiteners
        parts = [share * (w @ row) for w, row in zip(whiteners, left, strict=True)]
        return np.concatenate(parts)

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

    def residual_over_peak(self, predicted: FloatArray, *, contact_only: bool) -> float:
        """Rms over all sensors, each over its own peak, from the trigger on."""
        part = self.context.time >= self.drop.trigger
        if contact_only:
            part &= self.context.time <= self.drop.contact_end * (1 + 1e-9)
        left = (predicted - self.observed)[:, part] / self.peak[:, None]
        return float(np.sqrt(np.mean(left**2)))
