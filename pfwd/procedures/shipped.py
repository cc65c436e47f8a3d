"""Procedures that come with the program, and the lookup of a procedure by its name or file."""

import os
from functools import cache
from importlib import resources

from pfwd.errors import OptionError, quote, refusal
from pfwd.procedures.profile import Procedure, Quantity
from pfwd.procedures.reading import parse_procedure, read_procedure

NO_PROCEDURE = Procedure(
    name="none",
    title="",
    source="",
    about="",
    quantity=Quantity.EQUIVALENT_MODULUS,
    average="modulus",
)
"""Procedure without requirements: all measured drops are averaged, and the equivalent modulus is
judged.
"""

PLAIN = "plain"
"""Name of the default procedure, which follows no published document."""

DEFAULT_SEATING_DROPS, DEFAULT_MEASURED_DROPS = 3, 3
"""Common practice with portable deflectometers: three drops seat the plate, three are averaged."""

_CHOSEN = "chosen for this survey, after no document"


@cache
def _texts() -> dict[str, str]:
    folder = resources.files(__package__).joinpath("profiles")
    files = sorted(file.name for file in folder.iterdir() if file.name.endswith(".toml"))
    return {
        name.removesuffix(".toml"): folder.joinpath(name).read_text(encoding="utf-8")
        for name in files
    }


def shipped_names() -> tuple[str, ...]:
    """Return the names of the procedures that come with the program, sorted."""
    return tuple(_texts())


def shipped_procedures() -> tuple[Procedure, ...]:
    """Return the procedures that come with the program, sorted by name."""
    return tuple(
        parse_procedure(text, f"procedure {name}", shipped=True) for name, text in _texts().items()
    )


def find_procedure(name: str, *, enforce_unverified: bool = False) -> Procedure:
    """Return the procedure of a name, or the one that a TOML file describes.

    Parameters
    ----------
    name : str
        A name of `shipped_names`, or a path that ends in .toml.
    enforce_unverified : bool
        True: numbers without a verified source are enforced too.

    Raises
    ------
    OptionError
        If no procedure has this name, or the file is not valid.
    """
    text = _texts().get(name)
    if text is not None:
        return parse_procedure(
            text, f"procedure {name}", shipped=True, enforce_unverified=enforce_unverified
        )
    if name.lower().endswith(".toml") or os.path.isfile(name):
        return read_procedure(name, enforce_unverified=enforce_unverified)
    expected = f"one of {', '.join(shipped_names())}, or a file .toml"
    raise OptionError(refusal("procedure", expected, quote(name), "pfwd procedures lists them"))


def plain_procedure(
    seating: int = DEFAULT_SEATING_DROPS, measured: int = DEFAULT_MEASURED_DROPS
) -> Procedure:
    """Return the default procedure: the mean equivalent modulus of the measured drops is judged.

    Parameters
    ----------
    seating, measured : int
        Required number of seating drops and of measured drops.
    """
    source = f'source = "{_CHOSEN}"'
    text = (
        "pfwd-procedure = 1\n"
        f'name = "{PLAIN}"\n'
        'title = "seating drops, then measured drops"\n'
        f"{source}\n"
        'quantity = "equivalent-modulus"\n'
        'average = "modulus"\n'
        "[drops]\n"
        f"seating = {{ value = {seating}, {source}, verified = true }}\n"
        f"measured = {{ value = {measured}, {source}, verified = true }}\n"
    )
    return parse_procedure(text, f"procedure {PLAIN}", shipped=True)
