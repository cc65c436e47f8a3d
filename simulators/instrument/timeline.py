"""Schedule of the simulated drops, and samples of a stream as counts of the converter.

A stream is a run of samples from a start of the instrument to the next. Its samples are a function
of scenario, seed and index. They do not depend on the time or the size of requests, because they
are computed in pages at fixed indices, and every random number belongs to an index or to a drop.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfwd_plugins.quantities import QUANTITY_BY_ROLE
from simulators.drop import STANDARD_GRAVITY
from simulators.instrument.response import MAX_RESPONSE_S, DropResponse, channel_gain
from simulators.instrument.scenario import Scenario
from simulators.instrument.units import UNIT_DROP_STEP_S, UnitDrops
from simulators.mesh import Array

PAGE = 4096
"""Number of samples that are computed together."""
NOISE_PERIODS = (65_521, 32_749)
"""Lengths of the two tables of noise, in samples. They are prime numbers, so that the sum of the
tables repeats only after two billion samples."""
HUM_HARMONICS = ((1, 1.0), (3, 0.35), (5, 0.15))
"""Order and relative amplitude of the harmonics of the mains hum."""
WANDER_PERIODS = (211.0, 67.0, 23.0)
"""Periods of the sine waves of which a slow drift consists, s."""
_DROPS, _NOISE, _WANDER = 1, 2, 3  # streams of random numbers


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
    units : UnitDrops, optional
        Computed drops, needed if the spring of the hammer is damped.
    """

    def __init__(self, scenario: Scenario, seed: int, units: UnitDrops | None = None) -> None:
        self._settings = scenario.drops
        self._hammer = scenario.hammer
        self._units = units
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

    def shift(self, number: int) -> float:
        """Return the deviation of the first touch of a drop from the regular interval, s."""
        generator = np.random.default_rng([self._seed, _DROPS, number])
        return self._settings.jitter * float(generator.uniform(-1, 1))

    def _drop(self, number: int) -> PlannedDrop:
        settings = self._settings
        generator = np.random.default_rng([self._seed, _DROPS, number])
        generator.uniform(-1, 1)  # the number of `shift`
        factor = max(0.2, 1 + settings.height_scatter * float(generator.standard_normal()))
        count = int(generator.integers(settings.bounces[0], settings.bounces[1], endpoint=True))
        impacts = [Impact(0.0, factor)]
        wait_low, wait_high = settings.bounce_interval
        ratio_low, ratio_high = settings.bounce_ratio
        for _ in range(count):
            last = impacts[-1]
            wait = float(generator.uniform(wait_low, wait_high))
            ratio = float(generator.uniform(ratio_low, ratio_high))
            if self._hammer.damping:
                wait, ratio = self._rebound(last.factor, self.modulus_factor(number))
            impacts.append(Impact(last.delay + wait, last.factor * ratio))
        knock = None
        if generator.uniform() < settings.knock_probability:
            when = float(generator.uniform(0.5, 0.7)) * settings.interval
            knock = Knock(when, settings.knock_load * float(generator.uniform(0.7, 1.0)))
        return PlannedDrop(number, self.modulus_factor(number), tuple(impacts), knock)

    def _rebound(self, factor: float, modulus_factor: float) -> tuple[float, float]:
        """Return the time to the next touch, s, and its speed relative to that of this touch.

        The impulse of the contact is the change of the hammer's momentum and its weight. Friction
        adds to the weight in the rise, and takes from it in the fall.
        """
        assert self._units is not None  # the hammer is damped
        hammer, load = self._hammer, self._units.get(modulus_factor).load
        contact = UNIT_DROP_STEP_S * int(np.count_nonzero(load > 0))
        impulse = UNIT_DROP_STEP_S * float(np.sum(load))
        speed = impulse / hammer.mass - STANDARD_GRAVITY * contact - hammer.velocity
        rise = factor * speed / (STANDARD_GRAVITY * (1 + hammer.friction))
        ratio = math.sqrt((1 - hammer.friction) / (1 + hammer.friction))
        return contact + rise * (1 + 1 / ratio), speed * ratio / hammer.velocity


class Bench:
    """Data that all streams of a simulated instrument share: responses to drops, noise, schedule.

    Parameters
    ----------
    scenario : Scenario
    units : UnitDrops
        Computed drops from the height of the scenario, which may still be in computation.
    seed : int
        Seed of the random numbers.
    """

    def __init__(self, scenario: Scenario, units: UnitDrops, seed: int) -> None:
        self.scenario, self.seed = scenario, seed
        self._units = units
        self._responses: dict[float, DropResponse] = {}
        self.schedule = Schedule(scenario, seed, units)
        channels = scenario.device.channels
        self.gains = np.array([channel_gain(c, scenario.effects) for c in channels])
        self.sensitivities = np.array([channel.sensitivity for channel in channels])
        generator = np.random.default_rng([seed, _NOISE])
        # Two tables of equal variance. The noise arises in the amplifiers, so the undeclared gains
        # of the sensors do not change it.
        noise = self.sensitivities * [channel.noise for channel in channels] / math.sqrt(2)
        self.noise = [
            (generator.standard_normal((period, len(channels))) * noise).astype(np.float32)
            for period in NOISE_PERIODS
        ]
        phases = np.random.default_rng([seed, _WANDER]).uniform(
            0, 2 * math.pi, (len(WANDER_PERIODS), len(channels))
        )
        self.wander_phases = phases

    def ready(self, factor: float) -> bool:
        """Return True if the drop on soil with `factor` times the modulus has been computed."""
        return self._units.ready(factor)

    def response(self, factor: float) -> DropResponse:
        """Return the readings in a drop on soil with `factor` times the modulus.

        The call waits until the drop has been computed.
        """
        if factor not in self._responses:
            self._responses[factor] = DropResponse(self.scenario, self._units.get(factor))
        return self._responses[factor]

    def peaks(self, factor: float) -> tuple[float, float]:
        """Return peak load (N) and peak displacement at the first sensor (m) in a drop.

        The drop is from the height of the scenario, on soil with `factor` times the modulus.
        """
        unit = self._units.get(factor)
        sensors = [
            row
            for row, channel in enumerate(self.scenario.device.channels)
            if QUANTITY_BY_ROLE[channel.role].is_motion
        ]
        deflection = float(np.max(unit.displacement[sensors[0]])) if sensors else math.nan
        return float(np.max(unit.load)), deflection

    def truth(self, number: int) -> dict[str, Any]:
        """Return the true soil and the true peaks of a drop, in SI units, with units in the keys.

        Parameters
        ----------
        number : int
            Number of the drop, from 1.
        """
        soil, planned = self.scenario.soil, self.schedule.drop(number)
        factor = planned.impacts[0].factor
        load, deflection = self.peaks(planned.modulus_factor)
        return {
            "drop": number,
            "modulus_pa": soil.modulus * planned.modulus_factor,
            "viscosity_pa_s": soil.viscosity,
            "density_kg_m3": soil.density,
            "poisson_ratio": soil.poisson_ratio,
            "bedrock_depth_m": None if math.isinf(soil.bedrock_depth) else soil.bedrock_depth,
            "peak_load_n": factor * load,
            "peak_displacement_m": None if math.isnan(deflection) else factor * deflection,
            "seating": planned.modulus_factor != 1.0,
            "rebounds": len(planned.impacts) - 1,
        }


class Timeline:
    """Samples of one stream of a simulated instrument.

    Parameters
    ----------
    bench : Bench
        Data that all streams share.
    sampling_rate : float, Hz
    first_drop : int
        Number of the first drop in this stream.
    last_drop : int or None
        Number of the last drop; None: there is no last one.
    knocks : tuple of Knock
        Knocks in addition to those of the schedule, with their times in the stream.
    """

    def __init__(
        self,
        bench: Bench,
        sampling_rate: float,
        first_drop: int = 1,
        last_drop: int | None = None,
        knocks: tuple[Knock, ...] = (),
    ) -> None:
        self._bench = bench
        self._rate = sampling_rate
        self._first, self._last = first_drop, last_drop
        self._knocks = knocks
        self._page = (-1, np.zeros((0, 0), np.int32))
        device, settings = bench.scenario.device, bench.scenario.drops
        self._drops = settings
        self._volts_per_count = device.adc_range / (1 << (device.adc_bits - 1))
        self._limits = (-(1 << (device.adc_bits - 1)), (1 << (device.adc_bits - 1)) - 1)
        channels, sensed = device.channels, bench.sensitivities * bench.gains
        self._rest = np.array([c.zero for c in channels]) + sensed * [c.rest for c in channels]
        self._hum = bench.sensitivities * [c.hum for c in channels]
        self._wander = bench.sensitivities * [c.drift for c in channels] / len(WANDER_PERIODS)
        self._sensed = sensed

    def touch(self, number: int) -> float:
        """Return the time in the stream of the first touch of a drop, s."""
        regular = self._drops.first + (number - self._first) * self._drops.interval
        return regular + self._bench.schedule.shift(number)

    def touch_index(self, number: int) -> int:
        """Return the index of the first sample at or after the touch of a drop."""
        return math.ceil(self.touch(number) * self._rate)

    def end_index(self) -> int | None:
        """Return the number of samples of the stream; None without a last drop.

        It ends some seconds after the last rebound of the last drop.
        """
        if self._last is None:
            return None
        quiet = self._drops.quiet
        if self._last < self._first:  # all drops were in earlier streams
            return math.ceil(quiet * self._rate)
        delay = self._longest_rebounds  # of a damped hammer, which may not be computed yet
        if not self._bench.scenario.hammer.damping:
            delay = self._bench.schedule.drop(self._last).impacts[-1].delay
        return math.ceil((self.touch(self._last) + delay + quiet) * self._rate)

    @property
    def _longest_rebounds(self) -> float:
        """Longest time from the touch of a drop to that of its last rebound, s."""
        hammer = self._bench.scenario.hammer
        flight = 2 * hammer.velocity / STANDARD_GRAVITY
        interval = flight if hammer.damping else self._drops.bounce_interval[1]
        return self._drops.bounces[1] * interval

    def counts(self, start: int, stop: int) -> NDArray[np.int32]:
        """Return the samples from index `start` to before `stop`, (stop - start, channels)."""
        parts = []
        while start < stop:
            number, offset = divmod(start, PAGE)
            if self._page[0] != number:
                self._page = (number, self._make(number))
            end = min(stop, (number + 1) * PAGE)
            parts.append(self._page[1][offset : offset + end - start])
            start = end
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _make(self, number: int) -> NDArray[np.int32]:
        start = number * PAGE
        volts = self._quiet(start)
        for touch, response, factor in self._impacts(start):
            low = max(start, math.ceil(touch * self._rate))
            high = min(start + PAGE, math.floor((touch + response.duration) * self._rate) + 1)
            if low < high:
                time = np.arange(low, high) / self._rate - touch
                inside = np.clip(time, 0.0, response.duration)
                volts[low - start : high - start] += factor * self._sensed * response.at(inside)
        counts = np.rint(volts / self._volts_per_count)
        return np.clip(counts, *self._limits).astype(np.int32)

    def _quiet(self, start: int) -> Array:
        """Return the voltages of a page without drops, (PAGE, channels), V."""
        index = np.arange(start, start + PAGE)
        volts = np.zeros((PAGE, self._rest.size))
        for table in self._bench.noise:
            volts += table[index % len(table)]
        volts += self._rest
        if np.any(self._hum):
            frequency = self._bench.scenario.device.hum_frequency
            phase = 2 * math.pi * ((index * (frequency / self._rate)) % 1.0)
            wave = sum(size * np.sin(order * phase) for order, size in HUM_HARMONICS)
            volts += np.multiply.outer(wave, self._hum)
        if np.any(self._wander):
            ends = np.array([start, start + PAGE]) / self._rate
            phases = self._bench.wander_phases
            knots = np.zeros((2, self._rest.size))
            for period, phase in zip(WANDER_PERIODS, phases, strict=True):
                turn = 2 * math.pi * ends[:, None] / period
                knots += np.sin(turn + phase) - np.sin(phase)  # zero at the start
            # A page is short compared with the periods, so the drift is linear within it.
            share = (np.arange(PAGE) / PAGE)[:, None]
            volts += self._wander * (knots[0] + share * (knots[1] - knots[0]))
        return volts

    def _impacts(self, start: int) -> Iterator[tuple[float, DropResponse, float]]:
        """Yield the impacts that affect a page: time of the touch (s), response and size factor."""
        begin, end = start / self._rate, (start + PAGE) / self._rate
        settings = self._drops
        # Longest time from the touch of a drop to the end of its effects: rebounds, the knock
        # before the next drop, and the ringing of the channels.
        span = max(self._longest_rebounds, settings.interval) + MAX_RESPONSE_S
        number = self._first
        if begin > span + settings.first:
            number += max(0, math.floor((begin - span - settings.first) / settings.interval) - 1)
        while self._last is None or number <= self._last:
            if settings.first + (number - self._first) * settings.interval > end + settings.jitter:
                break
            drop = self._bench.schedule.drop(number)
            response = self._bench.response(drop.modulus_factor)
            for impact in drop.impacts:
                yield self.touch(number) + impact.delay, response, impact.factor
            if drop.knock is not None:
                factor = drop.knock.load / self._bench.peaks(drop.modulus_factor)[0]
                yield self.touch(number) + drop.knock.time, response, factor
            number += 1
        # Knocks use the soil of the first drop, which is computed first.
        soil = self._bench.schedule.modulus_factor(self._first)
        for knock in self._knocks:
            if begin - MAX_RESPONSE_S < knock.time < end:
                factor = knock.load / self._bench.peaks(soil)[0]
                yield knock.time, self._bench.response(soil), factor
