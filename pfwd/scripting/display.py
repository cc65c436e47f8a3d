"""Output that all objects for scripts share: text, table in a notebook, data frame, plot."""

from __future__ import annotations

import html
import itertools
import math
import os
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Self, SupportsIndex, TypeVar, overload

from pfwd.errors import OptionError, refusal
from pfwd.matplotlib_start import start_matplotlib
from pfwd_device.text import clean

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

MAX_NOTEBOOK_ROWS = 20
"""Largest number of rows of a table in a notebook, so that it fits on a screen."""

MAX_TEXT_CHARACTERS = 200
"""Longest text from a file that is shown."""

NOTEBOOK_COLUMNS = (
    *("point", "drop", "status", "state", "drops_measured", "effects", "peak_load_n"),
    *("peak_displacement_m", "modulus_pa", "modulus_interval_low_pa", "modulus_interval_high_pa"),
    *("model", "plate", "plate_radius_m", "poisson_ratio", "residual_rms_over_peak", "in_force"),
    *("modulus_in_force_pa", "use", "verdict", "discarded", "reason", "warnings", "note"),
)
"""Columns of a table in a notebook, in their order; those without any value are omitted."""

_NOTEBOOK_UNITS = {"_pa": (1e-6, "MPa"), "_n": (1e-3, "kN"), "displacement_m": (1e6, "µm")}
"""Factor and unit in which a column is shown, by the end of its name."""


class Displayable:
    """Mix-in of objects that scripts and notebooks show as text and as table.

    ``dir`` and completion list public names only.
    """

    __slots__ = ()

    def __dir__(self) -> Iterable[str]:
        return [name for name in super().__dir__() if not name.startswith("_")]

    def __str__(self) -> str:
        warnings = getattr(self, "warnings", None) or ()
        return "\n".join([repr(self), *(f"  warning: {text_of(text)}" for text in warnings)])

    def _repr_html_(self) -> str:
        return html_table(repr(self), self._rows())

    @abstractmethod
    def _rows(self) -> Iterable[Mapping[str, Any]]:
        """Return the rows of the table, by columns whose names end in their SI unit."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return all values as plain numbers and texts."""

    def to_dataframe(self) -> DataFrame:
        """Return a table with columns in SI units; needs pandas."""
        return data_frame(self._rows())


_Item = TypeVar("_Item", bound=Displayable)


class ObjectSequence(Displayable, tuple[_Item, ...]):
    """Sequence of objects of one class; a slice has the class of the sequence."""

    KEY: ClassVar[str]
    """Key of the objects in `to_dict`."""
    NAME: ClassVar[str] = "point"
    """Attribute of an object with the name by which it can be chosen."""

    @overload
    def __getitem__(self, key: SupportsIndex | str, /) -> _Item: ...
    @overload
    def __getitem__(self, key: slice, /) -> Self: ...
    def __getitem__(self, key: Any, /) -> Any:
        if not isinstance(key, str):
            items = super().__getitem__(key)
            return type(self)(items) if isinstance(key, slice) else items
        names = [str(getattr(item, self.NAME)) for item in self]
        if names.count(key) != 1:
            listed = ", ".join(map(text_of, names))
            raise KeyError(f"{self.KEY}: expected a name that occurs once of {listed}, got {key!r}")
        return self[names.index(key)]

    def _rows(self) -> Iterator[Mapping[str, Any]]:
        for item in self:
            yield from item._rows()

    def to_dict(self) -> dict[str, Any]:
        """Return a dict with a list of the dicts of the objects."""
        return {self.KEY: [item.to_dict() for item in self]}


def alias(path: str) -> Any:
    """Return a property with the value of another attribute, such as ``_peaks.load``.

    The value is None if an object on the path is None.
    """

    def read(value: Any) -> Any:
        for name in path.split("."):
            value = None if value is None else getattr(value, name)
        return value

    return property(read)


def text_of(value: object) -> str:
    """Return a value as one line of text of at most `MAX_TEXT_CHARACTERS`."""
    return clean(str(value), limit=MAX_TEXT_CHARACTERS)


def count(number: int, noun: str) -> str:
    """Return a number with its noun in singular or plural: ``1 drop``, ``2 drops``."""
    return f"{number} {noun}" + ("" if number == 1 else "s")


def warning_count(warnings: Iterable[str]) -> str:
    """Return the number of different warnings as text: ``no warnings``, ``1 warning``."""
    return count(len(set(warnings)), "warning") if warnings else "no warnings"


def conditions(model: object, plate: object, radius: float | None, ratio: float | None) -> str:
    """Return the assumptions of a modulus as text: model, plate, its radius, Poisson's ratio."""
    return f"{model}, {plate} plate of radius {radius:g} m, Poisson's ratio {ratio:g}"


def html_table(caption: str, rows: Iterable[Mapping[str, Any]]) -> str:
    """Return `NOTEBOOK_COLUMNS` of the first rows as a table in HTML.

    A last line states that there are more than `MAX_NOTEBOOK_ROWS`. A point without a name has that
    of its file.
    """
    flat = list(map(flatten, itertools.islice(rows, MAX_NOTEBOOK_ROWS + 1)))
    more = f"<p>first {MAX_NOTEBOOK_ROWS} rows</p>" if len(flat) > MAX_NOTEBOOK_ROWS else ""
    for row in flat:
        row["point"] = row.get("point") or os.path.basename(str(row.get("file") or ""))
    columns = [key for key in NOTEBOOK_COLUMNS if any(r.get(key) not in (None, "") for r in flat)]
    head = "".join(f"<th>{html.escape(_heading(key))}</th>" for key in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(_cell(key, row))}</td>" for key in columns) + "</tr>"
        for row in flat[:MAX_NOTEBOOK_ROWS]
    )
    return (
        f"<table><caption>{html.escape(caption)}</caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"
    )


def _table_unit(key: str) -> tuple[float, str]:
    ends = (factor_unit for end, factor_unit in _NOTEBOOK_UNITS.items() if key.endswith(end))
    return next(ends, (1.0, "m" if key.endswith("_m") else ""))


def _heading(key: str) -> str:
    unit = _table_unit(key)[1]
    name = key.rpartition("_")[0] if unit else key
    return name.replace("_", " ") + (f", {unit}" if unit else "")


def _cell(key: str, row: Mapping[str, Any]) -> str:
    value = row.get(key)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{_table_unit(key)[0] * value:.4g}"
    return "" if value is None else text_of(value)


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
        elif isinstance(value, list | tuple):
            columns[key] = "; ".join(map(str, value))
        else:
            columns[key] = value
    return columns


def data_frame(rows: Iterable[Mapping[str, Any]]) -> DataFrame:
    """Return rows as a pandas DataFrame, see `flatten`.

    Raises
    ------
    OptionError
        If pandas is not installed.
    """
    return imported("pandas", "to_dataframe").DataFrame(list(map(flatten, rows)))


def imported(package: str, method: str) -> Any:
    """Return a package that only one method needs.

    Raises
    ------
    OptionError
        If it is not installed.
    """
    try:
        return import_module(package)
    except ImportError as err:
        hint = f"python -m pip install {package}, or use to_dict()"
        raise OptionError(refusal(f"{method}()", f"the package {package}", "none", hint)) from err


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
    imported("matplotlib", "plot")
    from matplotlib import pyplot

    return pyplot.subplots(layout="constrained")[1]


def draw_values(
    ax: Axes,
    values: Mapping[int, tuple[float, tuple[float, float] | None]],
    factor: float,
    **style: Any,
) -> None:
    """Draw values with their intervals, by their places on the axis, multiplied by a factor."""
    pairs = [(value, interval or (value, value)) for value, interval in values.values()]
    heights = [factor * value for value, _ in pairs]
    below = [factor * (value - low) for value, (low, _) in pairs]
    above = [factor * (high - value) for value, (_, high) in pairs]
    ax.errorbar(list(values), heights, [below, above], capsize=3, **style)


def label_axes(ax: Axes, x: str | Sequence[str], y: str, title: str) -> Axes:
    """Label axes, and return them.

    Parameters
    ----------
    ax : Axes of matplotlib
    x : label of the axis, or the names at 0, 1, 2, ...
    y, title : label and title
    """
    if isinstance(x, str):
        ax.set_xlabel(x)
    else:
        ax.set_xticks(range(len(x)), map(text_of, x), rotation=30, ha="right", parse_math=False)
    ax.set_ylabel(y)
    ax.set_title(title, fontsize="small", parse_math=False, wrap=True)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize="small")
    return ax
