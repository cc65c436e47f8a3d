"""Job of a survey: procedure, targets and stations, stored in the survey as dated events.

An event ``procedure`` holds the complete text of the procedure's profile. An event ``job`` holds
the other keys that changed, with null for a withdrawn value. The last value of a key counts.
Programs that do not know these events ignore them. Targets of single points are stored as edits of
these points.
"""

import dataclasses
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from pfwd.errors import OptionError, SurveyError, quote, refusal
from pfwd.procedures import (
    NO_PROCEDURE,
    Procedure,
    Quantity,
    parse_procedure,
)
from pfwd_device.recording import Survey
from pfwd_device.schema import (
    Array,
    Choice,
    Key,
    Number,
    Text,
    TomlTable,
    declared,
    describe,
    keys_of,
    readable_values,
    table_of,
)

PROCEDURE_EVENT, JOB_EVENT = "procedure", "job"

MAX_STATIONS = 100_000
"""Largest number of stations of a job; a longer list is taken for a wrong file."""

SCREEN_UNITS = ("si", "us")

_SHORT_TEXT = Text(200, min_length=1)


@dataclass(frozen=True, slots=True)
class Station:
    """Place where a point is to be measured."""

    name: str = field(metadata=describe(_SHORT_TEXT, "Name that the point shall have."))
    chainage_m: float | None = declared(None, Number("m"), "Distance along the line.")
    latitude: float | None = declared(
        None, Number("degrees", minimum=-90, maximum=90), "North positive."
    )
    longitude: float | None = declared(
        None, Number("degrees", minimum=-180, maximum=180), "East positive."
    )
    target: float | None = declared(
        None, Number("Pa or m", above=0), "Target; without one that of the job."
    )

    def as_stored(self) -> dict[str, Any]:
        """Return the station as a mapping for the survey, without unknown values."""
        values = dataclasses.asdict(self)
        return {key: value for key, value in values.items() if value is not None}


JOB_KEYS = {
    "target": Key(
        Number("Pa or m", above=0), meaning="Target of points that have none of their own."
    ),
    "stations": Key(Array(table_of(Station)), meaning="Stations, one table each."),
    "step_m": Key(
        Number("m", above=0), meaning="Distance of neighbouring stations along the line."
    ),
    "operator": Key(_SHORT_TEXT, meaning="Name of the operator."),
    "device": Key(_SHORT_TEXT, meaning="Serial number of the instrument."),
    "calibration": Key(
        Array(TomlTable({})), meaning="Channel, date of its calibration and date of expiry."
    ),
    "units": Key(Choice(SCREEN_UNITS), meaning="Units of the screen."),
    "time_zone": Key(_SHORT_TEXT, meaning="Offset of local time at the site, such as +02:00."),
}
"""Keys of an event ``job``, with the values that each accepts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JobChange:
    """Change of one setting of a job."""

    time_utc: str
    """Time of the change, ISO 8601; empty: unknown."""
    key: str
    """Name of the changed field of `Job`."""
    value: Any
    """New value as in JSON; for a procedure its name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """What is to be measured in a survey and how it is judged. A value of None is not declared."""

    procedure: Procedure | None = None
    target: float | None = None
    """Target of the points without a target of their own, Pa, or m for a deflection."""
    stations: tuple[Station, ...] = ()
    step_m: float | None = None
    """Distance of neighbouring stations along the line, m."""
    operator: str | None = None
    device: str | None = None
    """Serial number of the instrument."""
    calibration: tuple[Mapping[str, Any], ...] = ()
    """Channels with the dates of their last and next calibration."""
    units: str | None = None
    """Units on the screen: ``si`` or ``us``."""
    time_zone: str | None = None
    """Offset of local time at the site from UTC, such as +02:00."""
    changes: tuple[JobChange, ...] = ()
    """All changes of the job, in order."""
    _stations_by_name: Mapping[str, Station] = field(
        default_factory=dict, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        by_name = {station.name: station for station in self.stations}
        object.__setattr__(self, "_stations_by_name", by_name)

    @property
    def procedure_in_force(self) -> Procedure:
        """Declared procedure, or `NO_PROCEDURE`, which averages every measured drop."""
        return self.procedure or NO_PROCEDURE

    @property
    def quantity(self) -> Quantity:
        """Quantity by which the points are judged."""
        return self.procedure_in_force.quantity

    def station(self, name: str) -> Station | None:
        """Return the station with this name; None: there is none."""
        return self._stations_by_name.get(name)

    def target_faults(self) -> list[str]:
        """Return one sentence for each target that the procedure cannot judge.

        An example is a modulus where the procedure judges a deflection.
        """
        procedure = self.procedure_in_force
        lines = []
        if self.target is not None and target_fault(self.target, procedure):
            lines.append(f"the target {target_text(self.target)} of the survey")
        stations = [
            station
            for station in self.stations
            if station.target is not None and target_fault(station.target, procedure)
        ]
        if stations:
            name, target = stations[0].name, target_text(stations[0].target or 0.0)
            lines.append(f"{len(stations)} stations with targets such as {target} of {name}")
        unit = procedure.quantity.display_unit.name
        rule = f"not for procedure {procedure.name}, which judges {procedure.quantity} in {unit}"
        return [f"{line}: {rule}. Enter it again with --target or --stations" for line in lines]

    def with_request(self, request: "JobRequest", time_utc: str = "") -> "Job":
        """Return a job with the requested changes, which are recorded with the time."""
        declared = request.declared()
        changes = [
            JobChange(time_utc=time_utc, key=key, value=_plain(value))
            for key, value in declared.items()
        ]
        return dataclasses.replace(self, **declared, changes=(*self.changes, *changes))

    def as_request(self) -> "JobRequest":
        """Return the request that gives another survey the same job."""
        names = [item.name for item in dataclasses.fields(JobRequest)]
        return JobRequest(**{name: getattr(self, name) or None for name in names})

    def as_json(self) -> dict[str, Any]:
        """Return the job as values that JSON can hold, in SI units."""
        unit = self.quantity.unit
        return {
            "procedure": None if self.procedure is None else self.procedure.name,
            "quantity": self.quantity.value,
            "target": self.target,
            "unit": unit,
            "stations": [station.as_stored() for station in self.stations],
            "step_m": self.step_m,
            "operator": self.operator,
            "device": self.device,
            "calibration": [dict(entry) for entry in self.calibration],
            "units": self.units,
            "time_zone": self.time_zone,
            "changes": [dataclasses.asdict(change) for change in self.changes],
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class JobRequest:
    """Requested changes of a job; None: unchanged. The fields are those of `Job`."""

    procedure: Procedure | None = None
    target: float | None = None
    stations: tuple[Station, ...] | None = None
    step_m: float | None = None
    operator: str | None = None
    device: str | None = None
    calibration: tuple[Mapping[str, Any], ...] | None = None
    units: str | None = None
    time_zone: str | None = None

    def __bool__(self) -> bool:
        return bool(self.declared())

    def declared(self) -> dict[str, Any]:
        """Return the requested changes, by the names of the fields."""
        values = {item.name: getattr(self, item.name) for item in dataclasses.fields(self)}
        return {name: value for name, value in values.items() if value is not None}

    def over(self, fallback: "JobRequest") -> "JobRequest":
        """Return both requests as one; where both change a field, this one counts."""
        return JobRequest(**{**fallback.declared(), **self.declared()})

    def news(self, job: Job) -> "JobRequest":
        """Return the part of the request that would change the job."""
        declared = self.declared()
        return JobRequest(
            **{key: value for key, value in declared.items() if not _same(getattr(job, key), value)}
        )

    def differences(self, job: Job) -> list[str]:
        """Return one sentence for each value of the job that the request would replace.

        Targets that a requested procedure could not judge are reported, too.
        """
        lines = []
        for key, value in self.news(job).declared().items():
            old = getattr(job, key)
            if old is None or old == ():
                continue
            title = _TITLES.get(key)
            if title is None:  # set by the instrument or the clock, not by the operator
                continue
            was, now = _text_of(key, old), _text_of(key, value)
            lines.append(f"{title} of the survey was {was}, now it is {now}")
        if self.procedure is not None and "procedure" in self.news(job).declared():
            lines += job.with_request(self).target_faults()
        return lines

    def events(self) -> list[tuple[str, dict[str, Any]]]:
        """Return the events that store the request in a survey, as pairs of name and details."""
        declared = self.declared()
        events: list[tuple[str, dict[str, Any]]] = []
        procedure = declared.pop("procedure", None)
        if procedure is not None:
            events.append((PROCEDURE_EVENT, procedure.as_recorded()))
        if declared:
            events.append((JOB_EVENT, {key: _plain(value) for key, value in declared.items()}))
        return events


_TITLES = {
    "procedure": "the procedure",
    "target": "the target",
    "stations": "the list of stations",
    "step_m": "the step between stations",
    "operator": "the operator",
}
"""Names, for messages, of the settings that the operator chooses for a survey. Changes of the
others (instrument, clock, units of the screen) are stored without a message."""


def _same(old: Any, new: Any) -> bool:
    if isinstance(old, Procedure) and isinstance(new, Procedure):
        identities = [
            (procedure.name, procedure.text, procedure.enforce_unverified)
            for procedure in (old, new)
        ]
        return identities[0] == identities[1]
    return bool(old == new)


def _text_of(key: str, value: Any) -> str:
    match key:
        case "procedure":
            return str(value.name)
        case "target":
            return target_text(value)
        case "stations":
            return f"one of {len(value)}"
        case "step_m":
            return f"{value:g} m"
    return str(value)


def _plain(value: Any) -> Any:
    if isinstance(value, Procedure):
        return value.name
    if isinstance(value, tuple):
        return [item.as_stored() if isinstance(item, Station) else dict(item) for item in value]
    return value


def target_si(shown: float, procedure: Procedure, where: str = "--target") -> float:
    """Return a target in SI units, from a number in the shown unit of the procedure.

    Parameters
    ----------
    shown : float, MPa, or mm for a deflection
    procedure : Procedure
    where : str
        Origin of the number, the beginning of error messages.

    Raises
    ------
    OptionError
        If it is not a number > 0, or is outside of the range that drops can reach.
    """
    unit, scale = procedure.quantity.display_unit
    if not 0 < shown < math.inf:
        raise OptionError(refusal(where, f"a number > 0, in {unit}", f"{shown:g}"))
    deflection = procedure.quantity is Quantity.DEFLECTION
    value = shown / 1e3 if deflection else shown * scale  # 0.9 mm are 0.0009 m to the last digit
    fault = target_fault(value, procedure)
    if fault:
        raise OptionError(f"{where}: {fault}")
    return value


MIN_DEFLECTION_TARGET, MAX_DEFLECTION_TARGET = 1e-5, 1e-2
"""Range of accepted deflections, m. A drop of 7.07 kN on a plate of 0.15 m radius deflects ground
of 2 MPa by 11 mm and ground of 2 GPa by 0.01 mm: outside of the range every point would pass, or
none."""

MIN_MODULUS_TARGET, MAX_MODULUS_TARGET = 2e6, 1e10
"""Range of accepted moduli, Pa. The limits detect a wrong quantity or unit. Peat has 2 MPa, and a
deflection in mm that is read as MPa is below that. A bituminous base has 10 GPa, and a modulus in
kPa that is read as MPa is above that."""

MAX_TARGET_OVER_RANGE = 3.0
"""Largest target over the end of the range of a method. E_vd is measured up to 70 MPa, required up
to 120 MPa, and 450 or 4500 MPa is a wrong decimal point or another quantity."""


def target_fault(target: float, procedure: Procedure, unit: tuple[str, float] | None = None) -> str:
    """Return a message about a target that no drop can reach; empty: the target is valid.

    Parameters
    ----------
    target : float, Pa, or m for a deflection
    procedure : Procedure
        The procedure that judges by the target.
    unit : name and size in SI units, optional
        Unit in which the target was typed; None: MPa, or mm for a deflection.

    Examples
    --------
    >>> from pfwd.procedures import find_procedure
    >>> target_fault(0.045, find_procedure("mndot")).partition(";")[0]
    'expected a deflection of 0.01 to 10 mm, got 45 mm'
    >>> target_fault(4500e6, find_procedure("tp-bf-stb-b8.3")).partition(";")[0]
    'expected a modulus of 2 to 210 MPa, got 4500 MPa'
    """
    name, scale = unit or procedure.quantity.display_unit
    if procedure.quantity is Quantity.DEFLECTION:
        kind, wrong_quantity = "deflection", "a modulus"
        smallest, largest = MIN_DEFLECTION_TARGET, MAX_DEFLECTION_TARGET
        is_wrong_quantity = target > largest
    else:
        kind, wrong_quantity = "modulus", "a deflection"
        smallest, largest = MIN_MODULUS_TARGET, MAX_MODULUS_TARGET
        if (end_of_range := procedure.limit("most_value_pa")) is not None:
            largest = MAX_TARGET_OVER_RANGE * end_of_range
        is_wrong_quantity = target < smallest
    if smallest <= target <= largest:
        return ""
    expected = f"a {kind} of {smallest / scale:.5g} to {largest / scale:.5g} {name}"
    question = f"did you mean {wrong_quantity if is_wrong_quantity else 'another unit'}?"
    rule = f"procedure {procedure.name} judges a {kind} in {name}"
    if procedure.name == NO_PROCEDURE.name:
        rule = f"without a procedure a {kind} is judged, in {name}"
    return f"expected {expected}, got {target / scale:.6g} {name}; {question} {rule}"


def time_zone_of(text: str, where: str = "--time-zone") -> str:
    """Return an offset from UTC in the form in which a job stores it: ``+02:00``.

    Parameters
    ----------
    text : str
        Offset as typed.
    where : str
        Origin of the text, the beginning of error messages.

    Raises
    ------
    OptionError
        If the text is not an offset.

    Examples
    --------
    >>> time_zone_of("+2:00"), time_zone_of("Z"), time_zone_of("-0330")
    ('+02:00', '+00:00', '-03:30')
    """
    match = _OFFSET.fullmatch(text.strip())
    if text.strip().upper() in ("Z", "UTC"):
        return "+00:00"
    if match is None or int(match[2]) > MAX_OFFSET_HOURS or int(match[3] or 0) > 59:
        hint = "give the offset at the time of the survey: summer time differs from winter time"
        raise OptionError(refusal(where, "an offset such as +02:00, or UTC", quote(text), hint))
    return f"{match[1]}{int(match[2]):02d}:{int(match[3] or 0):02d}"


_OFFSET = re.compile(r"([+-])(\d{1,2})(?::?(\d{2}))?", re.ASCII)
MAX_OFFSET_HOURS = 14
"""Largest offset of a local time from UTC, h: that of the Line Islands."""


def target_text(target: float) -> str:
    """Return a target as text in mm or MPa.

    A number below 1 is a deflection in m, else a modulus in Pa.
    """
    from pfwd.procedures.judging import MAX_DEFLECTION_M

    if target < MAX_DEFLECTION_M:
        return f"{target * 1e3:g} mm"
    return f"{target / 1e6:g} MPa"


def job_of(survey: Survey, procedure: Procedure | None = None) -> Job:
    """Return the job of a survey from its events; unreadable events are ignored.

    Parameters
    ----------
    survey : Survey
    procedure : Procedure, optional
        Replaces the procedure that the survey stores, which is then not read.

    Raises
    ------
    SurveyError
        If the stored procedure cannot be read.
    """
    if procedure is not None:
        events = [event for event in survey.events if event.get("event") != PROCEDURE_EVENT]
        return job_from_events(events, survey.path, procedure)
    return job_from_events(survey.events, survey.path)


def job_from_events(
    events: Iterable[Mapping[str, Any]], where: str, before: Procedure | None = None
) -> Job:
    """Return the job that results from a sequence of events.

    Parameters
    ----------
    events : iterable of mapping
        Events of a survey, in order.
    where : str
        Path of the survey, the beginning of error messages.
    before : Procedure, optional
        Procedure if no event states one.

    Raises
    ------
    SurveyError
        If the last procedure cannot be read.
    """
    procedure_details: Mapping[str, Any] | None = None
    values: dict[str, Any] = {}
    changes: list[JobChange] = []
    for event in events:
        name, details = event.get("event"), event.get("details", event)
        if name not in (PROCEDURE_EVENT, JOB_EVENT) or not isinstance(details, Mapping):
            continue
        time = event.get("time_utc")
        when = time if isinstance(time, str) else ""
        if name == PROCEDURE_EVENT:
            if not isinstance(details.get("text"), str):
                continue
            changes.append(JobChange(time_utc=when, key="procedure", value=details.get("name")))
            procedure_details = details
            continue
        for key, value in details.items():
            if value is None:
                readable = {key: _WITHDRAWN_VALUES.get(key)} if key in JOB_KEYS else {}
            elif key == "stations":
                readable = _stations(value)
            else:
                readable = readable_values({key: value}, JOB_KEYS)
            if not readable:
                continue
            values |= readable
            changes.append(JobChange(time_utc=when, key=key, value=value))
    procedure = (
        before
        if procedure_details is None or not procedure_details["text"]
        else _procedure(procedure_details, where)
    )
    return Job(procedure=procedure, changes=tuple(changes), **values)


def _procedure(details: Mapping[str, Any], where: str) -> Procedure:
    source = f"procedure {quote(details.get('name'))} stored in {where}"
    unverified = details.get("enforce_unverified") is True
    try:
        procedure = parse_procedure(details["text"], source, enforce_unverified=unverified)
    except OptionError as err:  # the fault is in the survey, not in an option
        raise SurveyError(f"{err}; choose another one with --procedure") from err
    file = details.get("file")
    return dataclasses.replace(procedure, file=file if isinstance(file, str) else None)


def _stations(value: Any) -> dict[str, Any]:
    if not isinstance(value, list) or len(value) > MAX_STATIONS:
        return {}
    stations = [readable_values(entry, keys_of(Station)) for entry in value]
    if not all("name" in station for station in stations):
        return {}
    return {"stations": tuple(Station(**station) for station in stations)}


_WITHDRAWN_VALUES: Mapping[str, Any] = {"stations": (), "calibration": ()}
