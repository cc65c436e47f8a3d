"""How things show themselves: one line, a small table, plain values, a data frame, axes."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pfwd.errors import OptionError, refusal
from pfwd.matplotlib_start import start_matplotlib
from pfwd_device.text import clean

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

MOST_ROWS = 20
"""Of a table in a notebook; more would push what is below it off the screen."""

LONGEST_TEXT = 200
"""Characters of a text from a file, in a line for people."""


class Shown:
    """What all objects of the package share: completion shows the public names alone."""

    __slots__ = ()

    def __dir__(self) -> Iterable[str]:
        return [name for name in super().__dir__() if not name.startswith("_")]


def text_of(value: object) -> str:
    """A value from a file as it may stand in a line."""
    return clean(str(value), limit=LONGEST_TEXT)


def megapascal(value: float) -> str:
    """A modulus (Pa) in MPa with four digits, without the unit."""
    return f"{value / 1e6:.4g}"


def count(number: int, noun: str) -> str:
    """A number of things: ``1 drop``, ``2 drops``."""
    return f"{number} {noun}" + ("" if number == 1 else "s")


def html_table(caption: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A small table for a notebook; at most `MOST_ROWS` rows, and how many are left out."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(text_of(cell))}</td>" for cell in row) + "</tr>"
        for row in rows[:MOST_ROWS]
    )
    left = len(rows) - MOST_ROWS
    more = f"<p>and {count(left, 'row')} more</p>" if left > 0 else ""
    return (
        f"<table><caption>{html.escape(caption)}</caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"
    )


def flat(record: Mapping[str, Any]) -> dict[str, Any]:
    """A result's record as columns of a table.

    Pairs become two columns (``modulus_interval_low_pa``, ``modulus_interval_high_pa``),
    inner records columns of their own (``half_sine_duration_s``), texts one text.
    """
    found: dict[str, Any] = {}
    for key, value in record.items():
        if key.rpartition("_")[0].endswith("_interval"):
            name, _, unit = key.rpartition("_")
            low, high = value or (None, None)
            found |= {f"{name}_low_{unit}": low, f"{name}_high_{unit}": high}
        elif isinstance(value, Mapping):
            found |= {f"{key}_{inner}": item for inner, item in value.items()}
        elif isinstance(value, list):
            found[key] = "; ".join(map(str, value))
        else:
            found[key] = value
    return found


def data_frame(rows: Iterable[Mapping[str, Any]]) -> DataFrame:
    """The rows as a data frame of pandas.

    Raises
    ------
    OptionError
        If pandas is not installed.
    """
    try:
        import pandas
    except ImportError as err:
        hint = "python -m pip install pandas, or to_dict()"
        raise OptionError(refusal("to_dataframe()", "the package pandas", "none", hint)) from err
    return pandas.DataFrame(list(rows))


def axes_or_new(ax: Axes | None) -> Axes:
    """The axes that were given, or those of a new figure.

    Raises
    ------
    OptionError
        If what was given is no axes, or matplotlib is not installed.
    """
    if ax is not None:
        if not hasattr(ax, "plot"):
            expected = "axes of matplotlib, or nothing for a new figure"
            raise OptionError(refusal("ax", expected, type(ax).__name__))
        return ax
    start_matplotlib()
    try:
        from matplotlib import pyplot
    except ImportError as err:
        hint = "python -m pip install matplotlib"
        raise OptionError(refusal("plot()", "the package matplotlib", "none", hint)) from err
    return pyplot.subplots(layout="constrained")[1]
