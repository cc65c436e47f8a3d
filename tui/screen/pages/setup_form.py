"""What the setup page asks, and how it is checked: as it is typed, one field at a time."""

import dataclasses
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pfwd.errors import OptionError, TraceError
from pfwd.files.header import HEADER_KEYS, check_value
from pfwd.judging import JobRequest
from pfwd.judging.job import target_fault
from pfwd.judging.stations import read_stations
from pfwd.procedures import PLAIN, Procedure, find_procedure, plain_procedure
from pfwd.procedures.shipped import DEFAULT_MEASURED_DROPS, DEFAULT_SEATING_DROPS
from pfwd.session.plan import SessionPlan
from pfwd.session.setup_file import with_procedure
from tui.screen.units import QuantityName, Units, format_number, judged_quantity


@dataclass(frozen=True, slots=True)
class Field:
    """One line of the form."""

    name: str
    """As an identifier; for what is declared, the key of a setup file."""
    title: str
    quantity: QuantityName | None = None
    """Of a number that is shown in the units of the screen."""
    kind: str = "number"
    """number, whole, text, file, or target: a number in the unit of what the procedure judges."""
    hint: str = ""


OF_JOB = ("target", "stations", "step_m", "operator")
"""Fields that are kept with the survey and can be said of a recording too."""

_BY_PROCEDURE = "by the procedure, if one is chosen"

FIELDS = (
    Field("url", "port", kind="text", hint="/dev/ttyUSB0, COM3, socket://host:port"),
    Field("plate_radius_m", "plate radius", "length", hint="empty: as the instrument says"),
    Field("plate_mass_kg", "plate mass", "mass", hint="empty: as the instrument says"),
    Field("poisson_ratio", "Poisson's ratio", hint="0 to below 0.5; empty: 0.35 is assumed"),
    Field("seating_drops", "seating drops", kind="whole", hint=_BY_PROCEDURE),
    Field("measured", "measured drops", kind="whole", hint=_BY_PROCEDURE),
    Field("target", "target", kind="target", hint="of points that have none; empty: none"),
    Field("stations", "stations", kind="file", hint="CSV or GPX with names, places and targets"),
    Field("step_m", "station step", hint="m along the line, from 12+320 to 12+340: 20"),
    Field("operator", "operator", kind="text"),
    Field("site", "site", kind="text"),
)
FIELDS_BY_NAME: Mapping[str, Field] = {field.name: field for field in FIELDS}
_OWN = ("url", "measured", "target", "stations", "step_m")
"""Fields that no setup file has."""


def quantity_of(field: Field, procedure: Procedure) -> QuantityName | None:
    """What a field is in the units of the screen; a target what the procedure judges."""
    return judged_quantity(procedure.quantity) if field.kind == "target" else field.quantity


def unit_of(field: Field, procedure: Procedure, units: Units) -> str:
    """The unit that a field is typed in; empty: none."""
    quantity = quantity_of(field, procedure)
    return "m" if field.name == "step_m" else units.unit(quantity) if quantity else ""


def chosen_procedure(name: str, values: Mapping[str, Any], known: Procedure | None) -> Procedure:
    """The procedure of the form.

    Parameters
    ----------
    name : str
        Of a shipped one, of `known`, or "plain".
    values : mapping
        Seating and measured drops of a plain one.
    known : Procedure, optional
        The one that is in force.

    Raises
    ------
    OptionError
    """
    if name == PLAIN:
        seating, measured = values.get("seating_drops"), values.get("measured")
        return plain_procedure(
            DEFAULT_SEATING_DROPS if seating is None else int(seating),
            DEFAULT_MEASURED_DROPS if measured is None else measured,
        )
    return known if known is not None and known.name == name else find_procedure(name)


def error_of(
    field: Field,
    text: str,
    units: Units,
    procedure: Procedure,
    on_remark: Callable[[str], None] = lambda _: None,
) -> str:
    """What is wrong with what was typed; empty: nothing. `on_remark` as for `value_of`."""
    try:
        value_of(field, text, units, procedure, on_remark)
    except ValueError as err:
        return str(err)
    return ""


def value_of(
    field: Field,
    text: str,
    units: Units,
    procedure: Procedure,
    on_remark: Callable[[str], None] = lambda _: None,
) -> Any:
    """The value in SI; None: the field is empty.

    Parameters
    ----------
    field : Field
    text : str
        As it was typed.
    units : Units
    procedure : Procedure
        By which targets are judged.
    on_remark : callable, optional
        Receives what does not hold the value up and has to be known: columns that are not used.

    Raises
    ------
    ValueError
        With what was expected.
    """
    text = text.strip()
    if not text:
        return None
    if field.kind == "file":
        # A terminal quotes the name of a file that is dropped on it.
        path = os.path.expanduser(text.strip("'\""))
        if not os.path.isfile(path):  # a pipe would be waited for
            raise ValueError("expected a file, .csv or .gpx")
        return read_stations(path, procedure, on_remark)
    if field.kind == "text":
        if not text.isprintable() or len(text) > 200:
            raise ValueError("expected up to 200 letters on one line")
        return text
    value = _number(field, text, units, quantity_of(field, procedure))
    if field.name in HEADER_KEYS:
        try:
            check_value(field.name, value, field.title)
        except TraceError as err:
            rule = HEADER_KEYS[field.name]
            shown = units.unit(field.quantity) if field.quantity else ""
            raise ValueError(
                f"expected {rule.value.expected.split(', in')[0]} {shown}".strip()
            ) from err
    elif not 0 < value < math.inf:
        raise ValueError("expected a number > 0")
    if field.kind == "target":
        fault = typed_target_fault(value, procedure, units)
        if fault:
            raise ValueError(fault)
    return value


def typed_target_fault(target: float, procedure: Procedure, units: Units) -> str:
    """Describe why a target in SI cannot be one, in the units of the screen; empty: it can."""
    unit = units.of(judged_quantity(procedure.quantity))
    return target_fault(target, procedure, (unit.name, unit.scale))


def _number(field: Field, text: str, units: Units, quantity: QuantityName | None) -> float | int:
    try:
        if field.kind == "whole":
            return int(text)
        value = float(text)
    except ValueError:
        kind = "a whole number" if field.kind == "whole" else "a number"
        raise ValueError(f"expected {kind}") from None
    return units.si(quantity, value) if quantity else value


def shown_value(field: Field, value: Any, units: Units, procedure: Procedure) -> str:
    """A value of SI as it stands in the form."""
    if value is None:
        return ""
    quantity = quantity_of(field, procedure)
    if quantity is not None:
        number = units.value(quantity, float(value))
        return "" if number is None else f"{number:.6g}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def plan_with(plan: SessionPlan, values: Mapping[str, Any], procedure: Procedure) -> SessionPlan:
    """The plan with what the form says.

    Parameters
    ----------
    plan : SessionPlan
    values : mapping
        By field, SI; None: not declared here.
    procedure : Procedure

    Raises
    ------
    OptionError
        If it contradicts itself.
    """
    declared = dict(plan.setup.declared)
    for name, value in values.items():
        if name in _OWN:
            continue
        if value is None:
            declared.pop(name, None)
        else:
            declared[name] = value
    declared.pop("procedure", None)
    setup = dataclasses.replace(plan.setup, declared=declared, procedure=None)
    if procedure.seating_drops is not None:  # the procedure's number counts
        declared.pop("seating_drops", None)
    setup = with_procedure(setup, procedure, "procedure")
    return dataclasses.replace(plan, setup=setup, job=said_of_job(values).over(plan.job))


def said_of_job(values: Mapping[str, Any]) -> JobRequest:
    """What the form says of the survey's job; an empty field says nothing."""
    return JobRequest(**{name: values.get(name) for name in OF_JOB})


def summary_of(values: Mapping[str, Any], units: Units) -> str:
    """The plate in one line, to be read before it is taken."""
    radius = values.get("plate_radius_m")
    if radius is None:
        return "plate as the instrument says"
    return f"plate radius {format_number(units.value('length', radius), 4)} {units.unit('length')}"


__all__ = [
    "FIELDS",
    "FIELDS_BY_NAME",
    "OF_JOB",
    "Field",
    "OptionError",
    "chosen_procedure",
    "error_of",
    "plan_with",
    "said_of_job",
    "shown_value",
    "summary_of",
    "typed_target_fault",
    "unit_of",
    "value_of",
]
