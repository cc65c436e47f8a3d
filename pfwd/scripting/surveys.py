"""A survey: points, drops, and the results that it holds."""

from __future__ import annotations

import os
from functools import cached_property
from typing import TYPE_CHECKING, Any

from pfwd.errors import OptionError, refusal
from pfwd.export.json_text import without_nan
from pfwd.export.point_rows import point_rows
from pfwd.export.rows import Order, Row
from pfwd.files.reading import survey_content
from pfwd.scripting.measured import Drop, Points, read
from pfwd.scripting.results import Result, Results
from pfwd.scripting.shown import Shown, axes_or_new, count, data_frame, html_table, text_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

    from pfwd_device.recording.survey_content import SurveyContent


class Survey(Shown):
    """A survey as it was when it was opened; made by `open`."""

    def __init__(self, content: SurveyContent) -> None:
        self._content = content

    @property
    def path(self) -> str:
        """Its folder, or the file it was exported to."""
        return self._content.path

    @property
    def file(self) -> str:
        """The same as `path`, as points and drops call it."""
        return self._content.path

    @property
    def damage(self) -> tuple[str, ...]:
        """What is lost, a short text each."""
        return self._content.damage

    @cached_property
    def points(self) -> Points:
        """Its points with their drops; discarded ones are left out.

        Raises
        ------
        SurveyError
            If there are none.
        """
        return read(self.path)

    @property
    def drops(self) -> tuple[Drop, ...]:
        """Those of all points; discarded ones are left out."""
        return self.points.drops

    @cached_property
    def results(self) -> Results:
        """The results that the survey holds, of each drop the last one; without time histories."""
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
        lost = f", {count(len(self.damage), 'damage')}" if self.damage else ""
        return (
            f"Survey({name}: {count(len(self._content.points), 'point')}, {count(drops, 'drop')}, "
            f"{stored} with results{lost})"
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
        """``path`` and a row a drop, discarded ones with them, as ``pfwd export`` has it."""
        rows: list[Any] = without_nan([dict(row.values) for row in self._rows])
        return {"survey": self.path, "damage": list(self.damage), "drops": rows}

    def to_dataframe(self) -> DataFrame:
        """A row a drop as in ``pfwd export --format table``; needs pandas."""
        return data_frame(
            {
                name: "; ".join(map(str, value)) if isinstance(value, list) else value
                for name, value in row.values.items()
            }
            for row in self._rows
        )

    def points_dataframe(self) -> DataFrame:
        """Return a row a point with value, target, verdict and diagnosis; needs pandas.

        The columns are those of ``pfwd export --format points``; discarded points are marked.
        """
        return data_frame(point_rows(self._order))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the peak displacement of every drop, point by point (µm), and return the axes.

        The moduli are drawn by ``survey.results.plot()``.
        """
        ax = axes_or_new(ax)
        names = [text_of(point.title) for point in self._content.points]
        place = {point.name: index for index, point in enumerate(self._content.points)}
        shown = [
            (place[row.point.name], row.drop.peaks.centre, not row.used)
            for row in self._rows
            if row.drop.peaks is not None and row.drop.peaks.centre is not None
        ]
        for discarded, marker in ((False, "o"), (True, "x")):
            part = [(at, 1e6 * peak) for at, peak, gone in shown if gone == discarded]
            if part:
                label = "discarded" if discarded else "used"
                ax.plot(*zip(*part, strict=True), marker, label=label)
        ax.set_xticks(range(len(names)), names, rotation=30, ha="right", parse_math=False)
        ax.set_ylabel("peak displacement in the centre, µm")
        ax.set_title(repr(self), fontsize="small", parse_math=False)
        if shown:
            ax.legend()
        return ax


def open(path: str | os.PathLike[str]) -> Survey:
    """A survey, in its folder or exported as h5; it may be written meanwhile.

    Raises
    ------
    SurveyError
        If it is no survey, or cannot be read.

    Examples
    --------
    >>> pfwd.open(pfwd.example("survey").path)
    Survey(survey.h5: 4 points, 8 drops, 8 with results)
    """
    if not isinstance(path, str | os.PathLike):
        raise OptionError(refusal("path", "the path of a survey", type(path).__name__))
    return Survey(survey_content(path))


def _stored(path: str, row: Row) -> Result | None:
    """Return the stored result of a used drop, under the names that the survey has now.

    Its modulus is withheld where the export withholds it, with a warning that says why.
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
    # Values that could not be read do not come back in place of these.
    more = {key: value for key, value in record.more.items() if key not in changes}
    return Result.of(record, more=more, **changes)
