"""Survey with its points, drops and stored results, and the examples that ship with the package."""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, overload

import numpy as np

from inversion.records import Interval, without_nan
from pfwd import display
from pfwd.analysis.results import DropResult
from pfwd.errors import OptionError, quote, refusal
from pfwd.export.rows import Order, Row, point_rows
from pfwd.files.opening import survey_content
from pfwd.procedures import Verdict
from pfwd.scripting.measured import MeasuredDrop, Points, read
from pfwd.scripting.results import Results, library

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

    from inversion.result import TimeHistories
    from pfwd_device import recording

Traces = Literal["half-space", "layer", "three-sensors", "unexplained"]
SURVEY: Literal["survey"] = "survey"
DATA_FOLDER = Path(__file__).resolve().parent / "data"


class StoredSurvey(display.Displayable):
    """Survey as it was when `open` read it."""

    def __init__(self, content: recording.Survey) -> None:
        self._content, self._order = content, Order(content)

    path: str = display.alias("_content.path")
    """Path of the survey's folder, or of the file with the survey."""
    file: str = display.alias("_content.path")
    """The same as `path`; points and drops have this attribute as well."""
    damage: tuple[str, ...] = display.alias("_content.damage")
    """Descriptions of lost data; empty: the survey is intact."""

    @cached_property
    def points(self) -> Points:
        """Points with their drops; discarded ones are omitted. `survey.points["name"]` is one.

        Raises
        ------
        SurveyError
            If the survey has no points.
        """
        return read(self.path)

    @property
    def drops(self) -> tuple[MeasuredDrop, ...]:
        """Drops of all points; discarded ones are omitted."""
        return self.points.drops

    @cached_property
    def results(self) -> Results:
        """Last stored result of each drop that has one, without traces."""
        return Results(self._results())

    def _results(self) -> Iterator[DropResult]:
        """Yield the stored results of drops that have one and are not discarded.

        A modulus without its uncertainty or assumptions is left out, as in exports, with a warning.
        """
        for row in self._order.rows:
            record, modulus = row.drop.last_result, row.values["modulus_pa"]
            if record is None or not row.used:
                continue
            in_force = modulus is not None and row.drop.result == record
            changes = {
                "file": self.path,
                "point": row.point.title,
                "drop": row.drop.number,
                "modulus_pa": modulus,
                "warnings": row.warnings,
                "in_force": in_force,
                "read_history": functools.partial(self._history, row) if in_force else None,
            }
            yield replace(record, **changes)

    def _history(self, row: Row) -> TimeHistories | None:
        """Return the traces of a stored drop, with the fit whose modulus is in force."""
        from pfwd.analysis.fits import curves_of
        from pfwd.analysis.screening.bad_sensors import leave_out_bad_sensors
        from pfwd.analysis.screening.drops import screen_point

        drop, result = row.drop, row.drop.result
        stored = (
            (drop_._point, drop_._index)
            for drop_ in self.drops
            if drop_._point.survey_drops[drop_._index].number == drop.record
        )
        point, index = next(stored, (None, 0))
        if point is None or result is None:
            return None
        screening = leave_out_bad_sensors(point, screen_point(point))[index]
        curves = curves_of(point.drops[index], point.setup, screening, result, library())
        diagnosis = None if drop.has_layers else row.point.counting_diagnosis
        if curves is None or diagnosis is None:
            return curves
        fit = diagnosis.fit_of(drop.number)
        return curves if fit is None else fit.drawn_on(curves)

    def __repr__(self) -> str:
        name = display.one_line(os.path.basename(os.path.normpath(self.path)))
        content, count = self._content, display.count
        points, drops = count(len(content.points), "point"), count(len(content.drops), "drop")
        stored = sum(row.drop.last_result is not None for row in self._order.rows)
        damage = f", {count(len(self.damage), 'damage')}" if self.damage else ""
        return f"Survey({name}: {points}, {drops}, {stored} with results{damage})"

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """Return a row for each point, as ``pfwd export --format points`` writes it."""
        return point_rows(self._order)

    def to_dict(self) -> dict[str, Any]:
        """Return ``survey`` (path), ``damage``, and ``drops``: the exported values of every drop.

        Discarded drops are included; the keys are the columns of ``pfwd export --format table``.
        """
        rows: list[Any] = without_nan([dict(row.values) for row in self._order.rows])
        return {"survey": self.path, "damage": list(self.damage), "drops": rows}

    def to_dataframe(self) -> DataFrame:
        """Return a table of the drops as ``pfwd export --format table`` writes it; needs pandas."""
        return display.data_frame(row.values for row in self._order.rows)

    def points_dataframe(self) -> DataFrame:
        """Return a table with value, target, verdict and diagnosis of each point; needs pandas.

        The columns are those of ``pfwd export --format points``; discarded points are marked. The
        modulus to use is ``modulus_in_force_pa``; ``use`` and ``use_reason`` state what for.
        """
        return display.data_frame(self.rows())

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
        ax = display.axes_or_new(ax)
        points = [point for point, _ in self._order.points]
        has_values = any(p.progress.value is not None and not p.discarded for p in points)
        label = self._plot_values(ax) if has_values else self._plot_peaks(ax)
        return display.label_axes(ax, [point.shown_name for point in points], label, repr(self))

    def _plot_values(self, ax: Axes) -> str:
        """Draw the values of the points, and return the label of their axis."""
        from pfwd.report.drawing import VERDICT_COLOURS

        quantity = self._order.job.quantity
        unit, size = quantity.display_unit
        scale = 1.0 / size
        targets = []
        groups: dict[tuple[Verdict, bool], dict[int, tuple[float, Interval | None]]] = {}
        for place, (point, _) in enumerate(self._order.points):
            value = None if point.discarded else point.progress.value
            if value is None:
                continue
            group = groups.setdefault((point.progress.verdict, bool(value.not_supported)), {})
            group[place] = value.value, value.interval
            if point.progress.target is not None:
                targets.append((place, scale * point.progress.target))
        for (verdict, is_hollow), values in groups.items():
            face = {"markerfacecolor": "none"} if is_hollow else {}
            label = verdict.word + (", not supported" if is_hollow else "")
            colour = VERDICT_COLOURS[verdict.value]
            display.draw_values(ax, values, scale, fmt="o", color=colour, label=label, **face)
        if targets:
            places, heights = np.transpose(targets)
            ax.hlines(heights, places - 0.4, places + 0.4, "0.4", "dashed", label="target")
        return f"{quantity.words} with its 95 % interval, {unit}"

    def _plot_peaks(self, ax: Axes) -> str:
        """Draw the peaks of the drops, and return the label of their axis."""
        for used, marker, label in ((True, "o", "used"), (False, "x", "discarded")):
            peaks = [
                (place, 1e3 * row.drop.peaks.centre)
                for place, (_, rows) in enumerate(self._order.points)
                for row in rows
                if row.used == used and row.drop.peaks and row.drop.peaks.centre is not None
            ]
            if peaks:
                ax.plot(*zip(*peaks, strict=True), marker, label=label)
        return "peak displacement in the centre, mm"


def open(path: str | os.PathLike[str]) -> StoredSurvey:
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
    return StoredSurvey(survey_content(path))


@overload
def example(name: Traces) -> Points: ...
@overload
def example(name: Literal["survey"]) -> StoredSurvey: ...
def example(name: str) -> Points | StoredSurvey:
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
