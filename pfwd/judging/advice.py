"""Advice about a drop or a point, in words that a technician can act on.

It uses what is known within a second of the drop: its record, the earlier drops of the point, and
the first fit. An effect that a diagnosis reports later has its own advice.
"""

import statistics
from collections.abc import Mapping, Sequence

from pfwd.judging.drops import DropView
from pfwd.judging.job import Job
from pfwd.procedures import Kind, PointDrop, PointProgress
from pfwd.procedures.preconditions import presumed_load

MAX_LOAD_DIFFERENCE = 0.15
"""Largest difference of a drop's load from the median load of its point, as a fraction of the
median. Drops from one height repeat within a few percent; the next catch of a guide rod is at least
a fifth away."""

MIN_SETTLING = 0.10
"""Relative decrease of the deflection, from the first to the last averaged drop, from which the
plate counts as not seated. With three drops that repeat to 3 % chance causes it at one of a hundred
points."""

MIN_SINKING = 0.10
"""Relative increase of the deflection, from the first to the last averaged drop, from which the
ground counts as giving way under the plate."""

MIN_UNEVEN_RESIDUAL = 0.03
"""Residual of a fit during the contact, over the peak, below which the contact is not suspected.
Even plates on simulated ground stay below 2 % (docs/validation.md)."""

UNEVEN_RATIO = 2.5
"""A contact is suspect if its residual exceeds this number of times the median of the other drops
of the survey. Real instruments on real ground leave 3 to 19 % at every drop, because of their own
response and of layers; a larger residual of a single drop is due to its contact."""

MIN_COMPARED_DROPS = 3
"""Smallest number of other drops whose median residual is used for comparison."""

MIN_UNEVEN_RESIDUAL_UNCOMPARED = 0.25
"""Residual above which a contact is suspect when there are too few other drops for comparison: more
than any even drop of a real instrument left (0.19)."""

MIN_LOOSE_RESIDUAL = 0.015
"""Residual of one sensor during the contact, over its own peak, from which it may be loose.
Well-placed sensors leave 0.3 % in drops of the simulated instrument, a loose one 2 to 5 %."""

LOOSE_RATIO = 2.0
"""A sensor is loose only if its residual exceeds this number of times that of the next worst
one."""

MAX_RESIDUAL_OF_GOOD_SENSORS = 0.03
"""Largest residual of the other sensors at which the fit can show that one sensor is loose: where
all sensors are fitted badly, the model of the ground is wrong."""


SATURATED_ADVICE = "a channel is at the end of its range: use a lower drop height or another range"
"""Advice of the effect `saturation`, whose module is imported only for inversions."""

ACTIONABLE_EFFECTS = frozenset(
    {
        *("rough_contact", "seating", "permanent_set", "rebound", "saturation"),
        *("baseline_drift", "mains_hum", "sensor_lag"),
    }
)
"""Effects whose cause the operator can remove at the point."""


def advice_on_drop(
    job: Job,
    drop: DropView,
    neighbours: Sequence[DropView],
    *,
    contact_residual: float | None = None,
    survey_residuals: Sequence[float] = (),
    sensor_residuals: Mapping[int, float] | None = None,
    excluded_sensors: Sequence[int] = (),
) -> list[str]:
    """Return the advice about one drop.

    Parameters
    ----------
    job : Job
    drop : DropView
    neighbours : sequence of DropView
        The other drops of its point.
    contact_residual : float, optional
        Root mean square residual of the fit during the contact, over the peak; None: noise explains
        the residual, or there is no fit.
    survey_residuals : sequence of float
        The same residual for the other drops of the survey.
    sensor_residuals : mapping, optional
        Residual of every sensor during the contact, over its own peak, by its number from 1.
    excluded_sensors : sequence of int
        Numbers of the faulty sensors, from 1.
    """
    if drop.facts.kind is Kind.REJECTED:
        return []
    advice = [
        f"re-seat sensor {sensor}: it does not move with the ground" for sensor in excluded_sensors
    ]
    loose = _loose_sensor(sensor_residuals or {})
    if loose is not None:
        advice.append(
            f"re-seat sensor {loose}: it does not move as the other sensors and the ground"
        )
    if drop.saturation is not None:
        advice.append(SATURATED_ADVICE)
    advice += _load(job, drop, [neighbour.facts for neighbour in neighbours])
    if contact_residual is not None and _is_uneven(contact_residual, survey_residuals):
        advice.append(
            f"drop {drop.facts.number} does not press evenly: lift the plate, clear stones, turn "
            "it a quarter and press it flat"
        )
    return advice


def _is_uneven(residual: float, survey_residuals: Sequence[float]) -> bool:
    """Return whether a drop's residual is large enough to make its contact suspect."""
    if len(survey_residuals) < MIN_COMPARED_DROPS:
        return residual > MIN_UNEVEN_RESIDUAL_UNCOMPARED
    return residual > max(MIN_UNEVEN_RESIDUAL, UNEVEN_RATIO * statistics.median(survey_residuals))


def _loose_sensor(residuals: Mapping[int, float]) -> int | None:
    """Return the number of the only sensor that is fitted badly; None: no sensor, or several."""
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


def _load(job: Job, drop: DropView, neighbours: Sequence[PointDrop]) -> list[str]:
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
        return [text]
    if presumed is not None and not presumed.is_met_by(load):
        text = (
            f"wrong drop height: {load / 1e3:.3g} kN, the procedure needs "
            f"{presumed.load / 1e3:.3g} kN: set the drop height as calibrated"
        )
        return [text]
    return []


def advice_on_point(
    progress: PointProgress, loads: Mapping[int, float | None] | None = None
) -> list[str]:
    """Return the advice about a point, from the change of the deflection over its averaged drops.

    Parameters
    ----------
    progress : PointProgress
    loads : mapping, optional
        Peak load of every drop, N, by its number. Deflections are then compared at equal load.
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
            "seated; make more seating drops, or discard the first drop and measure another"
        )
        return [text]
    if change > MIN_SINKING:
        text = (
            f"drop {last} moves {100 * change:.0f} % more than drop {first}: the ground gives way; "
            "measure beside this place"
        )
        return [text]
    return []
