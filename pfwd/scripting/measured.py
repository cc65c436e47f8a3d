"""Measured drops and points, read from files of any supported format or made from arrays."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inversion import notices
from inversion.notices import Notice
from inversion.records import without_nan
from pfwd import display
from pfwd.analysis.drop_facts import unbroken_peaks
from pfwd.analysis.options import OPTION_OF_KEY, AnalysisOptions
from pfwd.errors import OptionError, TraceError, quote, refusal
from pfwd.files.arrays import numbers, sensor_offsets, time_and_load
from pfwd.files.header import PointSetup, setup_warnings
from pfwd.files.importing import Kind, kind_of
from pfwd.files.plausible_units import refuse_wrong_units
from pfwd.files.reading import read_points
from pfwd.files.traces import (
    DROP_COLUMN,
    LOAD_COLUMN,
    TIME_COLUMN,
    TracePoint,
    sensor_name,
)
from pfwd.scripting.options import DECLARED_OPTIONS, Header, analysis_options, reading
from pfwd_device.drop import Channel, Drop, Peaks
from pfwd_device.signals import displacement_of
from pfwd_plugins.quantities import MOTIONS, Measurand, MotionName, motion

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame
    from xarray import Dataset

ARRAYS_FILE = "arrays"
"""Text in place of the file name, for a drop that was made from arrays."""


class MeasuredDrop(display.Displayable):
    """One impact with its recorded traces and the declarations of its point."""

    __slots__ = ("_drop", "_index", "_point")

    def __init__(self, point: TracePoint, index: int) -> None:
        self._point, self._index, self._drop = point, index, point.drops[index]

    number: int = display.alias("_drop.number")
    """Number of the drop within its point, from 1."""
    file: str = display.alias("_point.file")
    """Path of the file or survey from which the drop was read."""
    time: NDArray[np.float64] = display.alias("_drop.time")
    """Time, (n,), s; 0 is the trigger."""
    load: NDArray[np.float64] = display.alias("_drop.load")
    """Load, (n,), N, downward positive."""

    point: str | None = display.alias("_point.name")
    """Name of the test point; None: not declared."""
    declared: dict[str, Any] = display.alias("_point.declared")
    """Declared values of instrument and ground, by header key (docs/traces.md)."""

    @property
    def values(self) -> NDArray[np.float64]:
        """Recorded traces, (n_sensors, n), downward positive; `quantities` has their quantity and
        unit.
        """
        return np.array([channel.values for channel in self._drop.channels])

    @property
    def offsets(self) -> tuple[float, ...]:
        """Distance of each sensor from the plate centre, m."""
        return tuple(channel.offset for channel in self._drop.channels)

    @property
    def quantities(self) -> tuple[str, ...]:
        """Recorded quantity of each sensor: ``velocity`` (m/s) or ``displacement`` (m)."""
        return tuple(channel.quantity.value for channel in self._drop.channels)

    @property
    def displacement(self) -> NDArray[np.float64]:
        """Displacements, (n_sensors, n), m: velocities are integrated, offsets at rest removed."""
        return np.array([displacement_of(c, self.time) for c in self._drop.channels])

    peak_load: float | None = display.alias("_peaks.load")
    """Peak load above the load at rest, N; None: samples around the trigger are missing."""
    peak_displacement: float | None = display.alias("_peaks.centre")
    """Peak displacement in the centre, m; None: no sensor there, or samples are missing."""

    @property
    def _peaks(self) -> Peaks | None:
        return unbroken_peaks(self._drop)

    @property
    def peak_displacements(self) -> NDArray[np.float64] | None:
        """Peak displacement of every sensor, (n_sensors,), m; None: samples are missing."""
        peaks = self._peaks
        return None if peaks is None else np.array([peak for _, peak in peaks.displacements])

    @property
    def kind(self) -> Kind:
        """``traces``; ``peaks``, if the file has no traces; ``stiffness``, on a rig of springs."""
        return kind_of(self._drop, self.declared)

    def __repr__(self) -> str:
        where = "" if self.point is None else f" of {display.one_line(self.point)}"
        peak = "samples missing"
        if self.peak_load is not None:
            peak = f"peak {self.peak_load / 1e3:.3g} kN"
        length = "no time history"
        if self.time.size:
            rate = self._drop.sampling_rate / 1e3
            length = f"{1e3 * np.ptp(self.time):.3g} ms at {rate:.3g} kHz"
        places = ", ".join(f"{offset:g}" for offset in self.offsets)
        sensors = f"{display.count(len(self.offsets), 'sensor')} at {places} m"
        return f"Drop({self.number}{where}: {peak}, {length}, {sensors})"

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """Return one row with the declarations and the peaks."""
        row = {
            "file": self.file,
            "point": self.point,
            "drop": self.number,
            "peak_load_n": self.peak_load,
            "peak_displacement_m": self.peak_displacement,
        }
        return [self.declared | row]

    def to_dict(self) -> dict[str, Any]:
        """Return declared values and traces (as lists), by header key and column name."""
        values = {"file": self.file, **self.declared, **self._columns()}
        return {key: without_nan(value) for key, value in values.items()}

    def _columns(self) -> dict[str, Any]:
        """Return the columns of a trace file."""
        sensors = {sensor_name(c.quantity, c.offset): c.values for c in self._drop.channels}
        return {DROP_COLUMN: self.number, TIME_COLUMN: self.time, LOAD_COLUMN: self.load, **sensors}

    def to_dataframe(self) -> DataFrame:
        """Return the traces as a table with the columns of a trace file; needs pandas."""
        return display.imported("pandas", "to_dataframe").DataFrame(self._columns())

    def to_xarray(self) -> Dataset:
        """Return the traces as an xarray Dataset.

        The variables are ``load`` (time) in N, ``displacement`` (sensor, time) in m, and
        ``velocity`` (sensor, time) in m/s, NaN for a sensor that did not record it. Coordinates are
        ``time`` in s and ``offset`` in m; the attributes are the declared values.

        Raises
        ------
        OptionError
            If xarray is not installed.
        """
        axes, m, s = ("sensor", "time"), {"units": "m"}, {"units": "s"}
        recorded = np.array(self.quantities)[:, None]
        motions = {
            str(each): (axes, np.where(recorded == each, self.values, np.nan), {"units": each.unit})
            for each in MOTIONS
            if each is Measurand.VELOCITY or (each.integrations and each in self.quantities)
        }
        dataset: Dataset = display.imported("xarray", "to_xarray").Dataset(
            {
                "load": ("time", self.load, {"units": "N"}),
                "displacement": (axes, self.displacement, m),
                **motions,
            },
            {"time": ("time", self.time, s), "offset": ("sensor", np.array(self.offsets), m)},
            {"file": self.file, **self.declared, DROP_COLUMN: self.number},
        )
        return dataset

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the displacement of every sensor, in µm over ms.

        Parameters
        ----------
        ax : Axes of matplotlib, optional
            None: a new figure is made.
        """
        return _plot([self], ax, "")


class MeasuredPoint(display.Displayable, tuple[MeasuredDrop, ...]):
    """One test point with its declared values and its drops; a sequence of drops."""

    _point: TracePoint

    def __new__(cls, point: TracePoint) -> Self:
        self = super().__new__(
            cls, (MeasuredDrop(point, index) for index in range(len(point.drops)))
        )
        self._point = point
        return self

    def __getnewargs__(self) -> Any:
        return (self._point,)

    file: str = display.alias("_point.file")
    """Path of the file or survey from which the point was read."""
    warnings: tuple[Notice, ...] = display.alias("_point.warnings")
    """Warnings that concern all drops of the point."""
    name: str | None = display.alias("_point.name")
    """Declared name; None: not declared."""
    declared: dict[str, Any] = display.alias("_point.declared")
    """Declared values of instrument and ground, by header key (docs/traces.md)."""
    drops: tuple[MeasuredDrop, ...] = property(tuple)  # type: ignore[assignment]
    """Drops in the order of the file."""

    def __repr__(self) -> str:
        name = display.one_line(self.name if self.name is not None else self.file)
        radius = self._point.setup.plate_radius
        return f"Point({name}: {display.count(len(self), 'drop')}, plate of radius {radius:g} m)"

    def rows(self) -> Iterable[Mapping[str, Any]]:
        """Return the rows of the drops."""
        return (row for drop in self for row in drop.rows())

    def to_dict(self) -> dict[str, Any]:
        """Return the declared values and warnings by their keys, and ``drops`` as `Drop.to_dict`
        has them.
        """
        values = {"file": self.file, **self.declared, **notices.to_json(self.warnings)}
        record: dict[str, Any] = without_nan(values)
        return {**record, "drops": [drop.to_dict() for drop in self]}

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the displacements of all drops, in µm over ms, see `Drop.plot`."""
        return _plot(self, ax, repr(self))


class Points(display.DisplayableList[MeasuredPoint]):
    """Test points of one file; a sequence of points, which can be chosen by name as well."""

    KEY, NAME = "points", "name"

    @property
    def file(self) -> str:
        """Path of the file or survey from which the points were read."""
        return self[0].file if self else ""

    @property
    def drops(self) -> tuple[MeasuredDrop, ...]:
        """Drops of all points, point by point."""
        return tuple(drop for point in self for drop in point)

    def __repr__(self) -> str:
        drops = display.count(len(self.drops), "drop")
        name = display.one_line(os.path.basename(self.file) or self.file)
        return f"Points({name}: {display.count(len(self), 'point')}, {drops})"

    def to_dict(self) -> dict[str, Any]:
        """Return ``file`` and ``points``, each as `Point.to_dict` has it."""
        return {"file": self.file, **super().to_dict()}

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the displacements of all drops, in µm over ms, see `Drop.plot`."""
        return _plot(self.drops, ax, repr(self))


class HasPoints(Protocol):
    """Object with points, such as a survey."""

    @property
    def points(self) -> Points: ...


Data = str | os.PathLike[str] | HasPoints | Sequence[MeasuredDrop | MeasuredPoint]
"""Data of several drops."""


def read(
    path: str | os.PathLike[str],
    *,
    header: Header = None,
    map: str | os.PathLike[str] | None = None,
    channels: Literal["raw", "stored"] | None = None,
    **declared: float,
) -> Points:
    """Read the test points of a file of any supported format, with their drops.

    Parameters
    ----------
    path : path of a trace file, a survey (folder or exported), a drop file, or a file of another
        program (docs/files.md)
    header : path of a TOML file, or its keys as a dict, optional
        Overrides the declarations of the file.
    map : path of a TOML file, optional
        Column map of a text that is no trace file.
    channels : "raw" or "stored", optional
        Channels to read from a file that has both: as measured, or as another program processed
        them.
    **declared : plate_radius (m), plate_mass (kg), poisson_ratio, density (kg/m3)
        Override the declarations of file and header.

    Returns
    -------
    Points

    Raises
    ------
    SurveyError
        If the file is refused; the message states what was expected, what was read, and where.

    Examples
    --------
    >>> pfwd.read(pfwd.example("layer").file)
    Points(layer.csv: 1 point, 3 drops)
    """
    if not isinstance(path, str | os.PathLike):
        raise OptionError(refusal("path", "the path of a file or folder", type(path).__name__))
    if channels not in (None, "raw", "stored"):
        raise OptionError(refusal("channels", "raw or stored", quote(channels)))
    options = analysis_options(DECLARED_OPTIONS, declared)
    file, overrides = reading(header, options)
    points = read_points(path, file, overrides, column_map=map, channels=channels)
    return Points(MeasuredPoint(point) for point in points)


def drop(
    time: ArrayLike,
    load: ArrayLike,
    values: ArrayLike,
    *,
    quantity: MotionName = "displacement",
    offsets: float | Sequence[float] | None = None,
    geophone_natural_frequency: float | None = None,
    geophone_damping: float | None = None,
    **declared: float | None,
) -> MeasuredDrop:
    """Make a drop from arrays.

    Parameters
    ----------
    time : (n,) s, uniform steps; 0 is the trigger, with some rest before it
    load : (n,) N, downward positive
    values : (n,) or (n_sensors, n), m or m/s, downward positive
    quantity : quantity of `values`, ``displacement`` (m) or ``velocity`` (m/s)
    offsets : distance of each sensor from the plate centre, m, negative on its opposite side;
        default for one sensor: 0
    geophone_natural_frequency, geophone_damping : float, Hz and -, response that velocities still
        carry; 0 Hz: corrected; default: no response, with a warning
    **declared : plate_radius (m), required;
        plate_mass (kg, between load cell and ground; default: 0, with a warning); poisson_ratio
        (default: 0.35); density (kg/m3; default: fitted)

    Returns
    -------
    Drop

    Raises
    ------
    SurveyError
        If the arrays do not fit together or a value is outside its range.
    """
    if quantity not in MOTIONS:
        raise OptionError(refusal("quantity", " or ".join(MOTIONS), quote(quantity)))
    measured = motion(quantity)
    axis, force = time_and_load(time, load)
    table = np.atleast_2d(numbers("values", values))
    if table.ndim != 2 or table.shape[1] != axis.size:
        expected = f"({axis.size},) or (n_sensors, {axis.size})"
        raise TraceError(refusal("values", expected, f"shape {table.shape}"))
    places = sensor_offsets(offsets, len(table))
    options = analysis_options(DECLARED_OPTIONS, declared)
    if options.plate_radius is None:
        raise OptionError(refusal("plate_radius", "a number > 0, in m", "none"))
    setup = PointSetup(
        **{name: getattr(options, name) for name in DECLARED_OPTIONS},
        geophone_natural_frequency=geophone_natural_frequency,
        geophone_damping=geophone_damping,
    )
    sensors = (Channel(r, measured, row) for r, row in zip(places, table, strict=True))
    made = Drop(1, axis, force, tuple(sensors))
    hint = f"is the time in s, the load in N, and are the values in {measured.unit}?"
    refuse_wrong_units([made], setup, "arrays", hint)
    return MeasuredDrop(TracePoint(ARRAYS_FILE, setup, (made,), setup_warnings(setup, [made])), 0)


def requested(
    names: tuple[str, ...], data: Any, arrays: tuple[Any, ...], options: dict[str, Any]
) -> tuple[Any, AnalysisOptions, Header]:
    """Return the data of a request, its options and its header.

    Arrays become a drop.

    Parameters
    ----------
    names : tuple of str
        Names of the permitted options.
    data : object
        Data, or the time axis of arrays.
    arrays : tuple
        The arrays ``load`` and ``values``; empty: no arrays are given.
    options : dict
        Options by name, with ``header``, ``quantity`` and ``offsets``.

    Raises
    ------
    SurveyError
        If an option is wrong, or the arrays do not fit together.
    """
    header = options.pop("header", None)
    of_arrays = {key: options.pop(key, None) for key in ("offsets", "quantity")}
    of_arrays = {key: value for key, value in of_arrays.items() if value is not None}
    settings = analysis_options(names, options)
    is_number_list = isinstance(data, list | tuple) and data and isinstance(data[0], int | float)
    if not (arrays or is_number_list or hasattr(data, "__array__")):
        for name in of_arrays:
            raise OptionError(refusal(name, "none unless arrays are given", "one"))
        return data, settings, header
    if len(arrays) != 2:
        got = f"{1 + len(arrays)}"
        raise OptionError(refusal("arrays", "three: time, load, values", got))
    if header is not None:
        raise OptionError(refusal("header", "none for arrays", "one", "give plate_radius=..."))
    declared = {name: getattr(settings, name) for name in DECLARED_OPTIONS}
    return drop(data, arrays[0], arrays[1], **of_arrays, **declared), settings, None


def points_of(data: object, header: Header, overrides: Mapping[str, float]) -> list[TracePoint]:
    """Return the test points of a path, a survey, points, a point, or drops.

    Parameters
    ----------
    data : object
    header : as for `read`; must be None for data that were read before
    overrides : mapping of header key to value
        Override the declarations of the points.

    Raises
    ------
    SurveyError
        If `data` has no points.
    """
    if isinstance(data, str | os.PathLike):
        declared: dict[str, Any] = {OPTION_OF_KEY[key]: v for key, v in overrides.items()}
        return [point._point for point in read(data, header=header, **declared)]
    if header is not None:
        hint = "give it to pfwd.read"
        raise OptionError(refusal("header", "none for what was read already", "one", hint))
    if isinstance(data, MeasuredDrop):
        point, place = data._point, slice(data._index, data._index + 1)
        part = replace(point, drops=point.drops[place], survey_drops=point.survey_drops[place])
        return [_declared(part, overrides)]
    if isinstance(data, MeasuredPoint):
        return [_declared(data._point, overrides)]
    points = getattr(data, "points", data)
    if isinstance(points, Sequence) and points and not isinstance(points, bytes):
        return [point for item in points for point in points_of(item, None, overrides)]
    kind = "an empty one" if isinstance(points, Sequence) else type(data).__name__
    raise OptionError(refusal("data", EXPECTED_DATA, kind))


EXPECTED_DATA = "a path, a survey, points, a drop, or the arrays time, load, values"


def _declared(point: TracePoint, overrides: Mapping[str, float]) -> TracePoint:
    changes: dict[str, Any] = {OPTION_OF_KEY[key]: value for key, value in overrides.items()}
    return replace(point, setup=replace(point.setup, **changes)) if changes else point


def _plot(drops: Sequence[MeasuredDrop], ax: Axes | None, title: str) -> Axes:
    ax = display.axes_or_new(ax)
    for drop_ in drops:
        for offset, values in zip(drop_.offsets, drop_.displacement, strict=True):
            label = f"drop {drop_.number}, {offset:g} m"
            ax.plot(1e3 * drop_.time, 1e6 * values, label=label)
    return display.label_axes(ax, display.TIME_LABEL, display.DISPLACEMENT_LABEL, title)
