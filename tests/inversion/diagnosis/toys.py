"""A point whose records are straight lines of what acts on them: its least squares are exact.

Problem, fit and search are the real ones; only the physics is replaced. Every effect has a
direction of its own among orthonormal ones, and so has the ground, so that what a set of effects
leaves can be written down.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from inversion.diagnosis import search as module
from inversion.diagnosis.fit import Fit
from inversion.diagnosis.model import WHOLE, FitScope
from inversion.diagnosis.problem import Point, Problem, Unknown
from inversion.diagnosis.search import Search
from inversion.effects import DropContext, Effect, Parameter
from inversion.effects.base import Ground, Values
from tests.inversion.effects.test_effects import context
from tests.inversion.synthetic import Array

Names = frozenset[str]

# Samples of a drop, of which the first half is the contact.
SAMPLES = 80
# Orthonormal directions: of the ground, of what nothing explains, and of effects by their letter.
_ALL = np.linalg.qr(np.random.default_rng(11).standard_normal((SAMPLES, 60)))[0].T
GROUND, NOISE, DIRECTIONS = _ALL[0], _ALL[1], _ALL[2:]
# The ground's own part of the record, and the true value of its unknown.
STIFF, TRUE_RATIO = 20.0, 2.0
SOIL = Parameter("modulus_ratio", "-", 0.1, 10.0, (1.0,), logarithmic=True)
SIZE = Parameter("size", "-", -100.0, 100.0, (10.0,), absent=0.0)


def direction(letter: str) -> Array:
    """Of an effect with this name: a letter, or a letter and a number for many."""
    place = "abcdefghij".index(letter[0])
    if len(letter) > 1:
        place = 10 + int(letter[1:])
    found: Array = DIRECTIONS[place]
    return found


class Toy(Effect):
    """An effect that moves the record along its direction, as another module would bring it."""

    scope = "point"
    advice = "none"
    parameters = (SIZE,)

    def __init__(self, name: str, along: Array | None = None, **attributes: Any) -> None:
        self.name = name  # type: ignore[misc]
        self._along = along
        for key, value in attributes.items():
            setattr(self, key, value)

    @property
    def along(self) -> Array:
        """Its direction, (n,)."""
        return direction(self.name) if self._along is None else self._along

    def record(self, record: Array, values: Values, drop: DropContext) -> Array:
        """Moved so far."""
        result: Array = record + values["size"] * self.along
        return result


class ToyDrop:
    """A drop whose record is the sum of what acts."""

    before = 0
    nonlinear_solves = 0
    is_loud = True

    def __init__(self, observed: Array, drop: DropContext) -> None:
        self.observed = observed[None]
        self.noise = np.ones(1)
        self.context = drop

    def predict(self, ground: Ground, active: Sequence[tuple[Effect, Values]]) -> Array:
        """The ground's part with the effects', (1, n)."""
        record: Array = STIFF * np.log(ground.modulus) * GROUND[None]
        for effect, values in active:
            record = effect.record(record, values, self.context)
        return record

    def predict_nearby(self, ground: Ground, active: Any, moved: Sequence[Any]) -> Array:
        """`predict` of others, (m, 1, n)."""
        return np.stack([self.predict(*other) for other in moved])

    def weighted_residual(self, predicted: Array, scope: FitScope = WHOLE) -> Array:
        """What is left, over noise of 1, (n,)."""
        found: Array = self.weighted_residuals(predicted[None], scope)[0]
        return found

    def weighted_residuals(self, predicted: Array, scope: FitScope = WHOLE) -> Array:
        """`weighted_residual` of many, (m, n)."""
        window = self.window(contact_only=scope.contact_only)
        found: Array = (predicted - self.observed)[:, 0, window]
        return found

    def residual_over_peak(self, predicted: Array, *, contact_only: bool) -> float:
        """Rms over the peak."""
        window = self.window(contact_only=contact_only)
        left = (predicted - self.observed)[:, window]
        return float(np.sqrt(np.mean(left**2)) / np.abs(self.observed).max())

    def window(self, *, contact_only: bool) -> slice:
        """Samples that count."""
        return slice(0, SAMPLES // 2 if contact_only else SAMPLES)

    def weighted_size(self, scope: FitScope = WHOLE) -> int:
        """How many."""
        return SAMPLES // 2 if scope.contact_only else SAMPLES

    def independent(self, scope: FitScope = WHOLE) -> float:
        """All of them: the noise is white."""
        return float(self.weighted_size(scope))


class ToyPoint(Point):
    """Drops with one unknown of the ground."""

    def __init__(self, drops: Sequence[Any]) -> None:
        self.drops = tuple(drops)

    def look_ahead(self, drops: Sequence[Any], *, nearby: bool = False) -> None:
        """Nothing is solved for."""

    def soil(self, below: bool = False) -> list[Unknown]:
        """The one."""
        return [Unknown(SOIL)]

    def ground(self, own: Sequence[Unknown], unit_values: Array) -> Ground:
        """Where there is an unknown of it; else a ground that does not show."""
        values = [
            float(unknown.parameter.value(unit))
            for unknown, unit in zip(own, unit_values, strict=True)
            if unknown.effect is None
        ]
        return Ground(values[0] if values else 1.0, 0.0, 1900.0, 0.0, 0.0)


def toy_point(
    *amounts: Mapping[str, float] | Array, rest: float = 1.0, ground: bool = True
) -> ToyPoint:
    """A point of one drop for each of the amounts.

    Parameters
    ----------
    amounts : of each direction in the record, by letter; or what is recorded beside the ground
    rest : float, rms of what no effect explains, over the noise
    ground : bool, whether the record has the ground's part
    """
    drops = []
    for index, amount in enumerate(amounts):
        record = rest * np.sqrt(SAMPLES) * NOISE
        if ground:
            record = record + STIFF * np.log(TRUE_RATIO) * GROUND
        if isinstance(amount, Mapping):
            for letter, size in amount.items():
                record = record + size * direction(letter)
        else:
            record = record + amount
        drops.append(ToyDrop(record, context(index=index, count=len(amounts))))
    return ToyPoint(drops)


class Bench:
    """Searches over toys; remembers which sets were fitted, and from where."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.tried: list[Names] = []
        self.starts: dict[Names, list[dict[str, float]]] = {}
        self.patch = patch
        self._fit = module.fit
        patch.setattr(module, "fit", self._remembered)

    def _remembered(
        self, problem: Problem, device: Array, own: Sequence[Array], iterations: int = 30
    ) -> Fit:
        names = frozenset(effect.name for effect in problem.effects)
        self.tried.append(names)
        unknowns = [*problem.device, *problem.own[0]]
        values = {
            f"{unknown.effect.name}.{unknown.parameter.name}": float(unknown.parameter.value(unit))
            for unknown, unit in zip(unknowns, [*device, *own[0]], strict=True)
            if unknown.effect is not None
        }
        self.starts.setdefault(names, []).append(values)
        return self._fit(problem, device, own, iterations)

    @staticmethod
    def search(
        effects: Collection[Effect],
        *amounts: Mapping[str, float] | Array,
        rest: float = 1.0,
        ground: bool = True,
        fixed: dict[str, dict[str, float]] | None = None,
    ) -> Search:
        """Over effects, on a point of these amounts."""
        return Search([toy_point(*amounts, rest=rest, ground=ground)], tuple(effects), fixed)


def worth(gain: float, unknowns: int = 1, rest: float = 1.0) -> float:
    """Amount of a direction whose effect lowers the criterion by so much, its unknowns paid."""
    factor = np.exp((gain + unknowns * np.log(SAMPLES)) / SAMPLES)
    return float(rest * np.sqrt(SAMPLES * (factor - 1.0)))


def found_values(found: Fit) -> dict[str, float]:
    """Values of the effects of a fit by effect and parameter; "": the ground's."""
    return {
        f"{unknown.effect.name if unknown.effect else ''}.{unknown.parameter.name}": float(
            unknown.parameter.value(unit)
        )
        for unknown, unit in zip(found.unknowns, found.unit_values, strict=True)
    }
