"""The model of a drop with effects: five stages, of which the slow one is remembered."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import Any, TypeVar

import numpy as np

from inversion.arrays import ComplexArray, FloatArray
from inversion.diagnosis.channel import MotionChannel
from inversion.diagnosis.flat_tops import (
    REST_SAMPLES,
    LargestValues,
    flat_load_level,
    flat_sensor_level,
    largest_values,
    merge_largest,
)
from inversion.diagnosis.ground_response import GroundResponse
from inversion.diagnosis.rest import DropAtRest, drops_at_rest
from inversion.effects.base import DropContext, Effect, Ground, Values, geophone
from inversion.fitting.layered.first_look import FirstLook
from inversion.fitting.misfit import model_floor
from inversion.forward.laplace import DampedTransform, band_of_load
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
# Hz; of a pulse of 8 ms a two-hundredth of the spectrum is left there. Of a trailer's of 30 ms no
# more than this part is left from 300 Hz on.
_BAND_HZ, _LEAST_BAND_HZ = 900.0, 300.0
_SPECTRUM_LEFT = 0.003
_REMEMBERED = 24
# 1/s; slow enough for the ground to be at rest.
_STILL = 1e-3
# The first sample is zero by construction.
FROM_SAMPLE = 1
# The deflection has its peak within so many contact times.
_SOON = 1.3
# How far a plate has to come up to swing back, of its largest deflection and over the noise.
_SWINGS_BACK, _ABOVE_NOISE = 0.01, 3.0

Active = Sequence[tuple[Effect, Values]]
_Motion = tuple[FloatArray, FloatArray | None]
_A = TypeVar("_A", FloatArray, ComplexArray)


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
    device_largest : mapping, largest value of each channel in other points of the device
    """

    name: str
    records: tuple[Record, ...]
    numbers: tuple[int, ...]
    elastic: bool = False
    half_sine: bool = False
    device_largest: LargestValues = field(default_factory=dict)

    @cached_property
    def largest_values(self) -> LargestValues:
        """Largest value of each channel in the drops of the point and of its device."""
        return merge_largest(largest_values(self.records), self.device_largest)


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
    rest : DropAtRest or None, the drop with its noise as all drops of the point tell it
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
        rest: DropAtRest | None = None,
    ) -> None:
        # The surrogate answers in this order, whatever order the record has.
        record = record.nearest_first()
        drop = prepare(record)
        self._layers = layers
        at_rest = rest or drops_at_rest([record])[0]
        self._at_rest = at_rest
        whole = at_rest.drop
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
        self._load = load
        self._prepare_transform(_BAND_HZ)
        first = int(np.searchsorted(record.time, drop.start - 0.5 * drop.step))
        # Samples before the pulse, where nothing moves but drift, hum and noise show.
        self.before = first // stride
        samples = first + np.concatenate([np.arange(-self.before, 0) * stride, self.rows])
        self.channels = tuple(
            MotionChannel(sensor, noise, first, samples, drop.step)
            for sensor, noise in zip(record.sensors, whole.channels, strict=True)
        )
        everywhere = np.stack([channel.observed for channel in self.channels])
        self.observed: FloatArray = everywhere[:, self.before :]
        floor = model_floor(whole, record.model_floor)
        self.noise: FloatArray = np.maximum(np.maximum(whole.noise, whole.quantisation), floor)
        self.context = self._make_context(load, largest_load, index, point)
        self._recorded = replace(self.context, time=drop.step * (samples - first))
        self._noise_covariances: dict[tuple[int, float], FloatArray] = {}
        self.peak: FloatArray = drop.peak_displacement
        self._motions: dict[tuple[object, ...], _Motion] = {}
        self._last_displacement: FloatArray | None = None
        self._latest: tuple[Ground, Active, _Stages] | None = None
        self._plate = int(np.argmin(self.context.offsets))
        self._under_plate = self.context.offsets < self.context.plate_radius

    @property
    def recorded_time(self) -> FloatArray:
        """Time of the samples that `predict` returns, s, as recorded."""
        return self.drop.start + self._recorded.time

    @property
    def least_band(self) -> float:
        """Hz up to which the load has more than hardly any spectrum, or as far as it is solved."""
        reaches = band_of_load(self.drop.time, self._load, _SPECTRUM_LEFT)
        return min(max(reaches, _LEAST_BAND_HZ), _BAND_HZ)

    def in_band(self, band: float) -> DropModel:
        """The same drop, solved for up to this frequency, Hz."""
        other = copy.copy(self)
        other._prepare_transform(band)
        other._motions, other._last_displacement, other._latest = {}, None, None
        return other

    def with_flat_tops(self, flat: tuple[float | None, ...]) -> DropModel:
        """Return the same drop with these levels of flat tops, of each sensor."""
        other = copy.copy(self)
        other.context = replace(self.context, flat=flat)
        other._recorded = replace(self._recorded, flat=flat)
        return other

    def _prepare_transform(self, band: float) -> None:
        """From compliances at Laplace frequencies to motions under the load, and after a hat."""
        load = self._load
        time = self.drop.time[self.rows]
        band = min(band, 0.5 / self.drop.step)
        if self.record.instrument.load_filter is not None:
            band = min(band, 2.0 * self.record.instrument.load_filter)
        transform = DampedTransform(self._duration or float(time[-1]), band)
        s = transform.s
        # Behind them the ground at rest, which is asked for with the others: layered ground has an
        # answer there, homogeneous ground one nearby.
        self.s, self._s_layered = (np.append(s, still) for still in (_STILL, 0.0))
        spectrum = transform.of_samples(self.drop.time, load)
        spectrum = spectrum * self._instrument.response(s)
        synthesis = spectrum[:, None] * transform.synthesis(time)
        self._synthesis = np.vstack([synthesis.real, -synthesis.imag])
        ramp = transform.synthesis(time) / s[:, None] ** 2
        # To the response after a hat of 1 N over one sample, see `hat_response`.
        self._hats = hat_response(np.vstack([ramp.real, -ramp.imag]), float(time[1] - time[0]))

    def _make_context(
        self, load: FloatArray, largest_load: float, index: int, point: PointRecords
    ) -> DropContext:
        """What effects may know of the drop."""
        drop, record = self.drop, self.record
        noises = [channel.model.rms for channel in drop.channels]
        plate = int(np.argmin(drop.offsets))
        above = -float(
            self.observed[plate, drop.time[self.rows] > drop.contact_end].min(initial=0.0)
        )
        least = max(
            _SWINGS_BACK * float(drop.peak_displacement[plate]), _ABOVE_NOISE * self.noise[plate]
        )
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
            swings_back=above > least,
            has_bedrock=record.bedrock_depth is not None and not np.isinf(record.bedrock_depth),
            flat=tuple(
                flat_sensor_level(
                    sensor,
                    noise,
                    drop.step,
                    drop.peak_load >= largest_load,
                    point.largest_values,
                )
                for sensor, noise in zip(record.sensors, noises, strict=True)
            ),
            flat_load=flat_load_level(record, drop.load_noise.rms, point.largest_values),
            rest=tuple(float(np.median(sensor.values[:REST_SAMPLES])) for sensor in record.sensors),
            hum=self._at_rest.hum,
            harmonics=self._at_rest.harmonics,
            most_hum=self._at_rest.most_hum,
        )

    def predict(self, ground: Ground, active: Active) -> FloatArray:
        """What would be recorded, (n_sensors, n), m; the samples before the pulse stand first."""
        stages = self._stages(ground, active)
        motion = self._ground_motion(stages)
        for effect, values in active:
            if "motion" in _stages_of(effect):
                motion = effect.motion(
                    motion, values, self.context, partial(self._impulse_response, stages)
                )
        found: FloatArray = self._read(self._record(motion[None], active))[0]
        return found

    def ground_motion(self, ground: Ground, active: Active) -> FloatArray:
        """Return what the ground does under the load, (n_sensors, n), m, before other effects."""
        return self._ground_motion(self._stages(ground, active))

    def _padded(self, motions: FloatArray) -> FloatArray:
        """Motions (m, n_sensors, n) from before the pulse on, as a geophone shows them."""
        records = np.zeros((*motions.shape[:2], self.before + motions.shape[2]))
        records[:, :, self.before :] = motions
        instrument, step = self.record.instrument, self.context.step
        frequency, damping = instrument.geophone_natural_frequency, instrument.geophone_damping
        if frequency is not None and damping is not None:
            rows = geophone(_rows(records), frequency, damping, step)
            records = rows.reshape(records.shape)
        return records

    def _record(self, motions: FloatArray, active: Active) -> FloatArray:
        """Motions (m, n_sensors, n) as sensors and processing show them, m."""
        records = self._padded(motions)
        for effect, values in active:
            if "record" in _stages_of(effect):
                records = self._recorded_by(effect, values, records)
        return records

    def _recorded_by(self, effect: Effect, values: Values, records: FloatArray) -> FloatArray:
        """Records (m, n_sensors, n) with an effect; one that treats rows alike sees all at once."""
        if effect.rows_alike:
            return effect.record(_rows(records), values, self._recorded).reshape(records.shape)
        return np.stack([effect.record(record, values, self._recorded) for record in records])

    def _read(self, records: FloatArray) -> FloatArray:
        """Records (m, n_sensors, n) as their displacements come out."""
        return np.stack(
            [channel.read(records[:, row]) for row, channel in enumerate(self.channels)], axis=1
        )

    def predict_nearby(
        self, ground: Ground, active: Active, moved: Sequence[tuple[Ground, Active]]
    ) -> FloatArray:
        """`predict` for what is a small step away, (m, n_sensors, n), m.

        The ground's responses come by derivatives (`GroundResponse.nearby`), nonlinear resistance
        by one step of Newton's method for all, and each stage is gone through for those alone in
        which something has moved until then. The moved ones have the same effects in the same
        order; what has not moved there should be the same object.
        """
        steps = [
            [
                place
                for place, ((_, here), (_, there)) in enumerate(zip(active, other, strict=True))
                if here is not there and here != there
            ]
            for _, other in moved
        ]
        motions, places = self._motions_nearby(ground, active, moved, steps)
        records = self._padded(motions)
        for number, (effect, values) in enumerate(active):
            if "record" not in _stages_of(effect):
                continue
            found = [self._recorded_by(effect, values, records)]
            count = records.shape[0]
            for column, (changed, (_, other)) in enumerate(zip(steps, moved, strict=True)):
                if number in changed:
                    own = records[places[column]][None]
                    found.append(self._recorded_by(effect, other[number][1], own))
                    places[column], count = count, count + 1
            records = np.concatenate(found)
        return self._read(records)[places]

    def _motions_nearby(
        self,
        ground: Ground,
        active: Active,
        moved: Sequence[tuple[Ground, Active]],
        steps: Sequence[Sequence[int]],
    ) -> tuple[FloatArray, list[int]]:
        """Motions (k, n_sensors, n), m: first where nothing has moved; and which each has.

        Parameters
        ----------
        steps : places of the effects whose values have moved, of each
        """
        start = self._stages(ground, active)
        stages = {start: 0}
        acting = [i for i, (effect, _) in enumerate(active) if "motion" in _stages_of(effect)]
        # Of each row of motions its ground, and what has moved of the effects of this stage.
        rows: dict[tuple[object, ...], int] = {(0,): 0}
        where, places = [0], []
        values = {i: {name: [value] for name, value in active[i][1].items()} for i in acting}
        for (other_ground, other), changed in zip(moved, steps, strict=True):
            stage = start
            if other_ground is not ground or any(_shapes_ground(active[i][0]) for i in changed):
                stage = self._stages(other_ground, other)
            number = stages.setdefault(stage, len(stages))
            own = tuple((i, *other[i][1].values()) for i in acting if i in changed)
            row = rows.setdefault((number, *own), len(rows))
            places.append(row)
            if row == len(where):
                where.append(number)
                for i in acting:
                    for name, value in other[i][1].items():
                        values[i][name].append(value)
        motions, hats = self._grounds_nearby(list(stages), bool(acting))
        motions = motions[where]
        for i in acting:
            many = {name: np.array(value) for name, value in values[i].items()}
            motions = active[i][0].motions(
                motions, many, self.context, lambda: hats[where] / self.context.step
            )
        return motions, places

    def _grounds_nearby(
        self, stages: Sequence[_Stages], forced: bool
    ) -> tuple[FloatArray, FloatArray]:
        """Motions of a ground and of others a small step from it, and their hat responses.

        Each (m, n_sensors, n), m and m/N; the latter where something is ``forced`` to move.
        """
        start = stages[0]
        compliances = self._compliances_nearby(stages, self._variables(start))
        flat = _parts(_rows(compliances))
        shape = (len(stages), compliances.shape[1], -1)
        nonlinear = any(not stage.law.linear for stage in stages)
        hats: FloatArray = np.empty(0)
        if forced or nonlinear:
            hats = (flat @ self._hats).reshape(shape)
        if nonlinear and len(stages) == 1:
            return self._ground_motion(start)[None], hats
        motions: FloatArray = (flat @ self._synthesis).reshape(shape)
        if nonlinear:
            motions = self._bent_nearby(stages, motions, hats, compliances[..., -1])
        return motions, hats

    def _compliances_nearby(self, stages: Sequence[_Stages], s: ComplexArray) -> ComplexArray:
        """Displacement over load of a ground and of others a small step from it."""
        start, *others = stages
        found = self.response.nearby(start.ground, [o.ground for o in others], s)
        if not any(stage.shaping for stage in stages):
            return found
        return np.stack(
            [
                self._shaped(compliance, stage.shaping, s)
                for compliance, stage in zip(found, stages, strict=True)
            ]
        )

    def _bent_nearby(
        self,
        stages: Sequence[_Stages],
        motions: FloatArray,
        hats: FloatArray,
        still: ComplexArray,
    ) -> FloatArray:
        """Motions (m, n_sensors, n) of linear grounds with their nonlinear resistance.

        The first is the ground that was solved for; `hats` as `hat_response` gives them, the
        compliances (m, n_sensors) at rest.
        """
        load, plate = self.context.load, self._plate
        self._ground_motion(stages[0])
        motion, solution = self._motions[stages[0].key]
        if solution is None:
            solution = convolve_rows(hats[0, plate], load)
        laws = []
        for stage, compliance in zip(stages, still[:, plate].real.tolist(), strict=True):
            laws.append((stage.law, 1.0 / compliance, self.context.largest_load * compliance))
        forces = forces_nearby(
            hats[0, plate],
            load,
            laws[0],
            solution,
            [(hat[plate], *law) for hat, law in zip(hats[1:], laws[1:], strict=True)],
        )
        result = motions
        below = np.flatnonzero(self._under_plate)
        result[1:, below] += convolve_rows(hats[1:, below], (forces - load)[:, None])
        result[0] = motion
        return result

    def _stages(self, ground: Ground, active: Active) -> _Stages:
        """What the ground does: its parameters, its law, and what shapes its compliance."""
        if self._latest is not None and self._latest[0] is ground and self._latest[1] is active:
            return self._latest[2]
        here, law = ground, NonlinearStiffness()
        shaping = []
        for effect, values in active:
            stages = _stages_of(effect)
            if "ground" in stages:
                here = effect.ground(here, values, self.context)
            if "nonlinear_stiffness" in stages:
                law = effect.nonlinear_stiffness(law, values, self.context)
            if "compliance" in stages:
                shaping.append((effect, values))
        key = (here, law, *((e.name, *v.values()) for e, v in shaping))
        found = _Stages(key, here, law, shaping)
        # It is asked for twice: before the grounds of all drops are solved for, and after.
        self._latest = ground, active, found
        return found

    def _ground_motion(self, stages: _Stages) -> FloatArray:
        """Motion of the ground, whose static resistance may be nonlinear.

        Remembered, because later effects are tried many times on the same motion.
        """
        known = self._motions.get(stages.key)
        if known is not None:
            return known[0]
        compliance = self._compliance(stages)
        parts = _parts(compliance)
        motion: FloatArray = parts @ self._synthesis
        solution = None
        if not stages.law.linear:
            still = float(compliance[self._plate, -1].real)
            bent, solution = self._nonlinear_motion(parts, stages.law, still)
            motion[self._under_plate] += bent
        if len(self._motions) >= _REMEMBERED:
            self._motions.pop(next(iter(self._motions)))
        self._motions[stages.key] = motion, solution
        return motion

    def _impulse_response(self, stages: _Stages) -> FloatArray:
        """Motion after an impulse of 1 N s on the plate, (n_sensors, n), m."""
        parts = _parts(self._compliance(stages))
        response: FloatArray = parts @ self._hats / self.context.step
        return response

    def _nonlinear_motion(
        self, parts: FloatArray, law: NonlinearStiffness, still: float
    ) -> tuple[FloatArray, FloatArray]:
        """What the nonlinear static resistance adds to the motion of the linear ground.

        (sensors under the plate, n), m: ground beside it feels the force on it, not how far it
        deflects under it. And the displacement of the plate that it was solved for, (n,), m.
        From parts of the compliance and, m/N, the plate's at rest.
        """
        hats = parts @ self._hats
        load, reference = self.context.load, self.context.largest_load * still
        force, solution = effective_force(
            hats[self._plate], load, law, 1.0 / still, reference, self._last_displacement
        )
        self._last_displacement = solution
        # What the samples of the load leave out is small and linear: it stays in the motion.
        return convolve_rows(hats[self._under_plate], force - load), solution

    def _variables(self, stages: _Stages) -> ComplexArray:
        """Laplace variables at which the ground is solved for, the last of them at rest."""
        return self._s_layered if stages.ground.above else self.s

    def _compliance(self, stages: _Stages) -> ComplexArray:
        """Displacement over load at every sensor, (n_sensors, n), m/N."""
        s = self._variables(stages)
        return self._shaped(self.response.compliance(stages.ground, s), stages.shaping, s)

    def _shaped(self, compliance: ComplexArray, shaping: Active, s: ComplexArray) -> ComplexArray:
        """A ground's compliance with the effects that shape it."""
        for effect, values in shaping:
            compliance = effect.compliance(compliance, s, values, self.context)
        return compliance

    @property
    def peak_in_contact(self) -> float:
        """Largest deflection of the innermost sensor until shortly after the contact, m."""
        row = self.observed[int(np.argmin(self.context.offsets))]
        return float(row[self.context.time <= _SOON * self.context.contact_end].max())

    def noise_covariance(self, sensor: int, floor: float) -> FloatArray:
        """Return the covariance of the noise of a sensor, m2, at the samples that count.

        Remembered, because all candidate models of a drop have the same noise.

        Parameters
        ----------
        floor : float, m, error of the model itself, independent at each sample
        """
        known = self._noise_covariances.get((sensor, floor))
        if known is None:
            window = slice(FROM_SAMPLE, self.rows.size)
            steady = np.hypot(float(self.drop.quantisation[sensor]), floor)
            known = self.channels[sensor].noise_covariance(
                slice(self.before + window.start, self.before + window.stop),
                np.full(window.stop - window.start, steady),
            )
            self._noise_covariances[sensor, floor] = known
        return known

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


@cache
def _stages_of_kind(kind: Any) -> frozenset[str]:
    stages = ("ground", "compliance", "nonlinear_stiffness", "motion", "record")
    return frozenset(s for s in stages if getattr(kind, s) is not getattr(Effect, s))


def _stages_of(effect: Effect) -> frozenset[str]:
    """The stages in which an effect acts."""
    kind: Any = type(effect)
    return _stages_of_kind(kind)


def _shapes_ground(effect: Effect) -> bool:
    """Whether an effect acts before there is motion."""
    return bool(_stages_of(effect) & {"ground", "compliance", "nonlinear_stiffness"})


def _parts(compliances: ComplexArray) -> FloatArray:
    """Real and imaginary parts, (k, 2 n), of compliances (k, n + 1), the last of them at rest."""
    return np.concatenate([compliances[:, :-1].real, compliances[:, :-1].imag], axis=1)


def _rows(records: _A) -> _A:
    """Those of sensors (m, n_sensors, n) one below the other."""
    return records.reshape(-1, records.shape[-1])
