"""Output that the objects for scripts share: text, table in a notebook, data frame, plot."""

from __future__ import annotations

import html
import itertools
import math
import os
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Self, SupportsIndex, TypeVar, overload

from inversion.notices import Notice, text_of
from pfwd.errors import OptionError, how_to_install, refusal
from pfwd.units import SI, Fact, QuantityName
from pfwd_device.text import clean
from pfwd_plugins.quantities import Unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

    from inversion.diagnosis.findings import DropCurves
    from inversion.result import TimeHistories

MAX_NOTEBOOK_ROWS = 20
"""Largest number of rows of a table in a notebook, so that it fits on a screen."""

MAX_TEXT_CHARACTERS = 200
"""Longest text from a file that is shown."""

NOTEBOOK_COLUMNS = (
    *("point", "drop", "status", "state", "drops_measured", "effects", "peak_load_n"),
    *("peak_displacement_m", "modulus_pa", "model", "plate", "plate_radius_m", "poisson_ratio"),
    *("residual_rms_over_peak", "in_force"),
    *("modulus_in_force_pa", "use", "verdict", "discarded", "reason", "warnings", "note"),
)
"""Columns of a table in a notebook, in their order; those without any value are omitted."""

_NOTEBOOK_QUANTITIES: Mapping[str, QuantityName | Unit] = {
    "_pa": "modulus",
    "_n": "load",
    "displacement_m": "deflection",
    "radius_m": "depth",
    "": Unit("", 1.0),
}
"""Quantity of a column by the end of its name."""

COLOURS = ("#0b3c5d", "#b8500f", "#3d7a2a", "#7b3f8c", "#8a6d00", "#444444")
"""Colours of sensors, distinguishable without colour vision."""

BEFORE_COLOUR, AFTER_COLOUR = "#9a9a9a", "#2a6f97"
"""Colours of a fit without effects, and of the fit with effects."""

TIME_LABEL = "time after the trigger, ms"
DISPLACEMENT_LABEL = "displacement, µm, downward positive"


class Displayable:
    """Mix-in of objects that scripts and notebooks show as text, table, values and picture."""

    __slots__ = ()

    def __str__(self) -> str:
        warnings = getattr(self, "warnings", None) or ()
        return "\n".join(
            [repr(self), *(f"  warning: {one_line(text_of(item))}" for item in warnings)]
        )

    def _repr_html_(self) -> str:
        return html_table(repr(self), self.rows())

    @abstractmethod
    def rows(self) -> Iterable[Mapping[str, Any]]:
        """Return the rows of the table, by columns whose names end in their SI unit."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return all values as plain numbers and texts."""

    def to_dataframe(self) -> DataFrame:
        """Return a table with columns in SI units; needs pandas."""
        return data_frame(self.rows())


_Item = TypeVar("_Item", bound=Displayable)


class DisplayableList(Displayable, tuple[_Item, ...]):
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
            listed = ", ".join(map(one_line, names))
            raise KeyError(f"{self.KEY}: expected a name that occurs once of {listed}, got {key!r}")
        return self[names.index(key)]

    def rows(self) -> Iterator[Mapping[str, Any]]:
        """Return the rows of all objects."""
        return itertools.chain.from_iterable(item.rows() for item in self)

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


def one_line(value: object) -> str:
    """Return a value as one line of text of at most `MAX_TEXT_CHARACTERS`."""
    return clean(str(value), limit=MAX_TEXT_CHARACTERS)


def count(number: int, noun: str) -> str:
    """Return a number with its noun in singular or plural: ``1 drop``, ``2 drops``."""
    return f"{number} {noun}" + ("" if number == 1 else "s")


def warning_count(warnings: Iterable[Notice] | None) -> str:
    """Return the number of different warnings as text: ``no warnings``, ``1 warning``."""
    return count(len(set(map(text_of, warnings))), "warning") if warnings else "no warnings"


def html_table(caption: str, rows: Iterable[Mapping[str, Any]]) -> str:
    """Return `NOTEBOOK_COLUMNS` of the first rows as a table in HTML.

    A last line states that there are more than `MAX_NOTEBOOK_ROWS`. A point without a name has that
    of its file.
    """
    flat = list(map(flatten, itertools.islice(rows, MAX_NOTEBOOK_ROWS + 1)))
    for row in flat:
        row["point"] = row.get("point") or os.path.basename(str(row.get("file") or ""))
    columns = [key for key in NOTEBOOK_COLUMNS if any(r.get(key) not in (None, "") for r in flat)]
    cells = [[_cell(row, key) for key in columns] for row in flat]
    head = _html_row("th", map(_heading, columns))
    body = "".join(_html_row("td", line) for line in cells[:MAX_NOTEBOOK_ROWS])
    more = f"<p>first {MAX_NOTEBOOK_ROWS} rows</p>" if len(flat) > MAX_NOTEBOOK_ROWS else ""
    return (
        f"<table><caption>{html.escape(caption)}</caption>"
        f"<thead>{head}</thead><tbody>{body}</tbody></table>{more}"
    )


def _html_row(tag: str, cells: Iterable[str]) -> str:
    return f"<tr>{''.join(f'<{tag}>{html.escape(cell)}</{tag}>' for cell in cells)}</tr>"


def _quantity(key: str) -> QuantityName | Unit:
    return next(name for end, name in _NOTEBOOK_QUANTITIES.items() if key.endswith(end))


def _heading(key: str) -> str:
    unit = SI.unit(_quantity(key))
    return f"{key.rpartition('_')[0]}, {unit}".replace("_", " ") if unit else key.replace("_", " ")


def _cell(row: Mapping[str, Any], key: str) -> str:
    value = row.get(key)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        low, high = (row.get(f"modulus_interval_{end}_pa") or math.nan for end in ("low", "high"))
        fact = Fact(_quantity(key), value, (low, high) if key == "modulus_pa" else None)
        return "" if math.isnan(value) else SI.show(fact, with_unit=False)
    return "" if value is None else one_line(value)


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
        hint = f"{how_to_install('dataframe')}, or use to_dict()"
        raise OptionError(refusal(f"{method}()", f"the package {package}", "none", hint)) from err


def axes_or_new(ax: Axes | None) -> Axes:
    """Return the given axes; for None, those of a new figure.

    Raises
    ------
    OptionError
        If `ax` is no axes object.
    """
    if ax is None:
        from pfwd.matplotlib_start import start_matplotlib

        start_matplotlib()
        from matplotlib import pyplot

        return pyplot.subplots(layout="constrained")[1]
    if not hasattr(ax, "plot"):
        expected = "axes of matplotlib, or nothing for a new figure"
        raise OptionError(refusal("ax", expected, type(ax).__name__))
    return ax


def draw_values(
    ax: Axes,
    values: Mapping[int, tuple[float, tuple[float, float] | None]],
    factor: float,
    **style: Any,
) -> None:
    """Draw values with their intervals, by their places on the axis, multiplied by a factor."""
    ends = [(value, interval or (value, value)) for value, interval in values.values()]
    below = [factor * (value - low) for value, (low, _) in ends]
    above = [factor * (high - value) for value, (_, high) in ends]
    ax.errorbar(list(values), [factor * v for v, _ in ends], [below, above], capsize=3, **style)


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
        ax.set_xticks(range(len(x)), map(one_line, x), rotation=30, ha="right", parse_math=False)
    ax.set_ylabel(y)
    ax.set_title(title, fontsize="small", parse_math=False, wrap=True)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize="small")
    return ax


def draw_fit(ax: Axes, history: TimeHistories, title: str = "") -> Axes:
    """Draw measured and fitted displacements, in µm over ms, and return the axes.

    The fit without effects is grey, if the other one is that of a diagnosis.

    Parameters
    ----------
    ax : Axes of matplotlib
    history : TimeHistories
    title : str, optional
    """
    time = 1e3 * history.time
    for row, offset in enumerate(history.offsets.tolist()):
        colour, observed = COLOURS[row % len(COLOURS)], 1e6 * history.observed[row]
        label = f"measured, {offset:g} m"
        ax.plot(time, observed, ".", markersize=6, alpha=0.4, c=colour, label=label)
        if history.before is not None:
            label = f"before, {offset:g} m"
            ax.plot(time, 1e6 * history.before[row], c=BEFORE_COLOUR, label=label, zorder=1.5)
        ax.plot(time, 1e6 * history.predicted[row], c=colour, label=f"fitted, {offset:g} m")
    return label_axes(ax, TIME_LABEL, DISPLACEMENT_LABEL, title)


def draw_residual(ax: Axes, all_curves: Sequence[DropCurves], title: str) -> Axes:
    """Draw the residuals of all drops and sensors before and after, and return the axes.

    Residuals are in % of the peak over ms.

    Parameters
    ----------
    ax : Axes of matplotlib
    all_curves : sequence of DropCurves
    title : str
    """
    for curves in all_curves:
        for row, observed in enumerate(curves.observed):
            is_first = row == 0 and curves is all_curves[0]
            for fitted, colour, label in (
                (curves.before[row], BEFORE_COLOUR, "base model"),
                (curves.after[row], AFTER_COLOUR, "with all effects"),
            ):
                residual = 100 * (fitted - observed) / abs(observed).max()
                name = label if is_first else None
                ax.plot(1e3 * curves.time, residual, color=colour, lw=0.9, label=name)
        ax.axvline(curves.contact_end * 1e3, color="0.7", lw=0.7)
    x = "time, ms; the grey line ends the contact"
    return label_axes(ax, x, "fitted - measured, % of the peak", title)
