"""Strict reader of a procedure's TOML profile.

Unknown keys and numbers without a source are errors.
"""

import os
from collections.abc import Mapping
from typing import Any

from pfwd.errors import OptionError, quote, refusal
from pfwd.procedures.profile import CHECKS, Procedure, Quantity, SourcedNumber, Target, number_words
from pfwd.toml_reading import parse_user_toml, read_toml_text
from pfwd_device.schema import Array, Choice, Flag, Key, Number, TableReader, Text, TomlTable

PROFILE_FORMAT_KEY = "pfwd-procedure"
FORMAT_VERSION = 1

MAX_PROFILE_LENGTH = 100_000
"""Largest number of characters of a profile; the usual ones have a few thousand."""

MAX_DROPS_OF_A_KIND = 100
"""Largest accepted number of seating or measured drops; a larger one is a typing error."""

_NUMBER_EXAMPLE = 'for example { value = 3, source = "where it is written", verified = true }'


def _sourced(value: Number, meaning: str) -> Key:
    """Return the TOML key of a number that the profile has to state together with its source."""
    keys = {
        "value": Key(value, meaning=meaning, hint=_NUMBER_EXAMPLE, required=True),
        "source": Key(
            Text(min_length=1),
            meaning="Document and place that state the number.",
            hint=_NUMBER_EXAMPLE,
            required=True,
        ),
        "verified": Key(
            Flag(),
            meaning="True when a public text confirms the number.",
            hint=_NUMBER_EXAMPLE,
            required=True,
        ),
    }
    return Key(TomlTable(keys, "a number with its source"), meaning=meaning, hint=_NUMBER_EXAMPLE)


def _drop_count(minimum: int, meaning: str) -> Key:
    count = Number(minimum=minimum, maximum=MAX_DROPS_OF_A_KIND, integral=True)
    return _sourced(count, meaning)


_POSITIVE = Number(above=0)
_TARGET_KEYS = {
    "value_pa": _sourced(Number("Pa", above=0), "Smallest accepted modulus."),
    "value_m": _sourced(Number("m", above=0), "Largest accepted deflection."),
    "material": Key(Text(), meaning="Material that the target applies to."),
    "moisture_from_percent": Key(
        Number("percent", infinity_means="none"), "moisture_from", "Moisture, inclusive."
    ),
    "moisture_to_percent": Key(
        Number("percent", infinity_means="none"), "moisture_to", "Moisture, exclusive."
    ),
}
PROFILE_KEYS = {
    "name": Key(Text(min_length=1), meaning="Short name for --procedure.", required=True),
    "title": Key(Text(min_length=1), meaning="Title in reports.", required=True),
    "source": Key(Text(min_length=1), meaning="Document of the procedure.", required=True),
    "about": Key(Text(), meaning="Description for people."),
    "quantity": Key(
        Choice(Quantity), meaning="Quantity by which a point is judged.", required=True
    ),
    "average": Key(
        Choice(("deflection", "modulus")), meaning="Average over the measured drops of a point."
    ),
    "centre_sensor": Key(
        Choice(("plate", "ground")), meaning="Place of the centre sensor that is presumed."
    ),
    "drops": Key(
        TomlTable(
            {
                "seating": _drop_count(0, "Number of seating drops."),
                "measured": _drop_count(1, "Number of measured drops."),
            }
        )
    ),
    "formula": Key(
        TomlTable(
            {
                "factor": _sourced(_POSITIVE, "Shape factor of the stress under the plate."),
                "nominal_pressure_pa": _sourced(Number("Pa", above=0), "Nominal pressure."),
                "nominal_load_n": _sourced(Number("N", above=0), "Nominal load."),
                "poisson_ratio": _sourced(Number(minimum=0, maximum=0.5), "Poisson's ratio."),
                "plate_radius_m": _sourced(Number("m", above=0), "Plate radius."),
            }
        )
    ),
    "checks": Key(
        TomlTable(
            {
                name: _sourced(Number(minimum=0), f"{words[:1].upper()}{words[1:]}.")
                for name, words in zip(CHECKS, map(number_words, CHECKS), strict=True)
            }
        )
    ),
    "targets": Key(Array(TomlTable(_TARGET_KEYS)), meaning="Targets, one table each."),
}
"""Keys of a profile, apart from the version of its format."""


def read_procedure(path: str | os.PathLike[str], *, enforce_unverified: bool = False) -> Procedure:
    """Return the procedure that a TOML file describes.

    Parameters
    ----------
    path : path of a TOML file
    enforce_unverified : bool
        True: numbers without a verified source are enforced too.

    Returns
    -------
    Procedure

    Raises
    ------
    OptionError
        If the file cannot be read, a key is unknown or a value is not accepted; the message names
        the place.
    """
    file = os.fspath(path)
    text = read_toml_text(file, OptionError, MAX_PROFILE_LENGTH)
    return parse_procedure(text, file, enforce_unverified=enforce_unverified)


def parse_procedure(
    text: str, where: str, *, shipped: bool = False, enforce_unverified: bool = False
) -> Procedure:
    """Return the procedure that a TOML text describes; see `read_procedure` for its errors.

    Parameters
    ----------
    text : str
    where : str
        Origin of the text, the beginning of error messages.
    shipped : bool
        True: the profile is part of the program.
    enforce_unverified : bool
        True: numbers without a verified source are enforced too.
    """
    values = TableReader(OptionError, where).read(_table_of(text, where), PROFILE_KEYS)
    quantity = Quantity(values["quantity"])
    drops, formula, checks = (
        {key: _number(number) for key, number in values.get(name, {}).items()}
        for name in ("drops", "formula", "checks")
    )
    _require_formula(quantity, formula, where)
    return Procedure(
        name=values["name"].strip(),
        title=values["title"].strip(),
        source=values["source"].strip(),
        about=values.get("about", "").strip(),
        seating=drops.get("seating"),
        measured=drops.get("measured"),
        quantity=quantity,
        average=values.get("average", "deflection"),
        factor=formula.get("factor"),
        nominal_pressure=formula.get("nominal_pressure_pa"),
        nominal_load=formula.get("nominal_load_n"),
        poisson_ratio=formula.get("poisson_ratio"),
        plate_radius=formula.get("plate_radius_m"),
        centre_sensor=values.get("centre_sensor"),
        checks=checks,
        targets=tuple(
            _target(target, quantity, f"{where}, targets[{number}]")
            for number, target in enumerate(values.get("targets", ()), 1)
        ),
        enforce_unverified=enforce_unverified,
        text=text,
        file=None if shipped else where,
    )


def _table_of(text: str, where: str) -> dict[str, Any]:
    """Parse a profile and return its keys except the version of the format, which is checked."""
    table = parse_user_toml(text, where, OptionError)
    version = table.pop(PROFILE_FORMAT_KEY, None)
    if type(version) is not int or version != FORMAT_VERSION:
        hint = "a file of a newer version needs a newer program"
        got = "none" if version is None else quote(version)
        raise OptionError(refusal(where, f"{PROFILE_FORMAT_KEY} = {FORMAT_VERSION}", got, hint))
    return table


def _number(values: Mapping[str, Any]) -> SourcedNumber:
    return SourcedNumber(values["value"], values["source"].strip(), values["verified"])


def _require_formula(quantity: Quantity, formula: Mapping[str, SourcedNumber], where: str) -> None:
    if quantity in (Quantity.E_VD, Quantity.E_LWD) and "factor" not in formula:
        raise OptionError(refusal(where, f"[formula] factor for {quantity}", "none"))
    if quantity is Quantity.E_VD and "nominal_pressure_pa" not in formula:
        raise OptionError(refusal(where, "[formula] nominal_pressure_pa for E_vd", "none"))


def _target(values: Mapping[str, Any], quantity: Quantity, where: str) -> Target:
    value_key, wrong_key = ("value_pa", "value_m")
    if quantity is Quantity.DEFLECTION:
        value_key, wrong_key = wrong_key, value_key
    if value_key not in values or wrong_key in values:
        raise OptionError(
            refusal(where, f"{value_key} for {quantity}", ", ".join(values) or "none")
        )
    limits = {key: values.get(key) for key in ("material", "moisture_from", "moisture_to")}
    return Target(_number(values[value_key]), **limits)
