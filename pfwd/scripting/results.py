"""Results of inversions: modulus with its uncertainty, assumptions and warnings."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Self, overload

import numpy as np

from inversion.notices import Notice
from pfwd.analysis.results import DropResult
from pfwd.digits import modulus_text
from pfwd.errors import SurveyError, refusal
from pfwd.export.json_text import without_nan
from pfwd.scripting.display import (
    ScriptObject,
    axes_or_new,
    count,
    data_frame,
    flatten,
    html_table,
    megapascal,
    text_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame


class Result(DropResult, ScriptObject):
    """Properties of the ground under one drop, or the reason why the drop has none.

    Each key of ``pfwd invert --json`` is an attribute, with its SI unit: ``result.viscosity_pa_s``.
    The most used ones have a second name without the unit: ``result.viscosity``. ``result.history``
    has measured and fitted traces; it is None for a rejected drop and for a stored result.
    """

    __slots__ = ()

    @classmethod
    def of(cls, record: DropResult, **changes: Any) -> Self:
        """Return a result for scripts from that of an analysis, with some fields replaced."""
        values = {field.name: getattr(record, field.name) for field in fields(record)}
        return cls(**values | changes)

    @property
    def number(self) -> int | None:
        """Number of the drop within its point, also as ``drop``."""
        return self.drop

    @property
    def modulus(self) -> float | None:
        """Young's modulus of the ground, Pa, also as ``modulus_pa``; None: no modulus."""
        return self.modulus_pa

    @property
    def modulus_interval(self) -> tuple[float, float] | None:
        """95 % interval of the modulus, Pa, also as ``modulus_interval_pa``; None: no modulus."""
        return self.modulus_interval_pa

    @property
    def viscosity(self) -> float | None:
        """Viscosity of the ground, Pa s, also as ``viscosity_pa_s``; None: not in the model."""
        return self.viscosity_pa_s

    @property
    def density(self) -> float | None:
        """Density of the ground, kg/m3, also as ``density_kg_m3``; None: no modulus."""
        return self.density_kg_m3

    @property
    def bedrock_depth(self) -> float | None:
        """Depth of the bedrock, m, also as ``bedrock_depth_m``; None: not in the model."""
        return self.bedrock_depth_m

    @property
    def plate_radius(self) -> float | None:
        """Radius of the plate, m, also as ``plate_radius_m``; None: no modulus."""
        return self.plate_radius_m

    def __getitem__(self, key: str) -> Any:
        record = self.to_dict()
        if key not in record:
            raise KeyError(f"expected one of {', '.join(record)}, got {key!r}")
        return record[key]

    def __repr__(self) -> str:
        return f"Result({self._name()}: {self._line()})"

    def __str__(self) -> str:
        return "\n".join([repr(self), *_warning_lines(self.warnings or ())])

    def _repr_html_(self) -> str:
        return html_table(repr(self), _RESULT_TABLE_COLUMNS, [_row(self)])

    def _name(self) -> str:
        where = "" if self.point is None else f" of {text_of(self.point)}"
        return f"drop {self.number}{where}"

    def _line(self) -> str:
        if self.modulus is None:
            return f"{self.status}, {text_of(self.reason or 'no modulus')}"
        return f"E {_with_interval(self)}; {_conditions(self)}; {_warning_count([self])}"

    def to_dict(self) -> dict[str, Any]:
        """Return all values of the result, with the keys of ``pfwd invert --json``."""
        record: dict[str, Any] = without_nan(self.to_json())
        return record

    def to_dataframe(self) -> DataFrame:
        """Return a table of one row with all values; needs pandas."""
        return data_frame([flatten(self.to_dict())])

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the measured and the fitted displacement, in µm over ms.

        For a stored result, which has no traces, the modulus is drawn with its 95 % interval, in
        MPa.

        Parameters
        ----------
        ax : Axes of matplotlib, optional
            None: a new figure is made.

        Returns
        -------
        Axes

        Raises
        ------
        SurveyError
            If the result has neither traces nor a modulus with its interval.
        """
        history = self.history
        if history is None and self.modulus is not None and self.modulus_interval is not None:
            return Results([self]).plot(ax)
        if history is None:
            hint = self.reason or "make a new one with pfwd.invert"
            expected = "a result with traces to draw"
            raise SurveyError(refusal(f"drop {self.number}", expected, "one without", hint))
        ax = axes_or_new(ax)
        time = 1e3 * history.time
        for row, offset in enumerate(history.offsets.tolist()):
            (dots,) = ax.plot(
                time,
                1e6 * history.observed[row],
                ".",
                markersize=6,
                alpha=0.4,
                label=f"measured, {offset:g} m",
            )
            label = f"fitted, {offset:g} m"
            ax.plot(time, 1e6 * history.predicted[row], color=dots.get_color(), label=label)
        ax.set_xlabel("time after the trigger, ms")
        ax.set_ylabel("displacement, µm, downward positive")
        ax.set_title(
            f"{self._name()}\n{self._line()}", fontsize="small", parse_math=False, wrap=True
        )
        ax.legend()
        return ax


class Results(ScriptObject, Sequence[Result]):
    """Results of several drops, in the order of the drops."""

    __slots__ = ("_results",)

    def __init__(self, results: Sequence[Result]) -> None:
        self._results = tuple(results)

    @property
    def measured(self) -> Results:
        """Results with a modulus of drops that are neither seating nor rejected."""
        return Results([drop for drop in self if drop.status == "measured" and drop.modulus])

    @property
    def warnings(self) -> tuple[Notice, ...]:
        """Warnings of all drops, equal ones once."""
        return tuple(dict.fromkeys(text for drop in self for text in drop.warnings or ()))

    def __len__(self) -> int:
        return len(self._results)

    def __iter__(self) -> Iterator[Result]:
        return iter(self._results)

    @overload
    def __getitem__(self, index: int) -> Result: ...
    @overload
    def __getitem__(self, index: slice) -> Results: ...
    def __getitem__(self, index: int | slice) -> Result | Results:
        return Results(self._results[index]) if isinstance(index, slice) else self._results[index]

    def __repr__(self) -> str:
        used = self.measured
        parts = [f"{count(len(self), 'drop')}, {len(used)} measured"]
        if len(used) == 1:
            parts.append(f"E {_with_interval(used[0])}")
        elif used:
            moduli = [drop.modulus or 0.0 for drop in used]
            ends = [end for drop in used for end in drop.modulus_interval or ()]
            parts.append(
                f"E {megapascal(min(moduli))} to {megapascal(max(moduli))} MPa, 95 % intervals "
                f"within {megapascal(min(ends))} to {megapascal(max(ends))} MPa"
            )
        if used:
            parts += ["; ".join(dict.fromkeys(map(_conditions, used))), _warning_count(self)]
        return f"Results({'; '.join(parts)})"

    def __str__(self) -> str:
        return "\n".join([*map(repr, self), *_warning_lines(self.warnings)])

    def _repr_html_(self) -> str:
        return html_table(repr(self), _RESULT_TABLE_COLUMNS, list(map(_row, self)))

    def to_dict(self) -> dict[str, Any]:
        """Return a dict with the key ``results``: one record of ``pfwd invert --json`` for each
        drop.
        """
        return {"results": [drop.to_dict() for drop in self]}

    def to_dataframe(self) -> DataFrame:
        """Return a table with a row for each drop, columns as in ``pfwd invert --json``; needs
        pandas.
        """
        return data_frame(flatten(drop.to_dict()) for drop in self)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the moduli of the drops with their 95 % intervals, in MPa.

        Parameters
        ----------
        ax : Axes of matplotlib, optional
            None: a new figure is made.

        Returns
        -------
        Axes
        """
        ax = axes_or_new(ax)
        drawn = [drop for drop in self if drop.modulus is not None and drop.modulus_interval]
        for status, marker in (("measured", "o"), ("seating", "x")):
            places = [i for i, drop in enumerate(drawn) if drop.status == status]
            if not places:
                continue
            values = np.array([drawn[i].modulus for i in places], dtype=float)
            ends = np.array([drawn[i].modulus_interval for i in places], dtype=float)
            reach = np.abs(ends - values[:, None]).T / 1e6
            ax.errorbar(places, values / 1e6, reach, fmt=marker, capsize=3, label=status)
        names = [text_of(f"{_place(drop)}, {drop.number}") for drop in drawn]
        ax.set_xticks(range(len(drawn)), names, rotation=30, ha="right", parse_math=False)
        ax.set_ylabel("modulus E with its 95 % interval, MPa")
        conditions = "; ".join(dict.fromkeys(map(_conditions, drawn)))
        title = f"{conditions}; {_warning_count(drawn)}" if drawn else "no modulus"
        ax.set_title(title, fontsize="small", parse_math=False, wrap=True)
        if drawn:
            ax.legend()
        return ax


_RESULT_TABLE_COLUMNS = (
    "point",
    "drop",
    "status",
    "E, MPa",
    "95 %, MPa",
    "model",
    "plate",
    "plate radius, m",
    "Poisson's ratio",
    "warnings",
)


def _row(result: Result) -> tuple[object, ...]:
    name = (_place(result), result.number, result.status)
    warnings = result.warnings or ()
    if result.modulus is None or result.modulus_interval is None:
        remarks = [text for text in (result.reason, *warnings) if text]
        return (*name, *[""] * 6, "; ".join(remarks))
    low, high = result.modulus_interval
    return (
        *name,
        megapascal(result.modulus),
        f"{megapascal(low)} to {megapascal(high)}",
        _model(result),
        result.plate,
        f"{result.plate_radius:g}",
        f"{result.poisson_ratio:g}",
        "; ".join(warnings) or "none",
    )


def _place(result: Result) -> str:
    """Return the name of the point of a drop; if none is declared, the name of its file."""
    return str(result.point or os.path.basename(result.file or ""))


def _with_interval(result: Result) -> str:
    if result.modulus is None:
        return "none"
    text = modulus_text(result.modulus, result.modulus_interval)
    if result.modulus_interval is None and result.modulus_sd_pa is not None:
        return f"{text}, sd {megapascal(result.modulus_sd_pa)} MPa"
    return text


def _model(result: Result) -> str:
    depth = result.bedrock_depth
    return str(result.model) if depth is None else f"{result.model} {depth:.3g} m deep"


def _conditions(result: Result) -> str:
    """Return the assumptions of a modulus as text: model, plate, its radius, Poisson's ratio."""
    return (
        f"{_model(result)}, {result.plate} plate of radius {result.plate_radius:g} m, "
        f"Poisson's ratio {result.poisson_ratio:g}"
    )


def _warning_lines(warnings: Sequence[str]) -> list[str]:
    return [f"  warning: {text_of(text)}" for text in warnings]


def _warning_count(results: Sequence[Result]) -> str:
    warnings = {text for result in results for text in result.warnings or ()}
    return count(len(warnings), "warning") if warnings else "no warnings"
