"""Moduli with all that belongs to them: uncertainty, model, plate, Poisson's ratio, warnings."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from pfwd.shown import (
    Shown,
    axes_or_new,
    count,
    data_frame,
    flat,
    html_table,
    megapascal,
    text_of,
)
from pfwd_survey.errors import SurveyError, refusal
from pfwd_survey.exporting.json_text import without_nan

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

    from inversion.result import TimeHistories


class Result(Shown):
    """The ground under one drop, or why there is none.

    Its keys are those of ``pfwd invert --json``: ``result["viscosity_pa_s"]``.
    """

    __slots__ = ("_history", "_record")

    def __init__(self, record: Mapping[str, Any], history: TimeHistories | None = None) -> None:
        self._record: dict[str, Any] = without_nan(record)
        self._history = history

    @property
    def file(self) -> str:
        """Where the drop was read from."""
        return str(self._record["file"])

    @property
    def point(self) -> str | None:
        """Name of the test point; None: not declared."""
        return _optional_text(self._record.get("point"))

    @property
    def number(self) -> int:
        """Number of the drop within its point."""
        return int(self._record["drop"])

    @property
    def status(self) -> str:
        """``measured``, ``seating`` or ``rejected``."""
        return str(self._record["status"])

    @property
    def reason(self) -> str | None:
        """Why the drop was rejected; None: it was not."""
        return _optional_text(self._record.get("reason"))

    @property
    def modulus(self) -> float | None:
        """Young's modulus of the ground, Pa; None: rejected."""
        return _optional(self._record["modulus_pa"])

    @property
    def modulus_interval(self) -> tuple[float, float] | None:
        """95 %, Pa, the model's own error included."""
        return _pair(self._record["modulus_interval_pa"])

    @property
    def viscosity(self) -> float | None:
        """Pa s."""
        return _optional(self._record["viscosity_pa_s"])

    @property
    def density(self) -> float | None:
        """kg/m3."""
        return _optional(self._record["density_kg_m3"])

    @property
    def bedrock_depth(self) -> float | None:
        """m; None: not in the model."""
        return _optional(self._record["bedrock_depth_m"])

    @property
    def model(self) -> str | None:
        """``layer`` or ``half-space``."""
        return _optional_text(self._record["model"])

    @property
    def plate(self) -> str | None:
        """Contact of plate and ground in the model."""
        return _optional_text(self._record["plate"])

    @property
    def plate_radius(self) -> float | None:
        """m."""
        return _optional(self._record["plate_radius_m"])

    @property
    def poisson_ratio(self) -> float | None:
        """Of the ground, as declared or assumed."""
        return _optional(self._record["poisson_ratio"])

    @property
    def warnings(self) -> tuple[str, ...]:
        """What should be known before the modulus is believed."""
        return tuple(map(str, self._record["warnings"]))

    @property
    def history(self) -> TimeHistories:
        """Arrays for plots: ``time`` (s), ``load`` (N), ``observed``, ``predicted``, ``residual``
        ((n_sensors, n), m), ``offsets`` (m).

        Raises
        ------
        SurveyError
            If the drop was rejected, or the result was stored, which holds no arrays.
        """
        if self._history is None:
            hint = self.reason or "pfwd.invert makes a new one"
            expected = "a result with its time histories"
            raise SurveyError(refusal(f"drop {self.number}", expected, "one without", hint))
        return self._history

    def __getitem__(self, key: str) -> Any:
        if key not in self._record:
            raise KeyError(f"expected one of {', '.join(self._record)}, came {key!r}")
        return self._record[key]

    def __repr__(self) -> str:
        return f"Result({self._name()}: {self._line()})"

    def __str__(self) -> str:
        return "\n".join([repr(self), *(f"  warning: {text_of(one)}" for one in self.warnings)])

    def _repr_html_(self) -> str:
        return html_table(repr(self), _COLUMNS, [_row(self)])

    def _name(self) -> str:
        where = "" if self.point is None else f" of {text_of(self.point)}"
        return f"drop {self.number}{where}"

    def _line(self) -> str:
        if self.modulus is None:
            return f"{self.status}, {text_of(self.reason or 'no modulus')}"
        return f"E {_with_interval(self)}; {_conditions(self)}; {_warned([self])}"

    def to_dict(self) -> dict[str, Any]:
        """The record of ``pfwd invert --json``."""
        return dict(self._record)

    def to_dataframe(self) -> DataFrame:
        """The record as one row; needs pandas."""
        return data_frame([flat(self._record)])

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the displacement, measured and fitted (µm over ms), and return the axes."""
        history = self.history
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


class Results(Shown, Sequence[Result]):
    """The results of several drops, in their order."""

    __slots__ = ("_results",)

    def __init__(self, results: Sequence[Result]) -> None:
        self._results = tuple(results)

    @property
    def measured(self) -> Results:
        """Those that count: neither seating nor rejected."""
        return Results([one for one in self if one.status == "measured" and one.modulus])

    @property
    def warnings(self) -> tuple[str, ...]:
        """Those of all drops, each once."""
        return tuple(dict.fromkeys(text for one in self for text in one.warnings))

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
            moduli = [one.modulus or 0.0 for one in used]
            ends = [end for one in used for end in one.modulus_interval or ()]
            parts.append(
                f"E {megapascal(min(moduli))} to {megapascal(max(moduli))} MPa, 95 % intervals "
                f"within {megapascal(min(ends))} to {megapascal(max(ends))} MPa"
            )
        if used:
            parts += ["; ".join(dict.fromkeys(map(_conditions, used))), _warned(self)]
        return f"Results({'; '.join(parts)})"

    def __str__(self) -> str:
        lines = [repr(one) for one in self]
        lines += [f"  warning: {text_of(text)}" for text in self.warnings]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return html_table(repr(self), _COLUMNS, [_row(one) for one in self])

    def to_dict(self) -> dict[str, Any]:
        """``results``: one record a drop, as of ``pfwd invert --json``."""
        return {"results": [one.to_dict() for one in self]}

    def to_dataframe(self) -> DataFrame:
        """A row a drop, columns named as the keys of ``pfwd invert --json``; needs pandas."""
        return data_frame(flat(one.to_dict()) for one in self)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the moduli with their 95 % intervals (MPa), and return the axes."""
        ax = axes_or_new(ax)
        shown = [one for one in self if one.modulus is not None and one.modulus_interval]
        for status, marker in (("measured", "o"), ("seating", "x")):
            places = [i for i, one in enumerate(shown) if one.status == status]
            if not places:
                continue
            values = np.array([shown[i].modulus for i in places], dtype=float)
            ends = np.array([shown[i].modulus_interval for i in places], dtype=float)
            reach = np.abs(ends - values[:, None]).T / 1e6
            ax.errorbar(places, values / 1e6, reach, fmt=marker, capsize=3, label=status)
        names = [
            text_of(f"{one.point or os.path.basename(one.file)}, {one.number}") for one in shown
        ]
        ax.set_xticks(range(len(shown)), names, rotation=30, ha="right", parse_math=False)
        ax.set_ylabel("modulus E with its 95 % interval, MPa")
        conditions = "; ".join(dict.fromkeys(map(_conditions, shown)))
        title = f"{conditions}; {_warned(shown)}" if shown else "no modulus"
        ax.set_title(title, fontsize="small", parse_math=False, wrap=True)
        if shown:
            ax.legend()
        return ax


_COLUMNS = (
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


def _row(one: Result) -> tuple[object, ...]:
    name = (one.point or os.path.basename(one.file), one.number, one.status)
    if one.modulus is None or one.modulus_interval is None:
        return (*name, "", "", "", "", "", "", "; ".join(filter(None, [one.reason, *one.warnings])))
    low, high = one.modulus_interval
    return (
        *name,
        megapascal(one.modulus),
        f"{megapascal(low)} to {megapascal(high)}",
        _model(one),
        one.plate,
        f"{one.plate_radius:g}",
        f"{one.poisson_ratio:g}",
        "; ".join(one.warnings) or "none",
    )


def _with_interval(one: Result) -> str:
    if one.modulus is None:
        return "none"
    if one.modulus_interval is None:
        return f"{megapascal(one.modulus)} MPa, sd {megapascal(one['modulus_sd_pa'])} MPa"
    low, high = one.modulus_interval
    return f"{megapascal(one.modulus)} MPa, 95 % {megapascal(low)} to {megapascal(high)} MPa"


def _model(one: Result) -> str:
    depth = one.bedrock_depth
    return str(one.model) if depth is None else f"{one.model} {depth:.3g} m deep"


def _conditions(one: Result) -> str:
    """Model, plate, radius and Poisson's ratio: what a modulus rests on."""
    return (
        f"{_model(one)}, {one.plate} plate of radius {one.plate_radius:g} m, "
        f"Poisson's ratio {one.poisson_ratio:g}"
    )


def _warned(results: Sequence[Result]) -> str:
    warnings = {text for one in results for text in one.warnings}
    return count(len(warnings), "warning") if warnings else "no warnings"


def _optional(value: Any) -> float | None:
    return None if value is None else float(value)


def _optional_text(value: Any) -> str | None:
    return None if value is None else str(value)


def _pair(value: Any) -> tuple[float, float] | None:
    return None if value is None else (float(value[0]), float(value[1]))
