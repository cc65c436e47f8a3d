"""Small example files that ship with the package; what was simulated stands in data/README.md."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args, overload

from pfwd.errors import OptionError, quote, refusal
from pfwd.scripting.measured import Points, read

if TYPE_CHECKING:
    from pfwd.scripting.surveys import Survey

Traces = Literal["half-space", "layer", "three-sensors", "unexplained"]
SURVEY: Literal["survey"] = "survey"
FOLDER = Path(__file__).resolve().parent / "data"


@overload
def example(name: Traces) -> Points: ...
@overload
def example(name: Literal["survey"]) -> Survey: ...
def example(name: str) -> Points | Survey:
    """An example that ships with the package: simulated by finite elements, noise included.

    Parameters
    ----------
    name : "half-space" (one drop), "layer" (three drops, soil on rock), "three-sensors" (one drop,
        depth of the rock not declared), "unexplained" (one drop that the base model cannot
        explain), or "survey" (four points with positions and results)

    Returns
    -------
    Points, or for "survey" a Survey

    Raises
    ------
    OptionError
        If there is no such example.

    Examples
    --------
    >>> pfwd.example("three-sensors")
    Points(three-sensors.csv: 1 point, 1 drop)
    """
    if name == SURVEY:
        from pfwd.scripting.surveys import open

        return open(FOLDER / f"{name}.h5")
    names = get_args(Traces)
    if name not in names:
        expected = f"one of {', '.join([*names, SURVEY])}"
        raise OptionError(refusal("example", expected, quote(name)))
    return read(FOLDER / f"{name}.csv")
