"""Function `pfwd.invert`, which returns the modulus of the ground under drops."""

from __future__ import annotations

import functools
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, Unpack, overload

from numpy.typing import ArrayLike

from pfwd.analysis.options import AnalysisOptions
from pfwd.errors import OptionError, quote, refusal
from pfwd.scripting.measured import EXPECTED_DATA, Drop, Point, drop, points_of
from pfwd.scripting.options import INVERT_OPTIONS, InvertOptions, analysis_options
from pfwd.scripting.results import Result, Results

if TYPE_CHECKING:
    from inversion import SurrogateLibrary
    from pfwd.analysis.results import DropAnalysis
    from pfwd.files.traces import TracePoint
    from pfwd.scripting.measured import Points
    from pfwd.scripting.surveys import Survey

Header = str | os.PathLike[str] | Mapping[str, object] | None


@overload
def invert(data: Drop, /, *, header: Header = None, **options: Unpack[InvertOptions]) -> Result: ...
@overload
def invert(
    data: str | os.PathLike[str] | Survey | Points | Point | Sequence[Drop | Point],
    /,
    *,
    header: Header = None,
    **options: Unpack[InvertOptions],
) -> Results: ...
@overload
def invert(
    time: ArrayLike,
    load: ArrayLike,
    values: ArrayLike,
    /,
    *,
    quantity: Literal["displacement", "velocity"] = "displacement",
    offsets: float | Sequence[float] | None = None,
    **options: Unpack[InvertOptions],
) -> Result: ...
def invert(
    data: Any,
    /,
    *arrays: Any,
    quantity: Literal["displacement", "velocity"] = "displacement",
    offsets: float | Sequence[float] | None = None,
    header: Header = None,
    **options: Any,
) -> Result | Results:
    """Return the modulus of the ground under drops, with its uncertainty and assumptions.

    ``invert(drop)`` and ``invert(time, load, values, plate_radius=0.15)`` return one `Result`;
    a path, a survey, points, a point or several drops return `Results`, one for each drop.

    Parameters
    ----------
    data : a drop, a point, points, a survey, several of these, or a path; or ``time, load, values``
        with ``quantity`` and ``offsets`` as for `pfwd.drop`
    header : path of a TOML file, or its keys as a dict, optional
        Overrides the declarations of the file; with a path only.

    Other Parameters
    ----------------
    model : "layer" or "half-space"; default: the layer, unless the depth excludes it
    bedrock_depth : depth of the rigid base, m, or "unknown" or "none"; default: as declared
    layers : number of media with a modulus, the lowest included, 1 to 4, or "auto"; default: 1
    thickness : of all media but the lowest, m, from the top, or "unknown"; default: fitted
    elastic : True: no viscosity
    load : "measured" or "half-sine"
    plate : "rigid-rough", "rigid-smooth", "published" or "uniform" (equal pressure)
    sensors : "all" or "centre"
    joint : True: one set of ground properties for all measured drops of a point
    method : "mpga" (genetic search and polish) or "least-squares" (several starts)
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
    Results(1 drop, 1 measured; E 60... MPa (59... to 60...); half-space, ...; no warnings)
    """
    settings = analysis_options(INVERT_OPTIONS, options)
    if arrays or is_array(data):
        data = drop_of_arrays(data, arrays, quantity, offsets, settings, header)
    elif offsets is not None or quantity != "displacement":
        name = "offsets" if offsets is not None else "quantity"
        raise OptionError(refusal(name, "none unless arrays are given", "one"))
    if isinstance(data, Drop):
        return _invert_drop(data, settings, header)
    if settings.joint or not isinstance(data, list | tuple) or not data:
        points = points_of(data, header, settings.overrides())
        return Results([result for point in points for result in _invert_point(point, settings)])
    results: list[Result] = []
    for item in data:
        if isinstance(item, list | tuple | int | float):
            raise OptionError(refusal("data", EXPECTED_DATA, quote(item)))
        of_item = invert(item, header=header, **options)
        results += [of_item] if isinstance(of_item, Result) else of_item
    return Results(results)


def drop_of_arrays(
    time: Any,
    arrays: tuple[Any, ...],
    quantity: Literal["displacement", "velocity"],
    offsets: float | Sequence[float] | None,
    options: AnalysisOptions,
    header: Header,
) -> Drop:
    """Return the drop that the arrays ``time, load, values`` and the declarations in the options
    describe.

    Parameters
    ----------
    time : array
    arrays : tuple
        The arrays ``load`` and ``values``.
    quantity, offsets : as for `pfwd.drop`
    options : AnalysisOptions
        With the plate radius.
    header : must be None, because arrays have no file

    Raises
    ------
    SurveyError
        If an array or the plate radius is missing, or the arrays do not fit together.
    """
    if len(arrays) != 2:
        count = f"{1 + len(arrays)}"
        raise OptionError(refusal("arrays", "three: time, load, values", count))
    if header is not None:
        raise OptionError(refusal("header", "none for arrays", "one", "give plate_radius=..."))
    if options.plate_radius is None:
        raise OptionError(refusal("plate_radius", "a number > 0, in m", "none"))
    return drop(
        time,
        *arrays,
        quantity=quantity,
        offsets=offsets,
        plate_radius=options.plate_radius,
        plate_mass=options.plate_mass,
        poisson_ratio=options.poisson_ratio,
        density=options.density,
    )


def is_array(data: object) -> bool:
    """Return whether an object is an array or a list of numbers, and thus the first of three
    arrays.
    """
    if hasattr(data, "__array__"):
        return True
    return isinstance(data, list | tuple) and bool(data) and isinstance(data[0], int | float)


def _invert_drop(chosen: Drop, options: AnalysisOptions, header: Header) -> Result:
    from pfwd.analysis.analyse import analyse_drop
    from pfwd.analysis.screening.bad_sensors import leave_out_bad_sensors
    from pfwd.analysis.screening.drops import screen_point

    if options.joint:
        hint = "give the point, or leave joint out"
        raise OptionError(refusal("joint", "several drops of a point", "one drop", hint))
    # Screened with all drops of its point, because a rebound is recognised by comparison.
    all_drops = chosen._point
    screening = leave_out_bad_sensors(all_drops, screen_point(all_drops))[chosen._index]
    (point,) = points_of(chosen, header, options.overrides())
    analysis = analyse_drop(point.drops[0], point.setup, screening, options, library())
    return _result(point, analysis)


def _invert_point(point: TracePoint, options: AnalysisOptions) -> list[Result]:
    from pfwd.analysis.analyse import analyse_point

    return [_result(point, analysis) for analysis in analyse_point(point, options, library())]


def _result(point: TracePoint, analysis: DropAnalysis) -> Result:
    from pfwd.analysis.drop_result import drop_result

    return Result.of(drop_result(point.file, analysis, point.warnings, point.setup.point))


@functools.cache
def library() -> SurrogateLibrary:
    """Return the response tables of the model, which are read once and shared by all calls."""
    from inversion import SurrogateLibrary

    return SurrogateLibrary()
