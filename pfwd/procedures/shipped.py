"""The procedures that come with the program, and how a procedure is found by its name."""

import os
from functools import cache
from importlib import resources

from pfwd.errors import OptionError, quote, refusal
from pfwd.procedures.profile import Procedure
from pfwd.procedures.reading import parse_procedure, read_procedure


@cache
def _texts() -> dict[str, str]:
    folder = resources.files(__package__).joinpath("profiles")
    files = sorted(file.name for file in folder.iterdir() if file.name.endswith(".toml"))
    return {
        name.removesuffix(".toml"): folder.joinpath(name).read_text(encoding="utf-8")
        for name in files
    }


def shipped_names() -> tuple[str, ...]:
    """Names of the procedures that come with the program, sorted."""
    return tuple(_texts())


def shipped_procedures() -> tuple[Procedure, ...]:
    """The procedures that come with the program, by name."""
    return tuple(
        parse_procedure(text, f"procedure {name}", shipped=True) for name, text in _texts().items()
    )


def find_procedure(name: str, *, enforce_unverified: bool = False) -> Procedure:
    """A shipped procedure by its name, or the one that a TOML file holds.

    Parameters
    ----------
    name : str
        A name of `shipped_names`, or a path that ends in .toml.
    enforce_unverified : bool
        Whether numbers that are not verified are enforced too.

    Raises
    ------
    OptionError
        If there is none of this name, or its file is refused.
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
