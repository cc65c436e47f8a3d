"""Fields of the setup page and the check of each while it is typed."""

import dataclasses
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pfwd.errors import TraceError
from pfwd.files.header import HEADER_KEYS, check_value
from pfwd.judging import JobRequest
from pfwd.judging.job import target_fault
from pfwd.judging.stations import read_stations
from pfwd.procedures import PLAIN, Procedure, find_procedure, plain_procedure
from pfwd.procedures.shipped import DEFAULT_MEASURED_DROPS, DEFAULT_SEATING_DROPS
from pfwd.session.plan import SessionPlan
from pfwd.session.setup_file import with_procedure
from pfwd.units import QuantityName, Units


@dataclass(frozen=True, slots=True)
class Field:
    """Entry field of the setup form: key, title, kind of value, and hint."""

    name: str
    """Identifier; for a declared field the key of a setup file."""
    title: str
    quantity: QuantityName | None = None
    """Quantity of a number that is shown in the units of the screen."""
    kind: str = "number"
    """One of number, whole, text, file, target; a target has the unit of the judged quantity."""
    hint: str = ""


OF_JOB = ("target", "stations", "step_m", "operator")
"""Fields of the job, which can be changed for a recording too."""

_BY_PROCEDURE = "set by the procedure, if one is chosen"

FIELDS = (
    Field("url", "port", kind="text", hint="/dev/ttyUSB0, COM3, socket://host:port"),
    Field("plate_radius_m", "plate radius", "length", hint="empty: value of the instrument"),
    Field("plate_mass_kg", "plate mass", "mass", hint="empty: value of the instrument"),
    Field("poisson_ratio", "Poisson's ratio", hint="0 to below 0.5; empty: 0.35 is assumed"),
    Field("seating_drops", "seating drops", kind="whole", hint=_BY_PROCEDURE),
    Field("measured", "measured drops", kind="whole", hint=_BY_PROCEDURE),
    Field("target", "target", kind="target", hint="for points without their own; empty: none"),
    Field("stations", "stations", kind="file", hint="CSV or GPX with names, places and targets"),
    Field("step_m", "station step", hint="m along the line, from 12+320 to 12+340: 20"),
    Field("operator", "operator", kind="text"),
    Field("site", "site", kind="text"),
)
FIELDS_BY_NAME: Mapping[str, Field] = {field.name: field for field in FIELDS}
_NOT_DECLARED = ("url", "measured", "target", "stations", "step_m")
"""Fields that are not keys of a setup file."""


def quantity_of(field: Field, procedure: Procedure) -> QuantityName | None:
    """Return the quantity of a field; for the target the judged quantity."""
    return procedure.quantity.dimension if field.kind == "target" else field.quantity


def unit_of(field: Field, procedure: Procedure, units: Units) -> str:
    """Return the unit in which a field is typed; empty: none."""
    quantity = quantity_of(field, procedure)
    return "m" if field.name == "step_m" else units.unit(quantity) if quantity else ""


def chosen_procedure(name: str, values: Mapping[str, Any], in_force: Procedure | None) -> Procedure:
    """Return the procedure chosen in the form.

    Parameters
    ----------
    name : str
        Name of a shipped procedure, of `in_force`, or "plain".
    values : mapping
        Seating and measured drops of a plain procedure.
    in_force : Procedure, optional
        Procedure in force.

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
    if in_force is not None and in_force.name == name:
        return in_force
    return find_procedure(name)


def error_of(
    field: Field,
    text: str,
    units: Units,
    procedure: Procedure,
    on_remark: Callable[[str], None] = lambda _: None,
) -> str:
    """Return the error of a typed text; empty: none. `on_remark` as for `value_of`."""
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
    """Return the value of a field in SI; None: the field is empty.

    Parameters
    ----------
    field : Field
    text : str
        Text as typed.
    units : Units
    procedure : Procedure
        Procedure that judges targets.
    on_remark : callable, optional
        Receives remarks that are no errors, for example columns of a file that are ignored.

    Raises
    ------
    ValueError
        With the expected value.
    """
    text = text.strip()
    if not text:
        return None
    if field.kind == "file":
        # A terminal quotes the name of a file that is dropped on it.
        path = os.path.expanduser(text.strip("'\""))
        if not os.path.isfile(path):  # reading a pipe would block
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
            unit = units.unit(field.quantity) if field.quantity else ""
            raise ValueError(
                f"expected {rule.value.expected.split(', in')[0]} {unit}".strip()
            ) from err
    elif not 0 < value < math.inf:
        raise ValueError("expected a number > 0")
    if field.kind == "target":
        fault = typed_target_fault(value, procedure, units)
        if fault:
            raise ValueError(fault)
    return value


def typed_target_fault(target: float, procedure: Procedure, units: Units) -> str:
    """Return the message on a target, SI, in the units of the screen; empty: it is valid."""
    unit = units.of(procedure.quantity.dimension)
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


def form_text(field: Field, value: Any, units: Units, procedure: Procedure) -> str:
    """Return the text of a value in SI for the form."""
    if value is None:
        return ""
    quantity = quantity_of(field, procedure)
    if quantity is not None:
        number = units.value(quantity, float(value))
        return "" if number is None else f"{number:.6g}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def plan_with(plan: SessionPlan, values: Mapping[str, Any], procedure: Procedure) -> SessionPlan:
    """Return the plan with the values of the form.

    Parameters
    ----------
    plan : SessionPlan
    values : mapping
        Values by field, SI; None: not declared.
    procedure : Procedure

    Raises
    ------
    OptionError
        If the values contradict each other.
    """
    declared = dict(plan.setup.declared)
    for name, value in values.items():
        if name in _NOT_DECLARED:
            continue
        if value is None:
            declared.pop(name, None)
        else:
            declared[name] = value
    declared.pop("procedure", None)
    setup = dataclasses.replace(plan.setup, declared=declared, procedure=None)
    if procedure.seating_drops is not None:  # it has priority over the declared number
        declared.pop("seating_drops", None)
    setup = with_procedure(setup, procedure, "procedure")
    return dataclasses.replace(plan, setup=setup, job=job_request(values).over(plan.job))


def job_request(values: Mapping[str, Any]) -> JobRequest:
    """Return the changes of the job by the form; an empty field changes nothing."""
    return JobRequest(**{name: values.get(name) for name in OF_JOB})
