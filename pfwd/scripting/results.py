"""Function `pfwd.invert`, and its results: modulus with uncertainty, assumptions, warnings."""

from __future__ import annotations

import functools
import os
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, overload

from numpy.typing import ArrayLike

from inversion.notices import Notice, text_of
from pfwd import display
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DropResult as Result
from pfwd.errors import OptionError, refusal
from pfwd.scripting.measured import Data, MeasuredDrop, MeasuredPoint, points_of, requested
from pfwd.scripting.options import INVERT_OPTIONS, Header

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from inversion import SurrogateLibrary
    from pfwd.analysis.results import DropAnalysis
    from pfwd.files.traces import TracePoint


class Results(display.DisplayableList[Result]):
    """Results of several drops, in the order of the drops."""

    KEY = "results"

    @property
    def measured(self) -> Results:
        """Results with a modulus of drops that are neither seating nor rejected."""
        return Results(drop for drop in self if drop.status == "measured" and drop.modulus)

    @property
    def warnings(self) -> tuple[Notice, ...]:
        """Warnings of all drops, equal ones once."""
        return tuple(
            {text_of(warning): warning for drop in self for warning in drop.warnings}.values()
        )

    def __repr__(self) -> str:
        used = self.measured
        parts = [f"{display.count(len(self), 'drop')}, {len(used)} measured"]
        if len(used) == 1:
            parts.append(f"E {used[0].modulus_words}")
        elif used:
            moduli = [drop.modulus or 0.0 for drop in used]
            ends = [end for drop in used for end in drop.modulus_interval or ()]
            parts.append(f"E {_range(moduli)} MPa, 95 % intervals within {_range(ends)} MPa")
        if used:
            parts += [*self._assumptions(), display.warning_count(self.warnings)]
        return f"Results({'; '.join(parts)})"

    def _assumptions(self) -> list[str]:
        """Return the assumptions of the moduli, equal ones once."""
        return list(dict.fromkeys(r.assumptions for r in self if r.modulus is not None))

    def __str__(self) -> str:
        warnings = [f"  warning: {display.one_line(text_of(item))}" for item in self.warnings]
        return "\n".join([*map(repr, self), *warnings])

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
        ax = display.axes_or_new(ax)
        drawn = Results(drop for drop in self if drop.modulus is not None and drop.modulus_interval)
        for status, marker in (("measured", "o"), ("seating", "x")):
            values = {
                place: (drop.modulus_pa or 0.0, drop.modulus_interval_pa)
                for place, drop in enumerate(drawn)
                if drop.status == status
            }
            if values:
                display.draw_values(ax, values, 1e-6, fmt=marker, label=status)
        places = (drop.point or os.path.basename(drop.file) for drop in drawn)
        names = [f"{place}, {drop.drop}" for place, drop in zip(places, drawn, strict=True)]
        stated = [*drawn._assumptions(), display.warning_count(drawn.warnings)]
        title = "; ".join(stated) if drawn else "no modulus"
        return display.label_axes(ax, names, "modulus E with its 95 % interval, MPa", title)


def _range(values: Sequence[float]) -> str:
    return f"{min(values) / 1e6:.4g} to {max(values) / 1e6:.4g}"


@overload
def invert(data: MeasuredDrop, /, **options: Any) -> Result: ...
@overload
def invert(time: ArrayLike, load: ArrayLike, values: Any, /, **options: Any) -> Result: ...
@overload
def invert(data: Data, /, **options: Any) -> Results: ...
def invert(data: Any, /, *arrays: Any, **options: Any) -> Result | Results:
    """Return the modulus of the ground under drops, with its uncertainty and assumptions.

    ``invert(drop)`` and ``invert(time, load, values, plate_radius=0.15)`` return one `Result`;
    a path, a survey, points, a point or several drops return `Results`, one for each drop.

    Parameters
    ----------
    data : a drop, a point, points, a survey, several of these, or a path; or ``time, load, values``
        with ``quantity`` and ``offsets`` as for `pfwd.drop`

    Other Parameters
    ----------------
    header : path of a TOML file, or its keys as a dict
        Overrides the declarations of the file; with a path only.
    model : "layer" or "half-space"; default: the layer, unless the depth excludes it
    bedrock_depth : depth of the rigid base, m, or "unknown" or "none"; default: as declared
    layers : number of media with a modulus, the lowest included, 1 to 4, or "auto"; default: 1
    thickness : of all media but the lowest, m, from the top, or "unknown"; default: fitted
    elastic : True: no viscosity
    load : "measured" or "half-sine"
    plate : "rigid-rough", "rigid-smooth", "published" or "uniform" (equal pressure)
    sensors : "all" or "centre"
    joint : True: one set of ground properties for all measured drops of a point
    method : "mpga" (a genetic search adds a starting point) or "posterior" (local fits alone)
    published : True: the published method in all its parts
    priors : False: no prior on the ground if the record does not determine the depth of rock
    seed : int, random seed of the search
    plate_radius, plate_mass, poisson_ratio, density : declared values, m, kg, -, kg/m3
        Override the declarations of the file.

    Returns
    -------
    Result or Results
        A rebound, or a drop with a dead sensor, has the status ``rejected`` and a reason.

    Raises
    ------
    SurveyError
        If a file is refused, the arrays do not fit together, or an option is unknown or wrong.

    Examples
    --------
    >>> pfwd.invert(pfwd.example("half-space"))
    Results(1 drop, 1 measured; E 60... MPa (57... to 63...); half-space, ...; no warnings)
    """
    data, settings, header = requested(INVERT_OPTIONS, data, arrays, options)
    results = _results(data, settings, header)
    return results[0] if isinstance(data, MeasuredDrop) else Results(results)


def _results(data: Any, options: AnalysisOptions, header: Header) -> list[Result]:
    from pfwd.analysis.analyse import analyse_drop, analyse_point
    from pfwd.analysis.screening.bad_sensors import leave_out_bad_sensors
    from pfwd.analysis.screening.drops import screen_point

    if isinstance(data, MeasuredDrop):
        if options.joint:
            hint = "give the point, or leave joint out"
            raise OptionError(refusal("joint", "several drops of a point", "one drop", hint))
        # Screened with all drops of its point, because a rebound is recognised by comparison.
        all_drops = data._point
        screening = leave_out_bad_sensors(all_drops, screen_point(all_drops))[data._index]
        (point,) = points_of(data, header, options.overrides())
        analysis = analyse_drop(point.drops[0], point.setup, screening, options, library())
        return [_result(point, 0, analysis)]
    several = isinstance(data, list | tuple) and not isinstance(data, MeasuredPoint)
    if several and data and not options.joint:
        return [result for item in data for result in _results(item, options, header)]
    return [
        _result(point, index, analysis)
        for point in points_of(data, header, options.overrides())
        for index, analysis in enumerate(analyse_point(point, options, library()))
    ]


def _result(point: TracePoint, index: int, analysis: DropAnalysis) -> Result:
    from pfwd.analysis.drop_result import drop_result
    from pfwd.analysis.result_store import counts

    result = drop_result(point.file, analysis, point.warnings, point.setup.point)
    stored = point.survey_drops[index] if point.survey_drops else None
    in_force = result.modulus_pa is not None and counts(stored, result)
    return replace(result, in_force=in_force)


@functools.cache
def library() -> SurrogateLibrary:
    """Return the response tables of the model, which are read once and shared by all calls."""
    from inversion import SurrogateLibrary

    return SurrogateLibrary()
