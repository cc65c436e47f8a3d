"""Model of the drops of a point, as a function of unknowns with normal priors.

Unknowns are properties of the ground and coordinates of effects. Each is either common to the drops
of the point, or the deviation of one drop from the point.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from inversion.arrays import FloatArray, exponential
from inversion.diagnosis.model import DropModel
from inversion.diagnosis.problem import Point
from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.effects.parameters import Coordinate
from inversion.effects.rebound import Rebound

Name = tuple[str, str]
"""Name of the effect ("" for the ground), and name of the coordinate."""
Key = tuple[str, str, int | None]
"""Name of the effect ("" for the ground), name of the coordinate, and drop counted from the last
fitted one (None: all drops)."""
Prior = tuple[float, float]
"""Mean and standard deviation."""
ActiveEffects = list[tuple[Effect, dict[str, float]]]

GROUND_EFFECT = ""
STIFFNESS: Name = (GROUND_EFFECT, "modulus")

# Priors of the ground: mean and standard deviation of the logarithm of the density, kg/m3, of soils
# and granular fills from loose and dry to dense and wet; mean of viscosity over modulus, s.
_LOG_DENSITY_PRIOR = (math.log(1900.0), 0.12)
_TYPICAL_RELAXATION_S = 1.0e-3
# Prior standard deviations of the logarithm of the modulus, about that of the peak method, and of
# the logarithm of the relaxation time.
_MODULUS_DEVIATION, _RELAXATION_DEVIATION = 0.8, 1.0
# Prior standard deviations of the logarithm of the modulus over that under the last drop: for the
# first of several drops, and for later ones.
_SEATING_DEVIATION, _LATER_DEVIATION = 0.5, 0.1
_DENSITY_DEVIATIONS = 4.0
# Range of the starting value of the logarithm of a stiffness ratio. Later drops start at this
# fraction of the logarithm of the ratio of the peak moduli.
_STARTING_RATIOS, _LATER_SHARE = (-1.5, 0.5), 0.7
# Step of numerical derivatives, in prior standard deviations of the coordinate.
_STEP_OVER_PRIOR_SD = 3e-4


@dataclass(frozen=True)
class Unknown:
    """Unknown number of a point or of one of its drops.

    Parameters
    ----------
    effect : str, name; "": the ground
    coordinate : Coordinate
    drop : int or None, index of the drop whose deviation from the point this is; None: common to
        all drops
    key : Key
    """

    effect: str
    coordinate: Coordinate
    drop: int | None
    key: Key

    @property
    def name(self) -> Name:
        """Effect and coordinate."""
        return self.effect, self.coordinate.name


class PointModel:
    """Predictions of some drops of a point as a function of the unknowns.

    Parameters
    ----------
    point : Point
    effects : sequence of Effect, in the order in which they act; effects that no fitted drop can
        show are omitted
    drops : sequence of int, indices of the drops that are fitted
    declared_effects : declared values of effects, by effect and parameter
    variant : int, index of the starting point of each coordinate
    is_same_ground : bool, True: all drops have the same ground
    """

    def __init__(
        self,
        point: Point,
        effects: Sequence[Effect],
        drops: Sequence[int],
        declared_effects: Mapping[str, Values] | None = None,
        variant: int = 0,
        *,
        is_same_ground: bool = False,
    ) -> None:
        self.point = point
        self.drops = tuple(drops)
        declared = declared_effects or {}
        self.effects = tuple(
            effect
            for effect in effects
            if effect.name in declared or effect.parameters_for(self._context(effect))
        )
        self.is_same_ground = is_same_ground or len(self.drops) == 1
        self._declared_effects = declared
        self._has_ground = not any(effect.replaces_ground for effect in effects)
        self.unknowns = (*self._point_unknowns(), *self._drop_unknowns())
        self._owners = [(*unknown.name, unknown.drop) for unknown in self.unknowns]
        self.keys = [unknown.key for unknown in self.unknowns]
        coordinates = [unknown.coordinate for unknown in self.unknowns]
        self.lower = np.array([c.lower for c in coordinates])
        self.upper = np.array([c.upper for c in coordinates])
        self.mean = np.array([c.mean for c in coordinates])
        self.deviation = np.array([c.deviation for c in coordinates])
        self.start = np.array([self._start(unknown, variant) for unknown in self.unknowns])
        self.step = _STEP_OVER_PRIOR_SD * self.deviation

    @property
    def last(self) -> int:
        """Index of the last fitted drop."""
        return self.drops[-1]

    def apply_priors(self, priors: Mapping[Key, Prior]) -> None:
        """Replace the priors of some unknowns, and start fits at the new means."""
        for place, key in enumerate(self.keys):
            if key in priors:
                self.mean[place], self.deviation[place] = priors[key]
                self.start[place] = np.clip(self.mean[place], self.lower[place], self.upper[place])

    def start_from(self, by_key: Mapping[Key, float]) -> FloatArray:
        """Return a starting point with the values of another fit for common unknowns."""
        values = [by_key.get(key, start) for key, start in zip(self.keys, self.start, strict=True)]
        result: FloatArray = np.clip(values, self.lower, self.upper)
        return result

    def is_seating(self, drop: int) -> bool:
        """Return whether a drop is the first of several fitted drops of its point."""
        return drop == 0 and len(self.drops) > 1

    def _peak_ratio(self, drop: int) -> float:
        """Return the logarithm of a drop's peak stiffness over that of the last drop."""
        return math.log(self._peak_modulus(drop) / self._peak_modulus(self.last))

    def _peak_modulus(self, drop: int) -> float:
        """Return the peak load over the peak deflection, N/m, a measure of the stiffness."""
        model = self.point.drops[drop]
        return model.drop.peak_load / max(model.peak_in_contact, 1e-9)

    def _point_unknowns(self) -> list[Unknown]:
        """Return the unknowns that all drops of the point share."""
        shared: list[tuple[str, Coordinate]] = []
        if self._has_ground:
            shared += [(GROUND_EFFECT, coordinate) for coordinate in self._soil()]
        for effect in self.effects:
            if effect.name not in self._declared_effects:
                shared += [(effect.name, c) for c in effect.coordinates(self._context(effect))]
        return [
            Unknown(effect, coordinate, None, (effect, coordinate.name, None))
            for effect, coordinate in shared
        ]

    def _context(self, effect: Effect) -> DropContext:
        """Return the context of the last drop that shows an effect, or else of the last drop."""
        contexts = [self.point.drops[drop].context for drop in reversed(self.drops)]
        return next((c for c in contexts if effect.parameters_for(c)), contexts[0])

    def _soil(self) -> list[Coordinate]:
        """Return the unknowns of the soil: log modulus ratio, relaxation time and density."""
        start = self._reference_modulus_ratio()
        soil = [Coordinate("modulus", start, _MODULUS_DEVIATION)]
        if not self.point.records.elastic:
            relaxation = math.log(_TYPICAL_RELAXATION_S)
            soil.append(Coordinate("relaxation", relaxation, _RELAXATION_DEVIATION))
        if self.point.records.records[0].density is None:
            mean, deviation = _LOG_DENSITY_PRIOR
            reach = _DENSITY_DEVIATIONS * deviation
            soil.append(Coordinate("density", mean, deviation, mean - reach, mean + 0.75 * reach))
        return soil

    def _reference_modulus_ratio(self) -> float:
        """Return the log median stiffness of the fitted drops over that of all."""
        fitted = np.median([math.log(self._peak_modulus(d)) for d in self.drops])
        every = np.median([math.log(self._peak_modulus(d)) for d in range(len(self.point.drops))])
        return float(fitted - every)

    def _drop_unknowns(self) -> list[Unknown]:
        """Return the unknowns that are deviations of single drops from the point."""
        deviations = []
        for drop in self.drops:
            seating = self.is_seating(drop)
            if drop != self.last and not self.is_same_ground:
                deviation = _SEATING_DEVIATION if seating else _LATER_DEVIATION
                deviations.append((*STIFFNESS, drop, deviation))
            for effect in self.effects if len(self.drops) > 1 else ():
                if effect.name in self._declared_effects:
                    continue
                for name, (first, later) in effect.drop_deviations.items():
                    deviations.append((effect.name, name, drop, first if seating else later))
        return [
            Unknown(
                effect, Coordinate(name, 0.0, deviation), drop, (effect, name, drop - self.last)
            )
            for effect, name, drop, deviation in deviations
        ]

    def ground_and_effects(
        self, values: FloatArray, drop: int | None, stiffening: float = 0.0
    ) -> tuple[Ground, ActiveEffects]:
        """Return the ground and the effects of a drop, with the values of their parameters.

        Parameters
        ----------
        values : (k,) ndarray of float, of the unknowns; with (m, k) the properties of ground and
            effects are arrays (m,)
        drop : int or None, index of a fitted drop; None: a drop without deviations
        stiffening : float, logarithm of its stiffness over that of the last fitted drop
        """
        by_effect, change = self._by_effect(values, drop)
        change += stiffening
        active = [
            (effect, self._values_of(effect, by_effect.get(effect.name, {}), change))
            for effect in self.effects
        ]
        return self._ground(by_effect.get(GROUND_EFFECT, {}), change), active

    def changed_ground(self, values: FloatArray) -> Ground:
        """Return the ground under the last drop, including layers and rock from effects."""
        ground, active = self.ground_and_effects(values, self.last)
        for effect, numbers in active:
            ground = effect.ground(ground, numbers, self.context)
        return ground

    @property
    def context(self) -> DropContext:
        """What the effects know of the last drop."""
        return self.point.drops[self.last].context

    def _by_effect(
        self, values: FloatArray, drop: int | None
    ) -> tuple[dict[str, dict[str, float]], float]:
        """Return the coordinates of each effect for a drop, and the change of its log stiffness."""
        by_effect: dict[str, dict[str, float]] = {}
        change = 0.0
        columns: Any = values.tolist() if values.ndim == 1 else values.T
        for (owner, coordinate, of_drop), value in zip(self._owners, columns, strict=True):
            if of_drop is None:
                by_effect.setdefault(owner, {})[coordinate] = value
            elif of_drop == drop:
                if (owner, coordinate) == STIFFNESS:
                    change += value
                else:
                    by_effect[owner][coordinate] += value
        return by_effect, change

    def _values_of(
        self, effect: Effect, coordinates: Mapping[str, float], change: float
    ) -> dict[str, float]:
        """Return the values of an effect's parameters, at coordinates if they are not declared."""
        declared = self._declared_effects.get(effect.name)
        parameters = effect.values_at(coordinates) if declared is None else dict(declared)
        if effect.replaces_ground:
            parameters["stiffness"] *= math.exp(change)
        return parameters

    def _ground(self, soil: Mapping[str, float], change: float) -> Ground:
        record = self.point.records.records[0]
        modulus = self.point.peak_modulus * exponential(soil.get("modulus", 0.0) + change)
        relaxation = exponential(soil["relaxation"]) if "relaxation" in soil else 0.0
        density = record.density
        if density is None:
            density = exponential(soil.get("density", _LOG_DENSITY_PRIOR[0]))
        depth = record.bedrock_depth
        return Ground(
            modulus=modulus,
            viscosity=modulus * relaxation,
            density=density,
            inverse_depth=0.0 if depth is None or math.isinf(depth) else 1.0 / depth,
            plate_mass=record.instrument.plate_mass,
        )

    def _start(self, unknown: Unknown, variant: int) -> float:
        """Return the starting value of an unknown; that of a stiffness ratio is from the peaks."""
        if unknown.drop is None or unknown.name != STIFFNESS:
            return unknown.coordinate.start(variant)
        share = 1.0 if self.is_seating(unknown.drop) else _LATER_SHARE
        return share * float(np.clip(self._peak_ratio(unknown.drop), *_STARTING_RATIOS))

    def take_off_speed(self, values: FloatArray, drop: int) -> float | None:
        """Return the upward speed at which the plate leaves the ground, m/s; None: it does not."""
        ground, active = self.ground_and_effects(values, drop)
        return take_off_speed(self.point.drops[drop], ground, active)

    def predict(self, values: FloatArray, drop: int) -> FloatArray:
        """Return the recorded displacement of a fitted drop, (n_sensors, n), m."""
        model = self.point.drops[drop]
        return model.predict(*self.ground_and_effects(values, drop))[:, model.before :]

    def linearise(
        self, values: FloatArray, drop: int, held: Collection[str] = ()
    ) -> tuple[FloatArray, FloatArray]:
        """Return a drop's prediction, (n_sensors, n), m, and derivatives, (k, n_sensors, n).

        Parameters
        ----------
        values : (k,) ndarray of float
        drop : int, index of the drop
        held : names of effects whose unknowns are fixed; their derivatives are zero
        """
        model = self.point.drops[drop]
        start = self.ground_and_effects(values, drop)
        by_effect, change = self._by_effect(values, drop)
        columns = [
            place
            for place, unknown in enumerate(self.unknowns)
            if unknown.drop in (None, drop) and unknown.effect not in held
        ]
        steps, moved = [], [start]
        for column in columns:
            step = float(self.step[column])
            if values[column] + step > self.upper[column]:
                step = -step
            steps.append(step)
            owner, coordinate, of_drop = self._owners[column]
            if of_drop is not None and (owner, coordinate) == STIFFNESS:
                moved.append(self.ground_and_effects(values, drop, step))
                continue
            coordinates = by_effect[owner] | {coordinate: by_effect[owner][coordinate] + step}
            moved.append(self._with_coordinates(start, owner, coordinates, change))
        prediction, *nearby = model.predict_nearby(*start, moved)[:, :, model.before :]
        slopes = np.zeros((values.size, *prediction.shape))
        if columns:
            slopes[columns] = (np.stack(nearby) - prediction) / np.array(steps)[:, None, None]
        return prediction, np.nan_to_num(slopes, nan=0.0, posinf=0.0, neginf=0.0)

    def _with_coordinates(
        self,
        start: tuple[Ground, ActiveEffects],
        owner: str,
        coordinates: Mapping[str, float],
        change: float,
    ) -> tuple[Ground, ActiveEffects]:
        """Return ground and effects with other coordinates of the ground or of one effect.

        The other objects are those of the start, which tells `DropModel.predict_nearby` what has
        not changed.
        """
        ground, active = start
        if owner == GROUND_EFFECT:
            return self._ground(coordinates, change), active
        return ground, [
            (effect, self._values_of(effect, coordinates, change))
            if effect.name == owner
            else (effect, values)
            for effect, values in active
        ]


def take_off_speed(
    model: DropModel, ground: Ground, active: Sequence[tuple[Effect, Values]]
) -> float | None:
    """Return the upward speed at which the plate leaves the ground, m/s; None: it does not."""
    for effect, values in active:
        if isinstance(effect, Rebound):
            motion = model.ground_motion(ground, active)
            return effect.take_off_speed(motion, values, model.context)
    return None
