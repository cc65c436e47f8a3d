"""Schedule of the simulated drops: times, sizes and rebounds, given by a seed and the number."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from simulators.instrument.scenario import Scenario

_DROPS = 1  # stream of random numbers, different from those of other modules


@dataclass(frozen=True)
class Impact:
    """Impact of the hammer on the plate: the first touch of a drop, or a rebound."""

    delay: float
    """Time after the first touch of the drop, s."""
    factor: float
    """Size, relative to a drop from the height of the scenario."""


@dataclass(frozen=True)
class Knock:
    """Small impact on the plate that is not a drop."""

    time: float
    """Time in the stream, or after the touch of a drop, s."""
    load: float
    """Peak load, N."""


@dataclass(frozen=True)
class PlannedDrop:
    """Drop of the schedule with its rebounds."""

    number: int
    """Number of the drop, from 1."""
    shift: float
    """Deviation of the first touch from the regular interval, s."""
    modulus_factor: float
    """Modulus of the soil relative to the scenario; below 1 for the first drops of a point, which
    compact the surface."""
    impacts: tuple[Impact, ...]
    """Impact of the drop, then its rebounds."""
    knock: Knock | None = None
    """Knock before the next drop; its time counts from the touch of this one."""


class Schedule:
    """Schedule of the drops of a scenario.

    Parameters
    ----------
    scenario : Scenario
    seed : int
        Seed of the random numbers.
    """

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self._settings = scenario.drops
        self._seed = seed
        self.drop = lru_cache(maxsize=64)(self._drop)
        """Function that returns the planned drop with a number, from 1."""

    def modulus_factor(self, number: int) -> float:
        """Return the modulus of the soil under a drop, relative to the scenario.

        It is below 1 for the first drops of a point, which compact the surface.
        """
        settings = self._settings
        place = number - 1
        if settings.drops_per_point:
            place %= settings.drops_per_point
        return settings.seating[place] if place < len(settings.seating) else 1.0

    def _drop(self, number: int) -> PlannedDrop:
        settings = self._settings
        generator = np.random.default_rng([self._seed, _DROPS, number])
        shift = settings.jitter * float(generator.uniform(-1, 1))
        factor = max(0.2, 1 + settings.height_scatter * float(generator.standard_normal()))
        count = int(generator.integers(settings.bounces[0], settings.bounces[1], endpoint=True))
        impacts = [Impact(0.0, factor)]
        wait_low, wait_high = settings.bounce_interval
        ratio_low, ratio_high = settings.bounce_ratio
        for _ in range(count):
            last = impacts[-1]
            wait = float(generator.uniform(wait_low, wait_high))
            ratio = float(generator.uniform(ratio_low, ratio_high))
            impacts.append(Impact(last.delay + wait, last.factor * ratio))
        knock = None
        if generator.uniform() < settings.knock_probability:
            when = float(generator.uniform(0.5, 0.7)) * settings.interval
            knock = Knock(when, settings.knock_load * float(generator.uniform(0.7, 1.0)))
        return PlannedDrop(number, shift, self.modulus_factor(number), tuple(impacts), knock)
