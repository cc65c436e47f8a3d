"""Survey with its points, drops and stored results, and the examples that ship with the package."""

from __future__ import annotations

import os
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, overload

from pfwd.errors import OptionError, quote, refusal
from pfwd.export.json_text import without_nan
from pfwd.export.rows import Order, Row, point_rows
from pfwd.files.opening import survey_content
from pfwd.procedures import unit_of
from pfwd.scripting.display import ScriptObject, axes_or_new, count, data_frame, html_table, text_of
from pfwd.scripting.measured import Drop, Points, read
from pfwd.scripting.results import Result, Results

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

    from pfwd_device import recording

Traces = Literal["half-space", "layer", "three-sensors", "unexplained"]
SURVEY: Literal["survey"] = "survey"
DATA_FOLDER = Path(__file__).resolve().parent / "data"


class Survey(ScriptObject):
    """Survey as it was when `open` read it."""

    def __init__(self, content: recording.Survey) -> None:
        self._content = content

    @property
    def path(self) -> str:
        """Path of the survey's folder, or of the file with the survey."""
        return self._content.path

    @property
    def file(self) -> str:
        """The same as `path`; points and drops have this attribute as well."""
        return self._content.path

    @property
    def damage(self) -> tuple[str, ...]:
        """Descriptions of lost data; empty: the survey is intact."""
        return self._content.damage

    @cached_property
    def points(self) -> Points:
        """Points with their drops; discarded ones are omitted.

        Raises
        ------
        SurveyError
            If the survey has no points.
        """
        return read(self.path)

    @property
    def drops(self) -> tuple[Drop, ...]:
        """Drops of all points; discarded ones are omitted."""
        return self.points.drops

    @cached_property
    def results(self) -> Results:
        """Last stored result of each drop that has one, without traces."""
        stored = (_stored(self.path, row) for row in self._rows)
        return Results([result for result in stored if result is not None])

    @cached_property
    def _order(self) -> Order:
        return Order(self._content)

    @property
    def _rows(self) -> list[Row]:
        return self._order.rows

    def __repr__(self) -> str:
        name = text_of(os.path.basename(os.path.normpath(self.path)))
        drops = len(self._content.drops)
        stored = sum(row.drop.last_result is not None for row in self._rows)
        damage = f", {count(len(self.damage), 'damage')}" if self.damage else ""
        return (
            f"Survey({name}: {count(len(self._content.points), 'point')}, {count(drops, 'drop')}, "
            f"{stored} with results{damage})"
        )

    def _repr_html_(self) -> str:
        rows = [
            (
                point.title,
                len(point.drops),
                "yes" if point.discarded else "",
                "; ".join(point.notes),
            )
            for point in self._content.points
        ]
        return html_table(repr(self), ("point", "drops", "discarded", "notes"), rows)

    def to_dict(self) -> dict[str, Any]:
        """Return ``survey`` (path), ``damage``, and ``drops``: the exported values of every drop.

        Discarded drops are included; the keys are the columns of ``pfwd export --format table``.
        """
        rows: list[Any] = without_nan([dict(row.values) for row in self._rows])
        return {"survey": self.path, "damage": list(self.damage), "drops": rows}

    def to_dataframe(self) -> DataFrame:
        """Return a table of the drops as ``pfwd export --format table`` writes it; needs pandas."""
        return data_frame(
            {
                name: "; ".join(map(str, value)) if isinstance(value, list) else value
                for name, value in row.values.items()
            }
            for row in self._rows
        )

    def points_dataframe(self) -> DataFrame:
        """Return a table with value, target, verdict and diagnosis of each point; needs pandas.

        The columns are those of ``pfwd export --format points``; discarded points are marked. The
        modulus to use is ``modulus_in_force_pa``; ``use`` and ``use_reason`` state what for.
        """
        return data_frame(point_rows(self._order))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the judged value of each point with its 95 % interval.

        Moduli are in MPa and deflections in mm. The colour is the verdict, a line the target; a
        value that the data do not support is hollow. If no point has a value, the peak
        displacements of the drops are drawn, in mm. ``survey.results.plot()`` draws the moduli of
        single drops.

        Parameters
        ----------
        ax : Axes of matplotlib, optional
            None: a new figure is made.

        Returns
        -------
        Axes
        """
        ax = axes_or_new(ax)
        points = [point for point, _ in self._order.points]
        names = [text_of(point.shown_name) for point in points]
        values = [None if point.discarded else point.progress.value for point in points]
        if any(value is not None for value in values):
            self._plot_values(ax)
        else:
            self._plot_peaks(ax)
        ax.set_xticks(range(len(names)), names, rotation=30, ha="right", parse_math=False)
        ax.set_title(repr(self), fontsize="small", parse_math=False)
        if ax.get_legend_handles_labels()[0]:
            ax.legend()
        return ax

    def _plot_values(self, ax: Axes) -> None:
        from pfwd.report.drawing import VERDICT_COLOURS

        quantity = self._order.job.quantity
        unit, scale = ("mm", 1e3) if unit_of(quantity) == "m" else ("MPa", 1e-6)
        labels: set[str] = set()
        for place, (point, _) in enumerate(self._order.points):
            value = None if point.discarded else point.progress.value
            if value is None:
                continue
            low, high = value.interval or (value.value, value.value)
            reach = [[scale * (value.value - low)], [scale * (high - value.value)]]
            label = point.progress.verdict.word
            ax.errorbar(
                [place],
                [scale * value.value],
                reach,
                fmt="o",
                capsize=3,
                color=VERDICT_COLOURS[point.progress.verdict.value],
                markerfacecolor="none" if value.not_supported else None,
                label="_nolegend_" if label in labels else label,
            )
            labels.add(label)
            if point.progress.target is not None:
                target = scale * point.progress.target
                name = "_nolegend_" if "target" in labels else "target"
                ax.hlines(target, place - 0.4, place + 0.4, "0.4", "dashed", label=name)
                labels.add("target")
        ax.set_ylabel(f"{quantity} with its 95 % interval, {unit}")

    def _plot_peaks(self, ax: Axes) -> None:
        for used, marker, label in ((True, "o", "used"), (False, "x", "discarded")):
            peaks = [
                (place, 1e3 * row.drop.peaks.centre)
                for place, (_, rows) in enumerate(self._order.points)
                for row in rows
                if row.used == used
                and row.drop.peaks is not None
                and row.drop.peaks.centre is not None
            ]
            if peaks:
                ax.plot(*zip(*peaks, strict=True), marker, label=label)
        ax.set_ylabel("peak displacement in the centre, mm")


def open(path: str | os.PathLike[str]) -> Survey:
    """Read a survey from its folder or from one file (``.pfwdz``).

    Another program may be writing to it.

    Raises
    ------
    SurveyError
        If the path is no survey, or cannot be read.

    Examples
    --------
    >>> pfwd.open(pfwd.example("survey").path)
    Survey(survey.pfwdz: 4 points, 8 drops, 8 with results)
    """
    if not isinstance(path, str | os.PathLike):
        raise OptionError(refusal("path", "the path of a survey", type(path).__name__))
    return Survey(survey_content(path))


@overload
def example(name: Traces) -> Points: ...
@overload
def example(name: Literal["survey"]) -> Survey: ...
def example(name: str) -> Points | Survey:
    """Return an example that ships with the package, simulated by finite elements with noise.

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
        return open(DATA_FOLDER / f"{name}.pfwdz")
    names = get_args(Traces)
    if name not in names:
        expected = f"one of {', '.join([*names, SURVEY])}"
        raise OptionError(refusal("example", expected, quote(name)))
    return read(DATA_FOLDER / f"{name}.csv")


def _stored(path: str, row: Row) -> Result | None:
    """Return the stored result of a drop; None: it has no result, or is discarded.

    A modulus without its uncertainty or assumptions is left out, as in exports, with a warning.
    """
    record = row.drop.last_result
    if record is None or not row.used:
        return None
    changes = {
        "file": path,
        "point": row.point.title,
        "drop": row.drop.number,
        "modulus_pa": row.values["modulus_pa"],
        "warnings": row.warnings,
    }
    # `more` holds unreadable values, which must not replace those of `changes`.
    more = {key: value for key, value in record.more.items() if key not in changes}
    return Result.of(record, more=more, **changes)
