"""Advice about a drop or a point, in words that a technician acts on.

From what is known within a second of the drop: its own record, the drops before it, and the first
fit. The advice for an effect of the diagnosis is that of `of_effect`.
"""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from pfwd.judging.drops import DropView
from pfwd.judging.job import Job
from pfwd.procedures import Kind, PointDrop, PointProgress
from pfwd.procedures.preconditions import presumed_load

MAX_LOAD_DIFFERENCE = 0.15
"""Part of the median load of the point's drops. Drops from one height repeat within a few percent;
the next catch of a guide rod is a fifth and more away."""

MIN_SETTLING = 0.10
"""Part by which the last averaged drop may move less than the first one before the plate counts as
not seated: with three drops that repeat to 3 % it is chance in one of a hundred points."""

MIN_SINKING = 0.10
"""The same for a last drop that moves more: the ground gives way under the plate."""

MIN_UNEVEN_RESIDUAL = 0.03
"""Residual over the peak during the contact, of a fit that is not explained by noise. Even plates
on simulated ground stay below 2 % (docs/validation.md)."""

UNEVEN_RATIO = 2.5
"""Times the median of the other drops of the survey. Real instruments on real ground leave 3 to
19 % drop after drop, by their own response and by layers: what stands out is the contact's."""

MIN_COMPARED_DROPS = 3
"""Drops that have a usual residual."""

MIN_UNEVEN_RESIDUAL_UNCOMPARED = 0.25
"""Residual without others to compare: more than any even drop of a real instrument left (0.19)."""

MIN_LOOSE_RESIDUAL = 0.015
"""Residual of one sensor over its own peak during the contact; sensors that sit leave 0.3 % of the
simulated instrument's drops, one that rings on its seat 2 to 5 %."""

LOOSE_RATIO = 2.0
"""Times the residual of the worst of the other sensors."""

MAX_RESIDUAL_OF_GOOD_SENSORS = 0.03
"""Residual of the other sensors up to which the model can show that one of them is wrong: where all
are fitted badly, the ground is another one."""


class Advised(StrEnum):
    """Subject of an advice."""

    LOAD = "load"
    """Drop from another height, or another stress than the procedure presumes."""
    SEATING = "seating"
    """Too few seating drops."""
    SINKING = "sinking"
    """The ground gives way."""
    CONTACT = "contact"
    """The plate rocks, or lies on a stone."""
    SENSOR = "sensor"
    """A sensor has lost its hold."""
    RANGE = "range"
    """A channel is at the end of its range."""


@dataclass(frozen=True, slots=True)
class Advice:
    """Advice with one step to take."""

    about: Advised
    text: str
    """One sentence."""
    drop: int | None = None
    """Number within the point; None: about the point."""


def advice_on_drop(
    job: Job,
    drop: DropView,
    neighbours: Sequence[DropView],
    *,
    contact_residual: float | None = None,
    survey_residuals: Sequence[float] = (),
    sensor_residuals: Mapping[int, float] | None = None,
    excluded_sensors: Sequence[int] = (),
    saturated: bool = False,
) -> list[Advice]:
    """Return the advice about one drop.

    Parameters
    ----------
    job : Job
    drop : DropView
    neighbours : sequence of DropView
        The other drops of its point.
    contact_residual : float, optional
        Of a fit that noise does not explain, over the peak; None: it is explained, or not there.
    survey_residuals : sequence of float
        The same of the other drops of the survey.
    sensor_residuals : mapping, optional
        The same of every sensor, over its own peak, by its number from 1.
    excluded_sensors : sequence of int
        Numbers of the faulty sensors, from 1.
    saturated : bool
        Whether the converter was at the end of its range.
    """
    number, facts = drop.facts.number, drop.facts
    if facts.kind is Kind.REJECTED:
        return []
    advice = [
        Advice(
            Advised.SENSOR,
            f"re-seat sensor {sensor}: it does not move with the ground",
            number,
        )
        for sensor in excluded_sensors
    ]
    loose = _loose_sensor(sensor_residuals or {})
    if loose is not None:
        text = f"re-seat sensor {loose}: it moves otherwise than the others and the ground"
        advice.append(Advice(Advised.SENSOR, text, number))
    if saturated:
        advice.append(Advice(Advised.RANGE, _OF_EFFECT["saturation"], number))
    advice += _load(job, drop, [neighbour.facts for neighbour in neighbours])
    if contact_residual is not None and _is_uneven(contact_residual, survey_residuals):
        text = (
            f"drop {number} does not press evenly: lift the plate, clear stones, turn it a quarter "
            "and press it flat"
        )
        advice.append(Advice(Advised.CONTACT, text, number))
    return advice


def _is_uneven(residual: float, survey_residuals: Sequence[float]) -> bool:
    """Return whether a drop leaves so much more than the others that its contact is suspect."""
    if len(survey_residuals) < MIN_COMPARED_DROPS:
        return residual > MIN_UNEVEN_RESIDUAL_UNCOMPARED
    return residual > max(MIN_UNEVEN_RESIDUAL, UNEVEN_RATIO * statistics.median(survey_residuals))


def _loose_sensor(residuals: Mapping[int, float]) -> int | None:
    """Return the only sensor that is fitted badly; None: no sensor, or several."""
    if len(residuals) < 2:
        return None
    worst = max(residuals, key=lambda sensor: residuals[sensor])
    largest_remaining = max(residual for sensor, residual in residuals.items() if sensor != worst)
    limit = max(MIN_LOOSE_RESIDUAL, LOOSE_RATIO * largest_remaining)
    return (
        worst
        if largest_remaining <= MAX_RESIDUAL_OF_GOOD_SENSORS and residuals[worst] > limit
        else None
    )


def _load(job: Job, drop: DropView, neighbours: Sequence[PointDrop]) -> list[Advice]:
    facts = drop.facts
    load = facts.peak_load
    if load is None:
        return []
    loads = [
        neighbour.peak_load
        for neighbour in neighbours
        if neighbour.peak_load and neighbour.kind not in (Kind.REJECTED, Kind.DISCARDED)
    ]
    median_load = statistics.median(loads) if len(loads) > 1 else None
    presumed = presumed_load(job.procedure_in_force, [facts], drop.setup.plate_radius)
    if median_load is not None and abs(load - median_load) > MAX_LOAD_DIFFERENCE * median_load:
        side = "lower" if load < median_load else "higher"
        text = (
            f"drop {facts.number} fell from {side}: {load / 1e3:.1f} kN, the others "
            f"{median_load / 1e3:.1f} kN; lift to the catch and repeat it"
        )
        return [Advice(Advised.LOAD, text, facts.number)]
    if presumed is not None and not presumed.is_met_by(load):
        text = (
            f"wrong drop height: {load / 1e3:.3g} kN, the procedure needs "
            f"{presumed.load / 1e3:.3g} kN: set the drop height as calibrated"
        )
        return [Advice(Advised.LOAD, text, facts.number)]
    return []


def advice_on_point(
    progress: PointProgress, loads: Mapping[int, float | None] | None = None
) -> list[Advice]:
    """Return the advice about a point whose drops are averaged.

    Parameters
    ----------
    progress : PointProgress
    loads : mapping, optional
        Peak load of every drop by its number, N: a drop from higher moves the plate more, and the
        ground is not to be blamed for it.
    """
    change = progress.compaction_change
    if change is None or len(progress.used) < 2:
        return []
    first, last = progress.used[0], progress.used[-1]
    loads_by_number = loads or {}
    before, after = loads_by_number.get(first), loads_by_number.get(last)
    if before and after:
        change = (1.0 + change) * before / after - 1.0
    if change < -MIN_SETTLING:
        text = (
            f"drop {last} moves {-100 * change:.0f} % less than drop {first}: the plate was not "
            "seated; more seating drops, or discard the first and measure another"
        )
        return [Advice(Advised.SEATING, text)]
    if change > MIN_SINKING:
        text = (
            f"drop {last} moves {100 * change:.0f} % more than drop {first}: the ground gives way; "
            "measure beside this place"
        )
        return [Advice(Advised.SINKING, text)]
    return []


_OF_EFFECT: Mapping[str, str] = {
    "rough_contact": "the plate does not lie full: clear stones, turn it and press it flat",
    "seating": "the plate was not seated: more seating drops",
    "permanent_set": "the ground sinks on: more seating drops, or beside this place",
    "rebound": "the weight came down again: catch it after the first blow",
    "saturation": "a channel is at the end of its range: drop from lower, or take another range",
    "baseline_drift": "a sensor drifts: re-seat it, and let nobody walk nearby",
    "mains_hum": "mains hum: keep the cables away from power lines",
    "sensor_lag": "a sensor answers late: press it down, look at its cable",
}


def of_effect(name: str) -> str | None:
    """Return the advice for an effect of the diagnosis; None: nothing to do at the point."""
    return _OF_EFFECT.get(name)
