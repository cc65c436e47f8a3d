"""Output that all objects for scripts share: text, table in a notebook, data frame, plot."""

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

MAX_NOTEBOOK_ROWS = 20
"""Largest number of rows of a table in a notebook, so that it fits on a screen."""

MAX_SHOWN_CHARACTERS = 200
"""Longest text from a file that is shown."""


class ScriptObject:
    """Base of the objects for scripts; ``dir`` and completion list public names only."""

    __slots__ = ()

    def __dir__(self) -> Iterable[str]:
        return [name for name in super().__dir__() if not name.startswith("_")]


def text_of(value: object) -> str:
    """Return a value as one line of text of at most `MAX_SHOWN_CHARACTERS`."""
    return clean(str(value), limit=MAX_SHOWN_CHARACTERS)


def megapascal(value: float) -> str:
    """Return a modulus, Pa, as text in MPa with four digits, without the unit."""
    return f"{value / 1e6:.4g}"


def count(number: int, noun: str) -> str:
    """Return a number with its noun in singular or plural: ``1 drop``, ``2 drops``."""
    return f"{number} {noun}" + ("" if number == 1 else "s")


def html_table(caption: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a table in HTML; rows beyond `MAX_NOTEBOOK_ROWS` are counted in a last line."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(text_of(cell))}</td>" for cell in row) + "</tr>"
        for row in rows[:MAX_NOTEBOOK_ROWS]
    )
    omitted = len(rows) - MAX_NOTEBOOK_ROWS
    more = f"<p>and {count(omitted, 'row')} more</p>" if omitted > 0 else ""
    return (
        f"<table><caption>{html.escape(caption)}</caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"
    )


def flatten(record: Mapping[str, Any]) -> dict[str, Any]:
    """Convert a result with nested values to one row of a table.

    An interval becomes two columns (``modulus_interval_low_pa``, ``modulus_interval_high_pa``), a
    nested record one column for each key (``half_sine_duration_s``), and a list of texts one text.

    Parameters
    ----------
    record : mapping
        Result with the keys of ``pfwd invert --json``.
    """
    columns: dict[str, Any] = {}
    for key, value in record.items():
        if key.rpartition("_")[0].endswith("_interval"):
            name, _, unit = key.rpartition("_")
            low, high = value or (None, None)
            columns |= {f"{name}_low_{unit}": low, f"{name}_high_{unit}": high}
        elif isinstance(value, Mapping):
            columns |= {f"{key}_{inner}": item for inner, item in value.items()}
        elif isinstance(value, list):
            columns[key] = "; ".join(map(str, value))
        else:
            columns[key] = value
    return columns


def data_frame(rows: Iterable[Mapping[str, Any]]) -> DataFrame:
    """Return rows as a pandas DataFrame.

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
    """Return the given axes; for None, those of a new figure.

    Parameters
    ----------
    ax : Axes of matplotlib, or None

    Raises
    ------
    OptionError
        If `ax` is no axes object, or matplotlib is not installed.
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
