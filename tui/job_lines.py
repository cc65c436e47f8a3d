"""Settings of a survey (its job) as lines of text."""

import datetime
from typing import Any

from pfwd.judging import Job
from pfwd.judging.job import JobChange, target_text

MAX_STATION_LINES = 20
"""Largest number of stations that are printed; ``pfwd job --json`` has all."""


def job_lines(job: Job) -> list[str]:
    """Return the settings of a survey as lines of text, then every change with its date."""
    procedure = job.procedure_in_force
    title = f": {procedure.title}" if procedure.title else ""
    settings: list[tuple[str, str]] = [
        (
            "procedure",
            "none: every measured drop counts"
            if job.procedure is None
            else f"{procedure.name}{title}",
        ),
        ("judged", job.quantity.label),
        ("target", "none" if job.target is None else target_text(job.target)),
        ("stations", str(len(job.stations)) if job.stations else "none"),
        ("step", "none" if job.step_m is None else f"{job.step_m:g} m"),
        ("operator", job.operator or "none"),
        ("device", job.device or "none"),
        ("units", job.units or "none"),
        ("time zone", job.time_zone or "none"),
    ]
    lines = [f"{name:10} {text}" for name, text in settings]
    for entry in job.calibration:
        dates = ", ".join(f"{key} {entry[key]}" for key in ("calibrated", "due") if key in entry)
        lines.append(f"calibration {entry.get('channel')}: {dates}")
    for station in job.stations[:MAX_STATION_LINES]:
        place = (
            ""
            if station.latitude is None or station.longitude is None
            else f"  {station.latitude:.6f}, {station.longitude:.6f}"
        )
        target = "" if station.target is None else f"  target {target_text(station.target)}"
        lines.append(f"  station {station.name}{place}{target}")
    if len(job.stations) > MAX_STATION_LINES:
        lines.append(f"  and {len(job.stations) - MAX_STATION_LINES} more (--json has all)")
    if job.changes:
        lines.append("changes:")
    return lines + [f"  {_when(change)}  {change.key} = {_value(change)}" for change in job.changes]


def _when(change: JobChange) -> str:
    try:
        when = datetime.datetime.fromisoformat(change.time_utc)
    except ValueError:
        return "at an unknown time"
    return when.astimezone().strftime("%Y-%m-%d %H:%M")


def _value(change: JobChange) -> str:
    value: Any = change.value
    if value is None:
        return "none"
    if change.key == "target" and isinstance(value, int | float):
        return target_text(float(value))
    if isinstance(value, list | tuple):
        return f"{len(value)} entries"
    return str(value)
