"""Points of one device as one least-squares problem: what is shared is fitted once.

The unknowns stand in blocks: those of the device, then those of every point (its ground and its
effects, those of single drops among them). The residual of a point knows of the device's block and
its own.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.ground_response import GroundResponse
from inversion.diagnosis.model import WHOLE, DropModel, FitScope, PointRecords
from inversion.diagnosis.rest import drops_at_rest
from inversion.effects.base import Effect, Ground
from inversion.fitting.layered.first_look import FirstLook
from inversion.fitting.layered.misfit import LayeredDrop
from inversion.fitting.parameters import RELAXATION_PRIOR, Parameter, soil_parameters
from inversion.forward.library import SurrogateLibrary
from inversion.forward.surrogate import Surrogate
from inversion.measured.half_sine import fit_half_sine
from inversion.measured.peak_method import peak_modulus
from inversion.measured.record import Record, prepare

_STEP = 1e-4
# Soils and granular fills: the logarithm of the density, kg/m3, and the relaxation time, s.
# Modulus of the ground under layers over that by the peak method.
_BELOW: dict[str, Any] = {"lower": 0.005, "upper": 50.0}

Active = list[tuple[Effect, dict[str, float]]]

# So many residuals, of the starts that are followed side by side, and Jacobians are remembered.
_RESIDUALS, _JACOBIANS = 32, 2
_Place = tuple[int, bytes, bytes]


def relative_soil(peak_modulus: float) -> tuple[Parameter, Parameter, Parameter]:
    """Unknowns of the base model: E over the peak-method value, eta over E, and rho.

    With the bounds of the inversion (`inversion.fitting.parameters`), as far as E is the
    peak-method value.
    """
    modulus, viscosity, density = soil_parameters(peak_modulus)
    low, high = modulus.lower / peak_modulus, modulus.upper / peak_modulus
    slowest = viscosity.upper / peak_modulus
    return (
        Parameter("modulus_ratio", "-", low, high, (0.8,), logarithmic=True),
        Parameter("relaxation", "s", 0.0, slowest, (1.0e-3,), prior=RELAXATION_PRIOR),
        density,
    )


@dataclass(frozen=True, eq=False)
class Unknown:
    """One number that is fitted.

    Parameters
    ----------
    parameter : Parameter
    effect : Effect or None (the ground)
    drop : int or None, index of the drop that it belongs to; None: all of the point
    """

    parameter: Parameter
    effect: Effect | None = None
    drop: int | None = None


class Point:
    """A test point: its drops' models and the unknowns of its own.

    Parameters
    ----------
    records : PointRecords
    library : SurrogateLibrary
    """

    def __init__(self, records: PointRecords, library: SurrogateLibrary) -> None:
        self.records = records
        first = records.records[0]
        self.declared_depth = first.bedrock_depth
        surrogate = surrogate_of(first, library)
        largest = max(float(np.max(r.load)) - float(r.load[0]) for r in records.records)
        layers = _first_look(records)
        longest = max(float(item.drop.with_tail().tail_end) for item in layers.drops)
        response = response_of(first, surrogate, library)
        self.drops = tuple(
            DropModel(record, surrogate, largest, index, records, layers, response, longest, rest)
            for index, (record, rest) in enumerate(
                zip(records.records, drops_at_rest(records.records), strict=True)
            )
        )
        peaks = [
            peak_modulus(
                model.drop.peak_load,
                max(model.peak_in_contact, 1e-9),
                first.instrument.plate_radius,
                first.poisson_ratio,
            ).modulus
            for model in self.drops
        ]
        self.peak_modulus = float(np.median(peaks))
        layers.peak_modulus = self.peak_modulus
        self._soil = relative_soil(self.peak_modulus)

    def coarse(self) -> Point:
        """The point as it is looked at where much more than noise is left.

        Beside the plate layers are solved for, which costs the more the more frequencies there are:
        there the band ends where the loads have hardly any spectrum left. What that changes, up to
        2e-3 of the peak, is more than noise may be.
        """
        if self.drops[0].context.offsets.size == 1:
            return self
        band = max(model.least_band for model in self.drops)
        other = copy.copy(self)
        other.drops = tuple(model.in_band(band) for model in self.drops)
        return other

    def soil(self, below: bool = False) -> list[Unknown]:
        """Unknowns of the base model; ``below``: of the ground under layers, of wider bounds."""
        known = self.records.records[0].density is not None
        left_out = {"density"} if known else set()
        if self.records.elastic:
            left_out.add("relaxation")
        soil = [p for p in self._soil if p.name not in left_out]
        if below:
            soil = [replace(p, **_BELOW) if p.name == "modulus_ratio" else p for p in soil]
        return [Unknown(p) for p in soil]

    def unknowns(self, effects: Sequence[Effect]) -> list[Unknown]:
        """Of the ground and of the effects that are not the device's."""
        # On a rig there is no ground to be fitted.
        found = []
        if not any(effect.replaces_ground for effect in effects):
            found = self.soil(any(effect.ground_is_below for effect in effects))
        for effect in effects:
            if effect.scope == "device":
                continue
            drops: list[int | None] = [None]
            if effect.scope == "drop":
                drops = [i for i, model in enumerate(self.drops) if effect.acts_on(model.context)]
            shared = set()
            for d in drops:
                for p in effect.parameters_for(self.drops[d or 0].context):
                    # What drops share stands with the first that has it.
                    if p.name not in shared:
                        found.append(Unknown(p, effect, None if p.of_point else d))
                    if p.of_point:
                        shared.add(p.name)
        return found

    def ground(self, own: Sequence[Unknown], unit_values: FloatArray) -> Ground:
        """The ground at unit_values of the point's unknowns."""
        record = self.records.records[0]
        soil = {
            unknown.parameter.name: float(unknown.parameter.value(unit_value))
            for unknown, unit_value in zip(own, unit_values, strict=True)
            if unknown.effect is None
        }
        soil = {p.name: p.starts[0] for p in self._soil} | soil
        if self.records.elastic:
            soil["relaxation"] = 0.0
        modulus = self.peak_modulus * soil["modulus_ratio"]
        depth = self.declared_depth
        return Ground(
            modulus=modulus,
            viscosity=modulus * soil["relaxation"],
            density=soil["density"] if record.density is None else record.density,
            inverse_depth=0.0 if depth is None or np.isinf(depth) else 1.0 / depth,
            plate_mass=record.instrument.plate_mass,
        )

    def look_ahead(
        self, drops: Sequence[tuple[int, Ground, Active]], *, nearby: bool = False
    ) -> None:
        """Solve for the grounds of some drops together, where their records are alike.

        Parameters
        ----------
        drops : number, ground and effects of each
        nearby : bool, whether grounds a small step from them are going to be asked for, too
        """
        by_variables: dict[tuple[int, complex], list[tuple[DropModel, Ground]]] = {}
        for number, ground, active in drops:
            model = self.drops[number]
            found = model.ground_below(ground, active)
            by_variables.setdefault((model.s.size, complex(model.s[0])), []).append((model, found))
        for alike in by_variables.values():
            model = alike[0][0]
            model.response.look_ahead([ground for _, ground in alike], model.s, nearby)


def surrogate_of(record: Record, library: SurrogateLibrary) -> Surrogate:
    """Return the surrogate for the plate, the sensors and the declared depth of a record."""
    from inversion.drop_inversion import Settings, surrogate_request

    # A declared half-space may be wrong: rock is offered there too.
    open_below = record.bedrock_depth is None or np.isinf(record.bedrock_depth)
    depth: Any = "unknown" if open_below else record.bedrock_depth
    problem, ratio = surrogate_request(record, Settings(bedrock_depth=depth))
    return library.get(problem, ratio)


def response_of(record: Record, surrogate: Surrogate, library: SurrogateLibrary) -> GroundResponse:
    """Return the response of the ground at the sensors of a record, without their geophones."""
    instrument = replace(record.instrument, geophone_natural_frequency=None, geophone_damping=None)
    offsets = [abs(sensor.offset) for sensor in record.nearest_first().sensors]
    return GroundResponse(surrogate, instrument, offsets, library)


def _first_look(records: PointRecords) -> FirstLook:
    """The drops of a point as layered ground."""
    first = records.records[0]
    drops = []
    for record in records.records:
        # As the drops' models have their sensors.
        drop = prepare(record.nearest_first())
        load = drop.load
        if records.half_sine:
            load = fit_half_sine(drop.time, drop.load).load(drop.time)
        drops.append(LayeredDrop.of(drop, record.instrument, load, record.model_floor))
    return FirstLook(
        drops,
        first.poisson_ratio,
        first.density,
        first.bedrock_depth,
        records.elastic,
        math.nan,
    )


class Problem:
    """Points with effects, as residuals of unknowns.

    Parameters
    ----------
    points : sequence of Point
    effects : sequence of Effect, in the order in which they act
    fixed : mapping of device effects that are given, by name
    scope : FitScope, what counts
    local : sequence of sequences of Effect, what each point has; None: all have all
    left_out : set of (point, drop), which count for nothing
    prior_weight : float, weighted residual that one standard deviation from a prior counts as; 0:
        priors do not count
    held : places of a point's unknowns, the device's first, that stay as they are
    spread : mapping of deviations of what is given, by effect and parameter: it may move so far;
        what has none is held
    scales : of each point, by what its residuals are divided: what leaves much tells little of what
        points share; None: all count alike
    """

    def __init__(
        self,
        points: Sequence[Point],
        effects: Sequence[Effect],
        fixed: dict[str, dict[str, float]] | None = None,
        *,
        scope: FitScope = WHOLE,
        local: Sequence[Sequence[Effect]] | None = None,
        left_out: Collection[tuple[int, int]] = (),
        prior_weight: float = 0.0,
        held: Collection[int] = (),
        spread: Mapping[str, Mapping[str, float]] | None = None,
        scales: Sequence[float] | None = None,
    ) -> None:
        self.prior_weight = prior_weight
        self.scales = scales
        self.points = tuple(points)
        self.effects = tuple(effects)
        self.fixed = fixed or {}
        self.scope = scope
        self.left_out = frozenset(left_out)
        self.held = frozenset(held)
        self.spread = spread or {}
        self.device = [
            Unknown(p, effect)
            for effect in effects
            if effect.scope == "device"
            for p in self._fitted(effect)
        ]
        self.local = local
        of_points = local or [self.effects] * len(self.points)
        self.own = [point.unknowns(own) for point, own in zip(self.points, of_points, strict=True)]
        self.solves = 0
        self._residuals: dict[_Place, FloatArray] = {}
        self._jacobians: dict[_Place, FloatArray] = {}

    def of_one_drop(self, drop: int) -> Problem:
        """The same unknowns of a single point, of which one drop alone counts."""
        others = range(len(self.points[0].drops))
        return Problem(
            self.points,
            self.effects,
            self.fixed,
            scope=self.scope,
            left_out=[(0, other) for other in others if other != drop],
            held=self.held,
            spread=self.spread,
        )

    def _fitted(self, effect: Effect) -> Sequence[Parameter]:
        """Parameters of a device effect that are fitted; given ones beside what is given."""
        given, deviations = self.fixed.get(effect.name), self.spread.get(effect.name, {})
        if given is None:
            return effect.parameters
        return [
            p.held_to(given[p.name], deviations[p.name])
            for p in effect.parameters
            if p.name in given and deviations.get(p.name, 0.0) > 0.0
        ]

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.device) + sum(map(len, self.own))

    def values(self, index: int, device: FloatArray, own: FloatArray, drop: int) -> Active:
        """Effects with their values for one drop of a point."""
        by_effect: dict[str, dict[str, float]] = {n: dict(v) for n, v in self.fixed.items()}
        for unknown, unit_value in zip(self.device, device, strict=True):
            assert unknown.effect is not None
            by_effect.setdefault(unknown.effect.name, {})[unknown.parameter.name] = float(
                unknown.parameter.value(unit_value)
            )
        for unknown, unit_value in zip(self.own[index], own, strict=True):
            if unknown.effect is not None and unknown.drop in (None, drop):
                values = by_effect.setdefault(unknown.effect.name, {})
                values[unknown.parameter.name] = float(unknown.parameter.value(unit_value))
        context = self.points[index].drops[drop].context
        return [
            (effect, by_effect[effect.name])
            for effect in self.effects
            if effect.name in by_effect and effect.acts_on(context)
        ]

    def predict(self, index: int, device: FloatArray, own: FloatArray) -> list[FloatArray]:
        """What each drop of a point would show, (n_sensors, n), m."""
        return [
            self.predict_drop(index, device, own, number)[:, model.before :]
            for number, model in enumerate(self.points[index].drops)
        ]

    def predict_drop(
        self, index: int, device: FloatArray, own: FloatArray, number: int
    ) -> FloatArray:
        """What one drop would show, see `DropModel.predict`, (n_sensors, before + n), m."""
        point = self.points[index]
        self.solves += 1
        values = self.values(index, device, own, number)
        return point.drops[number].predict(point.ground(self.own[index], own), values)

    def residual(self, index: int, device: FloatArray, own: FloatArray) -> FloatArray:
        """Of a point, (n,); see `DropModel.weighted_residual`.  The priors' stand last."""
        left = self._data_residual(index, device, own)
        return np.concatenate([left, self._from_priors(index, device, own)[0]])

    def _data_residual(self, index: int, device: FloatArray, own: FloatArray) -> FloatArray:
        """What the data of a point leave, (n,); remembered, as a fit goes on where one ended."""
        place = index, device.tobytes(), own.tobytes()
        known = self._residuals.get(place)
        if known is None:
            known = np.concatenate(self._residuals_of_drops(index, device, own))
            known /= self._scale(index)
            _keep(self._residuals, place, known, _RESIDUALS)
        return known

    def _scale(self, index: int) -> float:
        return 1.0 if self.scales is None else self.scales[index]

    def _residuals_of_drops(
        self, index: int, device: FloatArray, own: FloatArray
    ) -> list[FloatArray]:
        """Of each drop that counts, (n,)."""
        point = self.points[index]
        drops = self._drops(index, device, own)
        point.look_ahead(drops)
        self.solves += len(drops)
        found = []
        for number, ground, active in drops:
            model = point.drops[number]
            predicted = model.predict(ground, active)
            found.append(model.weighted_residual(predicted, self.scope))
        return found

    def _drops(
        self, index: int, device: FloatArray, own: FloatArray
    ) -> list[tuple[int, Ground, Active]]:
        """Number, ground and effects of each drop of a point that counts."""
        ground = self.points[index].ground(self.own[index], own)
        return [
            (number, ground, self.values(index, device, own, number))
            for number in range(len(self.points[index].drops))
            if (index, number) not in self.left_out
        ]

    def data_cost(self, device: FloatArray, owns: Sequence[FloatArray]) -> float:
        """Sum of squares of what the data leave, without the priors."""
        lefts = [self._data_residual(index, device, own) for index, own in enumerate(owns)]
        return sum(float(left @ left) for left in lefts)

    def _from_priors(
        self, index: int, device: FloatArray, own: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Residuals of the priors, (d + k,), and their slopes; the device's with the first point.

        Empty where priors do not count.
        """
        if self.prior_weight == 0.0:
            return np.empty(0), np.empty(0)
        pairs = [u.parameter.from_prior(float(x)) for u, x in zip(self.device, device, strict=True)]
        if index:
            pairs = [(0.0, 0.0)] * len(pairs)
        pairs += [
            u.parameter.from_prior(float(x)) for u, x in zip(self.own[index], own, strict=True)
        ]
        found = self.prior_weight * np.array(pairs).reshape(-1, 2)
        return found[:, 0], found[:, 1]

    def residual_drop(
        self, index: int, device: FloatArray, own: FloatArray, number: int
    ) -> FloatArray:
        """Of one drop, (n,); empty when the drop is left out."""
        if (index, number) in self.left_out:
            return np.empty(0)
        predicted = self.predict_drop(index, device, own, number)
        model = self.points[index].drops[number]
        return model.weighted_residual(predicted, self.scope)

    @property
    def independent(self) -> float:
        """Number of independent samples of all that counts."""
        return sum(
            model.independent(self.scope)
            for index, point in enumerate(self.points)
            for number, model in enumerate(point.drops)
            if (index, number) not in self.left_out
        )

    def over_noise(self, index: int, device: FloatArray, own: FloatArray) -> float:
        """Root mean square of a point's residual over its noise."""
        total, count = 0.0, 0
        for model, predicted in zip(
            self.points[index].drops, self.predict(index, device, own), strict=True
        ):
            window = model.window(contact_only=self.scope.contact_only)
            left = (predicted - model.observed)[:, window] / model.noise[:, None]
            total, count = total + float(np.sum(left**2)), count + left.size
        return math.sqrt(total / count)

    def jacobian(
        self, index: int, device: FloatArray, own: FloatArray, there: FloatArray
    ) -> FloatArray:
        """Of a point's residual in the unit_values of the device and its own, (n, d + k).

        By differences; a unit_value that belongs to one drop moves that drop alone.
        """
        place = index, device.tobytes(), own.tobytes()
        known = self._jacobians.get(place)
        slopes = self._from_priors(index, device, own)[1]
        if slopes.size:
            slopes[list(self.held)] = 0.0
        if known is None:
            known = self._data_jacobian(index, device, own, there[: there.size - slopes.size])
            _keep(self._jacobians, place, known, _JACOBIANS)
        result = np.zeros((there.size, device.size + own.size))
        result[: known.shape[0]] = known
        result[known.shape[0] :][np.diag_indices(slopes.size)] = slopes
        return result

    def _data_jacobian(
        self, index: int, device: FloatArray, own: FloatArray, there: FloatArray
    ) -> FloatArray:
        """Of what the data of a point leave, (n, d + k)."""
        point = self.points[index]
        rows = np.cumsum([0, *self.sizes(index)])
        result = np.zeros((there.size, device.size + own.size))
        unknowns = [*self.device, *self.own[index]]
        here = np.concatenate([device, own])
        # Away from the nearer bound, or jump.
        middles = [
            0.5 * sum(unknown.parameter.stretch(float(x)))
            for unknown, x in zip(unknowns, here, strict=True)
        ]
        steps = np.where(here > np.array(middles), -_STEP, _STEP)
        drops = self._drops(index, device, own)
        point.look_ahead(drops, nearby=True)
        for number, ground, active in drops:
            model = point.drops[number]
            columns = [
                i
                for i, unknown in enumerate(unknowns)
                if unknown.drop in (None, number) and i not in self.held
            ]
            if not columns:
                continue
            moved = []
            for column in columns:
                changed = here[column] + steps[column]
                unknown = unknowns[column]
                if unknown.effect is None:
                    other = here[device.size :].copy()
                    other[column - device.size] = changed
                    moved.append((point.ground(self.own[index], other), active))
                else:
                    value = float(unknown.parameter.value(changed))
                    moved.append((ground, _with_value(active, unknown, value)))
            predicted = model.predict_nearby(ground, active, moved)
            self.solves += len(columns)
            there_moved = model.weighted_residuals(predicted, self.scope)
            there_moved /= self._scale(index)
            part = slice(rows[number], rows[number + 1])
            result[part, columns] = ((there_moved - there[part]) / steps[columns, None]).T
        return result

    def sizes(self, index: int) -> list[int]:
        """Number of residuals of each drop of a point."""
        sizes = []
        for number, model in enumerate(self.points[index].drops):
            size = model.weighted_size(self.scope)
            sizes.append(0 if (index, number) in self.left_out else size)
        return sizes


def _keep(memory: dict[_Place, FloatArray], place: _Place, value: FloatArray, most: int) -> None:
    if len(memory) >= most:
        memory.pop(next(iter(memory)))
    memory[place] = value


def _with_value(active: Active, unknown: Unknown, value: float) -> Active:
    """Effects with another value of an unknown; what is as it was is the same object."""
    return [
        (effect, {**values, unknown.parameter.name: value} if effect is unknown.effect else values)
        for effect, values in active
    ]
