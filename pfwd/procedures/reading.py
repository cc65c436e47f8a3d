"""Reads a procedure from TOML, strictly: an unknown key or a number without a source is refused."""

import difflib
import os
from collections.abc import Mapping, Sequence
from typing import Any

from inversion.records import is_number
from pfwd.errors import OptionError, quote, refusal
from pfwd.procedures.profile import CHECKS, Number, Procedure, Quantity, Target
from pfwd.toml_reading import parse_toml

FORMAT_KEY = "pfwd-procedure"
FORMAT_VERSION = 1

LARGEST_FILE = 100_000
"""Characters; a profile takes a few thousand."""

MOST_DROPS = 100
"""Of one kind; a larger number is a slip of the keyboard."""

_TEXTS = ("name", "title", "source", "about", "quantity", "average")
_TABLES = ("drops", "formula", "checks")
_DROPS = ("seating", "measured")
_FORMULA = ("factor", "nominal_pressure_pa", "nominal_load_n", "poisson_ratio", "plate_radius_m")
_TARGET = ("value_pa", "value_m", "material", "moisture_from_percent", "moisture_to_percent")
_AVERAGES = ("deflection", "modulus")
_EXAMPLE = '{ value = 3, source = "where it is written", verified = true }'


def read_procedure(path: str | os.PathLike[str], *, enforce_unverified: bool = False) -> Procedure:
    """The procedure that a TOML file holds.

    Parameters
    ----------
    path : path of a TOML file
    enforce_unverified : bool
        Whether numbers that are not verified are enforced too.

    Returns
    -------
    Procedure

    Raises
    ------
    OptionError
        If it cannot be read, or anything in it is not understood; the message says where.
    """
    file = os.fspath(path)
    try:
        with open(file, encoding="utf-8-sig") as stream:
            text = stream.read(LARGEST_FILE + 1)
    except OSError as err:
        raise OptionError(refusal(file, "a readable TOML file", err.strerror or str(err))) from err
    except UnicodeDecodeError as err:
        raise OptionError(refusal(file, "UTF-8 text", "other bytes")) from err
    if len(text) > LARGEST_FILE:
        raise OptionError(refusal(file, f"at most {LARGEST_FILE} characters", "more"))
    return parse_procedure(text, file, enforce_unverified=enforce_unverified)


def parse_procedure(
    text: str, where: str, *, shipped: bool = False, enforce_unverified: bool = False
) -> Procedure:
    """The procedure that a TOML text holds; see `read_procedure`.

    Parameters
    ----------
    text : str
    where : str
        Where it is from, for messages.
    shipped : bool
        Whether it came with the program.
    enforce_unverified : bool
    """
    table = _table_of(text, where)
    _refuse_unknown(table, (*_TEXTS, *_TABLES, "targets"), where)
    texts = {key: _text(table, key, where) for key in _TEXTS if key in table}
    for key in ("name", "title", "source"):
        if not texts.get(key):
            raise OptionError(refusal(where, f"{key}, a text", "none"))
    quantity = _quantity(texts.get("quantity"), where)
    drops = _numbers(table, "drops", _DROPS, where)
    formula = _numbers(table, "formula", _FORMULA, where)
    for key, number in drops.items():
        _check_count(key, number, where)
    _check_formula(formula, where)
    checks = _numbers(table, "checks", tuple(CHECKS), where)
    for key, number in checks.items():
        if number.value < 0:
            raise OptionError(refusal(f"{where}, [checks] {key}", "a number >= 0", quote(number)))
    _require_formula(quantity, formula, where)
    return Procedure(
        name=texts["name"],
        title=texts["title"],
        source=texts["source"],
        about=texts.get("about", ""),
        seating=drops.get("seating"),
        measured=drops.get("measured"),
        quantity=quantity,
        average=_average(texts.get("average", "deflection"), where),
        factor=formula.get("factor"),
        nominal_pressure=formula.get("nominal_pressure_pa"),
        nominal_load=formula.get("nominal_load_n"),
        poisson_ratio=formula.get("poisson_ratio"),
        plate_radius=formula.get("plate_radius_m"),
        checks=checks,
        targets=_targets(table.get("targets", []), quantity, where),
        enforce_unverified=enforce_unverified,
        text=text,
        file=None if shipped else where,
    )


def _table_of(text: str, where: str) -> dict[str, Any]:
    """The text as TOML, without the key that says that it is a procedure."""
    try:
        table = parse_toml(text)
    except ValueError as err:  # also numbers without end
        raise OptionError(refusal(where, "TOML", str(err))) from err
    version = table.pop(FORMAT_KEY, None)
    if type(version) is not int or version != FORMAT_VERSION:
        hint = "a file of a newer version needs a newer program"
        came = "none" if version is None else quote(version)
        raise OptionError(refusal(where, f"{FORMAT_KEY} = {FORMAT_VERSION}", came, hint))
    return table


def _refuse_unknown(table: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    for key in table:
        if key not in known:
            near = difflib.get_close_matches(key, known, 1)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
            raise OptionError(refusal(where, "a key of a procedure", quote(key), hint))


def _text(table: Mapping[str, Any], key: str, where: str) -> str:
    value = table[key]
    if not isinstance(value, str):
        raise OptionError(refusal(f"{where}, {key}", "text in quotation marks", quote(value)))
    return value.strip()


def _quantity(text: str | None, where: str) -> Quantity:
    if text is not None and text in list(Quantity):
        return Quantity(text)
    expected = f"quantity, one of {', '.join(Quantity)}"
    raise OptionError(refusal(where, expected, "none" if text is None else quote(text)))


def _average(text: str, where: str) -> str:
    if text not in _AVERAGES:
        raise OptionError(refusal(where, f"average, one of {', '.join(_AVERAGES)}", quote(text)))
    return text


def _numbers(
    table: Mapping[str, Any], name: str, known: Sequence[str], where: str
) -> dict[str, Number]:
    given = table.get(name, {})
    if not isinstance(given, dict):
        raise OptionError(refusal(f"{where}, {name}", f"a table [{name}]", quote(given)))
    _refuse_unknown(given, known, f"{where}, [{name}]")
    return {key: _number(value, f"{where}, [{name}] {key}") for key, value in given.items()}


def _number(given: object, where: str) -> Number:
    if not isinstance(given, dict):
        raise OptionError(refusal(where, "a number with its source", quote(given), _EXAMPLE))
    _refuse_unknown(given, ("value", "source", "verified"), where)
    value, source, verified = (given.get(key) for key in ("value", "source", "verified"))
    if not is_number(value):
        came = "none" if value is None else quote(value)
        raise OptionError(refusal(where, "value, a finite number", came, _EXAMPLE))
    if not isinstance(verified, bool):
        came = "none" if verified is None else quote(verified)
        raise OptionError(refusal(where, "verified, true or false", came, _EXAMPLE))
    if not isinstance(source, str) or not source.strip():
        came = "none" if source is None else quote(source)
        raise OptionError(refusal(where, "source, a text", came, _EXAMPLE))
    return Number(float(value), source.strip(), verified)


def _check_count(key: str, number: Number, where: str) -> None:
    least = 1 if key == "measured" else 0
    if number.value != int(number.value) or not least <= number.value <= MOST_DROPS:
        expected = f"a whole number from {least} to {MOST_DROPS}"
        raise OptionError(refusal(f"{where}, [drops] {key}", expected, f"{number.value:g}"))


def _check_formula(formula: Mapping[str, Number], where: str) -> None:
    for key, number in formula.items():
        if key == "poisson_ratio":
            sound, expected = 0 <= number.value <= 0.5, "0 <= number <= 0.5"
        else:
            sound, expected = number.value > 0, "a number > 0"
        if not sound:
            raise OptionError(refusal(f"{where}, [formula] {key}", expected, f"{number.value:g}"))


def _require_formula(quantity: Quantity, formula: Mapping[str, Number], where: str) -> None:
    if quantity in (Quantity.E_VD, Quantity.E_LWD) and "factor" not in formula:
        raise OptionError(refusal(where, f"[formula] factor for {quantity}", "none"))
    if quantity is Quantity.E_VD and "nominal_pressure_pa" not in formula:
        raise OptionError(refusal(where, "[formula] nominal_pressure_pa for E_vd", "none"))


def _targets(given: object, quantity: Quantity, where: str) -> tuple[Target, ...]:
    if not isinstance(given, list):
        raise OptionError(refusal(f"{where}, targets", "tables [[targets]]", quote(given)))
    return tuple(
        _target(table, quantity, f"{where}, [[targets]] {index}")
        for index, table in enumerate(given, 1)
    )


def _target(given: object, quantity: Quantity, where: str) -> Target:
    if not isinstance(given, dict):
        raise OptionError(refusal(where, "a table", quote(given)))
    _refuse_unknown(given, _TARGET, where)
    key = "value_m" if quantity is Quantity.DEFLECTION else "value_pa"
    if key not in given or ("value_m" in given and "value_pa" in given):
        raise OptionError(refusal(where, f"{key} for {quantity}", ", ".join(given) or "none"))
    value = _number(given[key], f"{where} {key}")
    if value.value <= 0:
        raise OptionError(refusal(f"{where} {key}", "a number > 0", f"{value.value:g}"))
    material = given.get("material")
    if material is not None and not isinstance(material, str):
        raise OptionError(refusal(f"{where} material", "text", quote(material)))
    ends = []
    for name in ("moisture_from_percent", "moisture_to_percent"):
        end = given.get(name)
        if end is not None and (isinstance(end, bool) or not isinstance(end, int | float)):
            raise OptionError(refusal(f"{where} {name}", "a number, in percent", quote(end)))
        ends.append(None if end is None else float(end))
    return Target(value, material, ends[0], ends[1])
