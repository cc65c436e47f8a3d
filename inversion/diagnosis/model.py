"""Model of a drop with effects. Of its five stages, the slow ones are cached.

The stages are listed in :mod:`inversion.effects.base`. A hat response is the motion under a load
that is a hat function over one sample; it is needed for nonlinear ground.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import Any, TypeVar

import numpy as np

from inversion.arrays import ComplexArray, FloatArray, remember
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
from inversion.diagnosis.rest import PreTriggerNoise, estimate_pre_trigger_noise
from inversion.effects.base import DropContext, Effect, Ground, Values, geophone
from inversion.forward.laplace import band_of_load
from inversion.forward.model import Synthesis
from inversion.forward.nonlinear_stiffness import (
    NonlinearStiffness,
    convolve_rows,
    effective_force,
    forces_nearby,
    hat_response,
)
from inversion.measured.half_sine import Load, model_load
from inversion.measured.record import PreparedDrop, Record, prepare
from inversion.measured.weighted_drop import model_floor

# Largest number of samples of a record in the model: enough for a pulse of 8 ms in 0.1 s.
MAX_SAMPLES = 180
# Highest frequency of the model, and the smallest it is reduced to, Hz. At 900 Hz the spectrum of a
# pulse of 8 ms has fallen to a two-hundredth. Above 300 Hz that of a trailer's pulse of 30 ms is
# below the negligible fraction.
_BAND_HZ, _MIN_BAND_HZ = 900.0, 300.0
_NEGLIGIBLE_SPECTRUM = 0.003
# Laplace variable that represents static load, 1/s.
_AT_REST_S = 1e-3
# Fits begin with this sample: the first one is zero by construction.
FROM_SAMPLE = 1
# Smallest upward motion that counts as a rebound, as a fraction of the largest deflection and as a
# multiple of the noise.
_MIN_REBOUND, _MIN_REBOUND_OVER_NOISE = 0.01, 3.0
# End of the time in which the largest deflection is searched, in multiples of the contact.
_MAX_PEAK_TIME = 1.3

Active = Sequence[tuple[Effect, Values]]
_Motion = tuple[FloatArray, FloatArray | None]
_A = TypeVar("_A", FloatArray, ComplexArray)


@dataclass(frozen=True)
class _Stages:
    """Ground of a drop, with the effects that act on it before the motion.

    Parameters
    ----------
    key : tuple, unique for the ground and its effects
    ground : Ground
    law : NonlinearStiffness
    shaping : effects that change the compliance, with their values
    """

    key: tuple[object, ...]
    ground: Ground = field(compare=False)
    law: NonlinearStiffness = field(compare=False)
    shaping: Active = field(compare=False)


@dataclass(frozen=True, eq=False)
class PointRecords:
    """Drops of a point, as input of the diagnosis.

    Parameters
    ----------
    name : str
    records : tuple of Record, measured drops in their order, all with the same declarations
    numbers : tuple of int, of the drops
    elastic : bool, True: the ground of the base model has no viscosity
    load : Load, that drives the model
    device_largest : mapping, largest value of each channel at other points of the device
    """

    name: str
    records: tuple[Record, ...]
    numbers: tuple[int, ...]
    elastic: bool = False
    load: Load = "measured"
    device_largest: LargestValues = field(default_factory=dict)

    @cached_property
    def largest_values(self) -> LargestValues:
        """Largest value of each channel at the point and at others of its device."""
        return merge_largest(largest_values(self.records), self.device_largest)


class DropModel:
    """Model that predicts the record of one drop from ground and effects.

    Parameters
    ----------
    record : Record
    largest_load : float, N, of the point's drops
    index : int, of the drop within the point, from 0
    point : PointRecords
    response : GroundResponse, which the drops of a point share
    duration : float or None, s, of the longest record of the point, so that drops share a response
    rest : PreTriggerNoise or None, the drop with its noise as estimated from all drops of the point
    """

    def __init__(
        self,
        record: Record,
        largest_load: float,
        index: int,
        point: PointRecords,
        response: GroundResponse,
        duration: float | None = None,
        rest: PreTriggerNoise | None = None,
    ) -> None:
        # The response has its sensors in this order, whatever order the record has.
        record = record.nearest_first()
        drop = prepare(record)
        at_rest = rest or estimate_pre_trigger_noise([record])[0]
        self._at_rest = at_rest
        with_tail = at_rest.drop
        self.drop: PreparedDrop = with_tail
        self.record = record
        # The geophone acts in the record stage, after the motion of the ground in time.
        self._instrument = replace(
            record.instrument, geophone_natural_frequency=None, geophone_damping=None
        )
        self.response = response
        self._duration = duration
        count_samples = int(np.searchsorted(drop.time, with_tail.tail_end * (1 + 1e-9)))
        stride = max(1, -(-count_samples // MAX_SAMPLES))
        self.rows = np.arange(0, count_samples, stride)
        load = model_load(drop.time, drop.load, point.load)
        self._load = load
        self._prepare_transform(_BAND_HZ)
        first = int(np.searchsorted(record.time, drop.start - 0.5 * drop.step))
        # Number of samples before the pulse, which contain drift, hum and noise only.
        self.before = first // stride
        samples = first + np.concatenate([np.arange(-self.before, 0) * stride, self.rows])
        self.channels = tuple(
            MotionChannel(sensor, noise, first, samples, drop.step)
            for sensor, noise in zip(record.sensors, with_tail.channels, strict=True)
        )
        everywhere = np.stack([channel.observed for channel in self.channels])
        self.observed: FloatArray = everywhere[:, self.before :]
        floor = model_floor(with_tail, record.model_floor)
        self.noise: FloatArray = np.maximum(
            np.maximum(with_tail.noise, with_tail.quantisation), floor
        )
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
        """Times of the samples that `predict` returns, s, on the time axis of the record."""
        return self.drop.start + self._recorded.time

    @property
    def min_band_hz(self) -> float:
        """Frequency above which the load has no spectrum, within 300 to 900 Hz."""
        reaches = band_of_load(self.drop.time, self._load, _NEGLIGIBLE_SPECTRUM)
        return min(max(reaches, _MIN_BAND_HZ), _BAND_HZ)

    def in_band(self, band: float) -> DropModel:
        """Return the same drop, modelled up to this frequency, Hz."""
        model = copy.copy(self)
        model._prepare_transform(band)
        model._motions, model._last_displacement, model._latest = {}, None, None
        return model

    def with_flat_tops(self, flat: tuple[float | None, ...]) -> DropModel:
        """Return the same drop, with these clipping levels of the sensors, m/s.

        A level of None means that the sensor is not clipped.
        """
        model = copy.copy(self)
        model.context = replace(self.context, flat=flat)
        model._recorded = replace(self._recorded, flat=flat)
        return model

    def _prepare_transform(self, band: float) -> None:
        """Set the matrices from compliances to the motion under load and hat responses."""
        time = self.drop.time[self.rows]
        synthesis = Synthesis(
            self._instrument, self.drop.time, self._load, time, band, self._duration
        )
        s, self._synthesis = synthesis.s, synthesis.matrix
        # The last variable represents static load: zero for layered ground, and a small value for
        # homogeneous ground, whose solution is singular at zero.
        self.s, self._s_layered = (np.append(s, still) for still in (_AT_REST_S, 0.0))
        ramp = synthesis.transform.synthesis(time) / s[:, None] ** 2
        # Response to a hat function of 1 N over one sample, see `hat_response`.
        self._hats = hat_response(np.vstack([ramp.real, -ramp.imag]), float(time[1] - time[0]))

    def _make_context(
        self, load: FloatArray, largest_load: float, index: int, point: PointRecords
    ) -> DropContext:
        """Return the properties of the drop on which effects may depend."""
        drop, record = self.drop, self.record
        noises = [channel.model.rms for channel in drop.channels]
        plate = int(np.argmin(drop.offsets))
        rebound = -float(
            self.observed[plate, drop.time[self.rows] > drop.contact_end].min(initial=0.0)
        )
        min_rebound = max(
            _MIN_REBOUND * float(drop.peak_displacement[plate]),
            _MIN_REBOUND_OVER_NOISE * self.noise[plate],
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
            is_density_declared=record.density is not None,
            unmodelled_load=None if point.load == "measured" else (drop.load - load)[self.rows],
            plate_mass=record.instrument.plate_mass,
            swings_back=rebound > min_rebound,
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
            max_hum=self._at_rest.max_hum,
        )

    def predict(self, ground: Ground, active: Active) -> FloatArray:
        """Return the recorded displacement, (n_sensors, n), m, from before the pulse to the end.

        Parameters
        ----------
        ground : Ground
        active : sequence of effects with the values of their parameters
        """
        stages = self._stages(ground, active)
        motion = self._ground_motion(stages)
        for effect, values in active:
            if "motion" in _stages_of(effect):
                motion = effect.motion(
                    motion, values, self.context, partial(self._impulse_response, stages)
                )
        displacements: FloatArray = self._read(self._record(motion[None], active))[0]
        return displacements

    def ground_motion(self, ground: Ground, active: Active) -> FloatArray:
        """Return the motion of the ground, (n_sensors, n), m, before effects on motion."""
        return self._ground_motion(self._stages(ground, active))

    def _padded(self, motions: FloatArray) -> FloatArray:
        """Return motions (m, n_sensors, n) from before the pulse on, as a geophone records them."""
        records = np.zeros((*motions.shape[:2], self.before + motions.shape[2]))
        records[:, :, self.before :] = motions
        instrument, step = self.record.instrument, self.context.step
        frequency, damping = instrument.geophone_natural_frequency, instrument.geophone_damping
        if frequency is not None and damping is not None:
            rows = geophone(_rows(records), frequency, damping, step)
            records = rows.reshape(records.shape)
        return records

    def _record(self, motions: FloatArray, active: Active) -> FloatArray:
        """Return motions (m, n_sensors, n), m, with the effects of sensor and processing."""
        records = self._padded(motions)
        for effect, values in active:
            if "record" in _stages_of(effect):
                records = self._recorded_by(effect, values, records)
        return records

    def _recorded_by(self, effect: Effect, values: Values, records: FloatArray) -> FloatArray:
        """Return records (m, n_sensors, n) with an effect.

        An effect that treats all sensors alike is called once.
        """
        if effect.is_identical_for_all_sensors:
            return effect.record(_rows(records), values, self._recorded).reshape(records.shape)
        return np.stack([effect.record(record, values, self._recorded) for record in records])

    def _read(self, records: FloatArray) -> FloatArray:
        """Return records (m, n_sensors, n) as displacements without offset, see `MotionChannel`."""
        return np.stack(
            [channel.read(records[:, row]) for row, channel in enumerate(self.channels)], axis=1
        )

    def predict_nearby(
        self, ground: Ground, active: Active, moved: Sequence[tuple[Ground, Active]]
    ) -> FloatArray:
        """Return `predict` for several small steps of the ground or the effects.

        The shape is (m, n_sensors, n), the unit m.

        Responses of the ground are computed from derivatives (`GroundResponse.nearby`), nonlinear
        resistance by one step of Newton's method. A stage is computed only for items that have
        changed in it or before.

        Parameters
        ----------
        ground, active : as for `predict`
        moved : sequence of m pairs of ground and effects
            All have the same effects in the same order; unchanged values should be the same
            objects.
        """
        steps = _changed(active, moved)
        motions, places = self._motions_nearby(ground, active, moved, steps)
        records = self._padded(motions)
        for number, (effect, values) in enumerate(active):
            if "record" not in _stages_of(effect):
                continue
            stacked = [self._recorded_by(effect, values, records)]
            count = records.shape[0]
            for column, (changed, (_, moved_effects)) in enumerate(zip(steps, moved, strict=True)):
                if number in changed:
                    moved_records = records[places[column]][None]
                    stacked.append(
                        self._recorded_by(effect, moved_effects[number][1], moved_records)
                    )
                    places[column], count = count, count + 1
            records = np.concatenate(stacked)
        return self._read(records)[places]

    def peaks_of_ground(
        self, ground: Ground, active: Active, moved: Sequence[tuple[Ground, Active]] = ()
    ) -> FloatArray:
        """Return the largest deflection under the plate, m, and for small steps, (1 + m,).

        It is that of the ground under the recorded load, without a mass on it, effects of the
        device, and effects on the motion.

        Parameters
        ----------
        ground, active, moved : as for `predict_nearby`
        """
        shaping = [
            i for i, (e, _) in enumerate(active) if _shapes_ground(e) and e.scope != "device"
        ]
        start, *near = (
            (replace(g, plate_mass=0.0), [effects[i] for i in shaping])
            for g, effects in ((ground, active), *moved)
        )
        motions, places = self._motions_nearby(*start, near, _changed(start[1], near))
        contact = self.context.time <= _MAX_PEAK_TIME * self.context.contact_end
        rows = motions[:, self._plate, contact]
        return _largest_deflections(rows)[[0, *places]]

    def _motions_nearby(
        self,
        ground: Ground,
        active: Active,
        moved: Sequence[tuple[Ground, Active]],
        steps: Sequence[Sequence[int]],
    ) -> tuple[FloatArray, list[int]]:
        """Return the distinct motions (k, n_sensors, n), m, and the index of each item's.

        The unchanged motion comes first.

        Parameters
        ----------
        ground, active, moved : as for `predict_nearby`
        steps : for each item, the indices of the effects whose values have changed
        """
        start = self._stages(ground, active)
        stages = {start: 0}
        acting = [i for i, (effect, _) in enumerate(active) if "motion" in _stages_of(effect)]
        # Key of each row of motions: its ground, and the changed values of effects of this stage.
        rows: dict[tuple[object, ...], int] = {(0,): 0}
        where, places = [0], []
        values = {i: {name: [value] for name, value in active[i][1].items()} for i in acting}
        for (moved_ground, moved_effects), changed in zip(moved, steps, strict=True):
            stage = start
            if moved_ground is not ground or any(_shapes_ground(active[i][0]) for i in changed):
                stage = self._stages(moved_ground, moved_effects)
            number = stages.setdefault(stage, len(stages))
            moved_values = tuple((i, *moved_effects[i][1].values()) for i in acting if i in changed)
            row = rows.setdefault((number, *moved_values), len(rows))
            places.append(row)
            if row == len(where):
                where.append(number)
                for i in acting:
                    for name, value in moved_effects[i][1].items():
                        values[i][name].append(value)
        motions, hats = self._grounds_nearby(list(stages), bool(acting))
        motions = motions[where]
        for i in acting:
            arrays = {name: np.array(value) for name, value in values[i].items()}
            motions = active[i][0].motions(
                motions, arrays, self.context, lambda: hats[where] / self.context.step
            )
        return motions, places

    def _grounds_nearby(
        self, stages: Sequence[_Stages], forced: bool
    ) -> tuple[FloatArray, FloatArray]:
        """Return the motions of a ground and of similar grounds, and their hat responses.

        Each is (m, n_sensors, n), m and m/N. Hat responses are computed if an effect applies a
        force (``forced``) or the resistance is nonlinear.
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
        """Return displacement over load of similar grounds, (m, n_sensors, n), m/N."""
        start, *moved = stages
        compliances = self.response.nearby(start.ground, [o.ground for o in moved], s)
        if not any(stage.shaping for stage in stages):
            return compliances
        return np.stack(
            [
                self._shaped(compliance, stage.shaping, s)
                for compliance, stage in zip(compliances, stages, strict=True)
            ]
        )

    def _bent_nearby(
        self,
        stages: Sequence[_Stages],
        motions: FloatArray,
        hats: FloatArray,
        still: ComplexArray,
    ) -> FloatArray:
        """Return the motions (m, n_sensors, n) with the nonlinear resistance of the ground.

        The first ground is solved; the others are obtained from it by one Newton step. `hats` are
        hat responses and `still` the static compliances (m, n_sensors).
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
        """Return the ground with its effects: parameters, stiffness law and compliance."""
        if self._latest is not None and self._latest[0] is ground and self._latest[1] is active:
            return self._latest[2]
        changed_ground, law = ground, NonlinearStiffness()
        shaping = []
        for effect, values in active:
            stages = _stages_of(effect)
            if "ground" in stages:
                changed_ground = effect.ground(changed_ground, values, self.context)
            if "nonlinear_stiffness" in stages:
                law = effect.nonlinear_stiffness(law, values, self.context)
            if "compliance" in stages:
                shaping.append((effect, values))
        key = (changed_ground, law, *((e.name, *v.values()) for e, v in shaping))
        result = _Stages(key, changed_ground, law, shaping)
        # Cached, because it is needed before and after the grounds of all drops are solved.
        self._latest = ground, active, result
        return result

    def _ground_motion(self, stages: _Stages) -> FloatArray:
        """Return the motion of ground that may be nonlinear, (n_sensors, n), m.

        It is cached, because later effects are tried many times on the same motion.
        """
        cached = self._motions.get(stages.key)
        if cached is not None:
            return cached[0]
        compliance = self._compliance(stages)
        parts = _parts(compliance)
        motion: FloatArray = parts @ self._synthesis
        solution = None
        if not stages.law.linear:
            still = float(compliance[self._plate, -1].real)
            bent, solution = self._nonlinear_motion(parts, stages.law, still)
            motion[self._under_plate] += bent
        remember(self._motions, stages.key, (motion, solution))
        return motion

    def _impulse_response(self, stages: _Stages) -> FloatArray:
        """Return the motion after an impulse of 1 N s on the plate, (n_sensors, n), m."""
        parts = _parts(self._compliance(stages))
        response: FloatArray = parts @ self._hats / self.context.step
        return response

    def _nonlinear_motion(
        self, parts: FloatArray, law: NonlinearStiffness, still: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return the change of motion due to nonlinearity, and the plate's displacement.

        The change is for the sensors under the plate, (k, n), m: the ground outside depends on the
        force, not on the deflection under the plate. The plate's displacement is (n,), m.

        Parameters
        ----------
        parts : real and imaginary parts of the compliance
        law : NonlinearStiffness
        still : float, m/N, static compliance under the plate
        """
        hats = parts @ self._hats
        load, reference = self.context.load, self.context.largest_load * still
        force, solution = effective_force(
            hats[self._plate], load, law, 1.0 / still, reference, self._last_displacement
        )
        self._last_displacement = solution
        # Only the change is returned: the linear motion already includes the load between the
        # samples.
        return convolve_rows(hats[self._under_plate], force - load), solution

    def _variables(self, stages: _Stages) -> ComplexArray:
        """Return the Laplace variables, 1/s, at which the ground is solved.

        The last one is static load.
        """
        return self._s_layered if self.response.is_layered(stages.ground) else self.s

    def _compliance(self, stages: _Stages) -> ComplexArray:
        """Return displacement over load at every sensor, (n_sensors, n), m/N."""
        s = self._variables(stages)
        return self._shaped(self.response.compliance(stages.ground, s), stages.shaping, s)

    def _shaped(self, compliance: ComplexArray, shaping: Active, s: ComplexArray) -> ComplexArray:
        """Return a compliance with the effects that change it."""
        for effect, values in shaping:
            compliance = effect.compliance(compliance, s, values, self.context)
        return compliance

    @property
    def measures_plate(self) -> bool:
        """True if the innermost sensor is on the plate or under it."""
        return bool(self._under_plate[self._plate])

    @property
    def peak_in_contact(self) -> float:
        """Largest deflection of the innermost sensor up to 1.3 contact times, m."""
        row = self.observed[int(np.argmin(self.context.offsets))]
        return float(row[self.context.time <= _MAX_PEAK_TIME * self.context.contact_end].max())

    def noise_covariance(self, sensor: int, floor: float) -> FloatArray:
        """Return the covariance of the noise of a sensor at the fitted samples, m2.

        It is cached, because all candidate models of a drop have the same noise.

        Parameters
        ----------
        sensor : int, index
        floor : float, m, error of the model, independent at each sample
        """
        covariance = self._noise_covariances.get((sensor, floor))
        if covariance is None:
            window = slice(FROM_SAMPLE, self.rows.size)
            steady = np.hypot(float(self.drop.quantisation[sensor]), floor)
            covariance = self.channels[sensor].noise_covariance(
                slice(self.before + window.start, self.before + window.stop),
                np.full(window.stop - window.start, steady),
            )
            self._noise_covariances[sensor, floor] = covariance
        return covariance

    def residual_over_peak(
        self, predicted: FloatArray, *, contact_only: bool, sensors: Sequence[int] | None = None
    ) -> float:
        """Return the root mean square residual of sensors over their peaks, from the trigger on.

        Parameters
        ----------
        predicted : (n_sensors, n) ndarray of float, m
        contact_only : bool, True: only up to the end of the contact
        sensors : sequence of int, indices of the sensors; None: all
        """
        part = self.context.time >= self.drop.trigger
        if contact_only:
            part &= self.context.time <= self.drop.contact_end * (1 + 1e-9)
        residual = (predicted - self.observed)[:, part] / self.peak[:, None]
        chosen = residual if sensors is None else residual[list(sensors)]
        return float(np.sqrt(np.mean(chosen**2)))


@cache
def _stages_of_class(kind: Any) -> frozenset[str]:
    stages = ("ground", "compliance", "nonlinear_stiffness", "motion", "record")
    return frozenset(s for s in stages if getattr(kind, s) is not getattr(Effect, s))


def _stages_of(effect: Effect) -> frozenset[str]:
    """Return the names of the stages in which an effect acts."""
    kind: Any = type(effect)
    return _stages_of_class(kind)


def _shapes_ground(effect: Effect) -> bool:
    """Return whether an effect acts on the ground or its compliance, before the motion."""
    return bool(_stages_of(effect) & {"ground", "compliance", "nonlinear_stiffness"})


def _changed(active: Active, moved: Sequence[tuple[Ground, Active]]) -> list[list[int]]:
    """Return, for each item, the indices of the effects whose values have changed."""
    return [
        [
            place
            for place, ((_, start_values), (_, moved_values)) in enumerate(
                zip(active, moved_effects, strict=True)
            )
            if start_values is not moved_values and start_values != moved_values
        ]
        for _, moved_effects in moved
    ]


def _parts(compliances: ComplexArray) -> FloatArray:
    """Return real and imaginary parts (k, 2 n) of compliances, without the static one."""
    return np.concatenate([compliances[:, :-1].real, compliances[:, :-1].imag], axis=1)


def _rows(records: _A) -> _A:
    """Return records (m, n_sensors, n) as one table with a row for each sensor of each record."""
    return records.reshape(-1, records.shape[-1])


def _largest_deflections(rows: FloatArray) -> FloatArray:
    """Return the largest value of each row (m, n), of a parabola through three samples."""
    top = np.clip(np.argmax(rows, axis=1), 1, rows.shape[1] - 2)
    before, peak, after = (rows[np.arange(top.size), top + step] for step in (-1, 0, 1))
    bend = before - 2.0 * peak + after
    shift = np.where(bend < 0.0, 0.5 * (before - after) / np.minimum(bend, -1e-300), 0.0)
    result: FloatArray = peak - 0.25 * (before - after) * np.clip(shift, -1.0, 1.0)
    return result
