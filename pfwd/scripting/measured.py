"""Measured drops and points, read from files of any supported format or made from arrays."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inversion import notices
from inversion.notices import Notice
from pfwd.analysis.drop_facts import unbroken_peaks
from pfwd.analysis.options import OPTION_OF_KEY
from pfwd.errors import OptionError, TraceError, quote, refusal
from pfwd.export.json_text import without_nan
from pfwd.files.header import PointSetup, declared_values
from pfwd.files.importing import Kind, kind_of
from pfwd.files.plausible_units import refuse_wrong_units
from pfwd.files.reading import read_points
from pfwd.files.traces import (
    DROP_COLUMN,
    LOAD_COLUMN,
    MIN_SAMPLES,
    RELATIVE_STEP_TOLERANCE,
    TIME_COLUMN,
    TracePoint,
    sensor_name,
)
from pfwd.scripting.display import ScriptObject, axes_or_new, count, data_frame, html_table, text_of
from pfwd.scripting.options import analysis_options, reading
from pfwd_device.drop import Channel, Peaks
from pfwd_device.drop import Drop as DeviceDrop
from pfwd_device.signals import displacement_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame
    from xarray import Dataset

ARRAYS_FILE = "arrays"
"""Text in place of the file name, for a drop that was made from arrays."""


class Drop(ScriptObject):
    """One impact with its recorded traces; returned by `read`, `open` and `drop`."""

    __slots__ = ("_index", "_point")

    def __init__(self, point: TracePoint, index: int) -> None:
        self._point = point
        self._index = index

    @property
    def _drop(self) -> DeviceDrop:
        return self._point.drops[self._index]

    @property
    def number(self) -> int:
        """Number of the drop within its point, from 1."""
        return self._drop.number

    @property
    def file(self) -> str:
        """Path of the file or survey from which the drop was read."""
        return self._point.file

    @property
    def point(self) -> str | None:
        """Name of the test point; None: not declared."""
        return _name(self._point.setup)

    @property
    def declared(self) -> dict[str, Any]:
        """Declared values of instrument and ground, by header key (docs/traces.md)."""
        return declared_values(self._point.setup)

    @property
    def time(self) -> NDArray[np.float64]:
        """Time, (n,), s; 0 is the trigger."""
        return self._drop.time

    @property
    def load(self) -> NDArray[np.float64]:
        """Load, (n,), N, downward positive."""
        return self._drop.load

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
        return tuple(channel.quantity for channel in self._drop.channels)

    @property
    def displacement(self) -> NDArray[np.float64]:
        """Displacements, (n_sensors, n), m: velocities are integrated, offsets at rest removed."""
        drop = self._drop
        return np.array([displacement_of(channel, drop.time) for channel in drop.channels])

    @property
    def peak_load(self) -> float | None:
        """Peak load above the load at rest, N; None: samples around the trigger are missing."""
        peaks = self._peaks()
        return None if peaks is None else peaks.load

    @property
    def peak_displacement(self) -> float | None:
        """Peak displacement in the centre, m; None: no sensor there, or samples are missing."""
        peaks = self._peaks()
        return None if peaks is None else peaks.centre

    @property
    def kind(self) -> Kind:
        """``traces``; ``peaks``, if the file has no traces; ``stiffness``, on a rig of springs."""
        return kind_of(self._drop, self.declared)

    @property
    def peak_displacements(self) -> NDArray[np.float64] | None:
        """Peak displacement of every sensor, (n_sensors,), m; None: samples are missing."""
        peaks = self._peaks()
        return None if peaks is None else np.array([peak for _, peak in peaks.displacements])

    def _peaks(self) -> Peaks | None:
        return unbroken_peaks(self._drop)

    def __repr__(self) -> str:
        drop = self._drop
        where = "" if self.point is None else f" of {text_of(self.point)}"
        peak = (
            "samples missing" if self.peak_load is None else f"peak {self.peak_load / 1e3:.3g} kN"
        )
        places = ", ".join(f"{offset:g}" for offset in self.offsets)
        length = "no time history"
        if drop.only_peaks is None:
            duration = 1e3 * (drop.time[-1] - drop.time[0])
            length = f"{duration:.3g} ms at {drop.sampling_rate / 1e3:.3g} kHz"
        return (
            f"Drop({self.number}{where}: {peak}, {length}, "
            f"{count(len(self.offsets), 'sensor')} at {places} m)"
        )

    def _repr_html_(self) -> str:
        return html_table(repr(self), _DROP_TABLE_COLUMNS, [_row(self)])

    def to_dict(self) -> dict[str, Any]:
        """Return declared values and traces (as lists), by header key and column name."""
        values = {"file": self.file, **self.declared, DROP_COLUMN: self.number, **self._columns()}
        record: dict[str, Any] = without_nan(values)
        return record

    def _columns(self) -> dict[str, NDArray[np.float64]]:
        """Return the traces by the column names of a trace file."""
        drop = self._drop
        sensors = {sensor_name(c.quantity, c.offset): c.values for c in drop.channels}
        return {TIME_COLUMN: drop.time, LOAD_COLUMN: drop.load, **sensors}

    def to_dataframe(self) -> DataFrame:
        """Return the traces as a table with the columns of a trace file; needs pandas."""
        columns = self._columns()
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        return data_frame(
            {DROP_COLUMN: self.number, **dict(zip(columns, row, strict=True))} for row in rows
        )

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
        try:
            import xarray
        except ImportError as err:
            hint = "python -m pip install xarray, or to_dict()"
            raise OptionError(refusal("to_xarray()", "the package xarray", "none", hint)) from err
        is_velocity = np.array([quantity == "velocity" for quantity in self.quantities])
        velocity = np.where(is_velocity[:, None], self.values, np.nan)
        traces = ("sensor", "time")
        variables = {
            "load": ("time", self.load, {"units": "N"}),
            "displacement": (traces, self.displacement, {"units": "m"}),
            "velocity": (traces, velocity, {"units": "m/s"}),
        }
        coordinates = {
            "time": ("time", self.time, {"units": "s"}),
            "offset": ("sensor", np.array(self.offsets), {"units": "m"}),
        }
        attributes = {"file": self.file, **self.declared, DROP_COLUMN: self.number}
        return xarray.Dataset(variables, coordinates, attributes)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the displacement of every sensor, in µm over ms.

        Parameters
        ----------
        ax : Axes of matplotlib, optional
            None: a new figure is made.

        Returns
        -------
        Axes
        """
        ax = axes_or_new(ax)
        for offset, values in zip(self.offsets, self.displacement, strict=True):
            label = f"drop {self.number}, {offset:g} m"
            ax.plot(1e3 * self.time, 1e6 * values, label=label)
        ax.set_xlabel("time after the trigger, ms")
        ax.set_ylabel("displacement, µm, downward positive")
        ax.legend()
        return ax


class Point(ScriptObject, Sequence[Drop]):
    """One test point with its declared values and its drops; a sequence of drops."""

    __slots__ = ("_drops", "_point")

    def __init__(self, point: TracePoint) -> None:
        self._point = point
        self._drops = tuple(Drop(point, index) for index in range(len(point.drops)))

    @property
    def name(self) -> str | None:
        """Declared name; None: not declared."""
        return _name(self._point.setup)

    @property
    def file(self) -> str:
        """Path of the file or survey from which the point was read."""
        return self._point.file

    @property
    def declared(self) -> dict[str, Any]:
        """Declared values of instrument and ground, by header key (docs/traces.md)."""
        return declared_values(self._point.setup)

    @property
    def warnings(self) -> tuple[Notice, ...]:
        """Warnings that concern all drops of the point."""
        return self._point.warnings

    @property
    def drops(self) -> tuple[Drop, ...]:
        """Drops in the order of the file."""
        return self._drops

    def __len__(self) -> int:
        return len(self._drops)

    @overload
    def __getitem__(self, index: int) -> Drop: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Drop]: ...
    def __getitem__(self, index: int | slice) -> Drop | Sequence[Drop]:
        return self._drops[index]

    def __repr__(self) -> str:
        name = text_of(self.name if self.name is not None else self.file)
        radius = self._point.setup.plate_radius
        return f"Point({name}: {count(len(self), 'drop')}, plate of radius {radius:g} m)"

    def _repr_html_(self) -> str:
        return html_table(repr(self), _DROP_TABLE_COLUMNS, [_row(drop) for drop in self])

    def to_dict(self) -> dict[str, Any]:
        """Return the declared values and warnings by their keys, and ``drops`` as `Drop.to_dict`
        has them.
        """
        values = {"file": self.file, **self.declared, **notices.to_json(self.warnings)}
        record: dict[str, Any] = without_nan(values)
        return {**record, "drops": [drop.to_dict() for drop in self]}

    def to_dataframe(self) -> DataFrame:
        """Return a table with peaks (N, m) and declared values of each drop; needs pandas."""
        return data_frame(map(_summary, self))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the displacements of all drops, in µm over ms; parameter and return as for
        `Drop.plot`.
        """
        return _plot_drops(self, ax, self)


class Points(ScriptObject, Sequence[Point]):
    """Test points of one file; a sequence of points."""

    __slots__ = ("_file", "_points")

    def __init__(self, file: str, points: Sequence[Point]) -> None:
        self._file = file
        self._points = tuple(points)

    @property
    def file(self) -> str:
        """Path of the file or survey from which the points were read."""
        return self._file

    @property
    def drops(self) -> tuple[Drop, ...]:
        """Drops of all points, point by point."""
        return tuple(drop for point in self._points for drop in point)

    def __len__(self) -> int:
        return len(self._points)

    @overload
    def __getitem__(self, index: int) -> Point: ...
    @overload
    def __getitem__(self, index: slice) -> Points: ...
    def __getitem__(self, index: int | slice) -> Point | Points:
        if isinstance(index, slice):
            return Points(self._file, self._points[index])
        return self._points[index]

    def __iter__(self) -> Iterator[Point]:
        return iter(self._points)

    def __repr__(self) -> str:
        drops = count(len(self.drops), "drop")
        name = text_of(os.path.basename(self._file) or self._file)
        return f"Points({name}: {count(len(self), 'point')}, {drops})"

    def _repr_html_(self) -> str:
        return html_table(repr(self), _DROP_TABLE_COLUMNS, [_row(drop) for drop in self.drops])

    def to_dict(self) -> dict[str, Any]:
        """Return ``file`` and ``points``, each as `Point.to_dict` has it."""
        return {"file": self._file, "points": [point.to_dict() for point in self]}

    def to_dataframe(self) -> DataFrame:
        """Return a table with peaks (N, m) and declared values of each drop; needs pandas."""
        return data_frame(map(_summary, self.drops))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the displacements of all drops, in µm over ms; parameter and return as for
        `Drop.plot`.
        """
        return _plot_drops(self.drops, ax, self)


def read(
    path: str | os.PathLike[str],
    *,
    header: str | os.PathLike[str] | Mapping[str, object] | None = None,
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
    _check_path(path)
    if channels not in (None, "raw", "stored"):
        raise OptionError(refusal("channels", "raw or stored", quote(channels)))
    options = analysis_options(tuple(OPTION_OF_KEY.values()), declared)
    file, overrides = reading(header, options)
    points = read_points(path, file, overrides, column_map=map, channels=channels)
    return Points(os.fspath(path), [Point(point) for point in points])


def drop(
    time: ArrayLike,
    load: ArrayLike,
    values: ArrayLike,
    *,
    plate_radius: float,
    quantity: Literal["displacement", "velocity"] = "displacement",
    offsets: float | Sequence[float] | None = None,
    plate_mass: float | None = None,
    poisson_ratio: float | None = None,
    density: float | None = None,
    geophone_natural_frequency: float | None = None,
    geophone_damping: float | None = None,
) -> Drop:
    """Make a drop from arrays.

    Parameters
    ----------
    time : (n,) s, uniform steps; 0 is the trigger, with some rest before it
    load : (n,) N, downward positive
    values : (n,) or (n_sensors, n), m or m/s, downward positive
    plate_radius : float, m
    quantity : quantity of `values`, ``displacement`` (m) or ``velocity`` (m/s)
    offsets : distance of each sensor from the plate centre, m, negative on its opposite side;
        default for one sensor: 0
    plate_mass : float, kg, between load cell and ground; default: 0, with a warning
    poisson_ratio : float; default: 0.35
    density : float, kg/m3; default: fitted
    geophone_natural_frequency, geophone_damping : float, Hz and -, response that velocities still
        carry; 0 Hz: corrected; default: no response, with a warning

    Returns
    -------
    Drop

    Raises
    ------
    SurveyError
        If the arrays do not fit together or a value is outside its range.
    """
    if quantity not in ("displacement", "velocity"):
        raise OptionError(refusal("quantity", "displacement or velocity", quote(quantity)))
    axis, force = time_and_load(time, load)
    table = np.atleast_2d(_numbers("values", values))
    if table.ndim != 2 or table.shape[1] != axis.size:
        expected = f"({axis.size},) or (n_sensors, {axis.size})"
        raise TraceError(refusal("values", expected, f"shape {table.shape}"))
    places = _offsets(offsets, len(table))
    declared = {
        "plate_radius": plate_radius,
        "plate_mass": plate_mass,
        "poisson_ratio": poisson_ratio,
        "density": density,
    }
    options = analysis_options(tuple(OPTION_OF_KEY.values()), declared)
    radius = options.plate_radius
    if radius is None:
        raise OptionError(refusal("plate_radius", "a number > 0, in m", "none"))
    setup = PointSetup(
        plate_radius=radius,
        plate_mass=options.plate_mass,
        poisson_ratio=options.poisson_ratio,
        density=options.density,
        geophone_natural_frequency=geophone_natural_frequency,
        geophone_damping=geophone_damping,
    )
    sensors = (Channel(r, quantity, row) for r, row in zip(places, table, strict=True))
    made = DeviceDrop(1, axis, force, tuple(sensors))
    unit = "m" if quantity == "displacement" else "m/s"
    hint = f"is the time in s, the load in N, and are the values in {unit}?"
    refuse_wrong_units([made], setup, "arrays", hint)
    return Drop(_with_warnings(setup, made), 0)


def time_and_load(
    time: ArrayLike, load: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Check the arrays of time and load and return them as (n,) float, s and N.

    Raises
    ------
    TraceError
        If they differ in length, have too few samples, or the time steps are not uniform.
    """
    axis, force = _vector("time", time), _vector("load", load)
    if axis.size < MIN_SAMPLES:
        raise TraceError(refusal("time", f"at least {MIN_SAMPLES} samples", str(axis.size)))
    if force.size != axis.size:
        raise TraceError(refusal("load", f"{axis.size} samples as in time", str(force.size)))
    steps = np.diff(axis)
    step = float(np.median(steps))
    if not (step > 0 and np.all(np.abs(steps - step) <= RELATIVE_STEP_TOLERANCE * step)):
        expected = "uniform, rising steps in s"
        raise TraceError(refusal("time", expected, "other steps", "resample the record"))
    return axis, force


def _with_warnings(setup: PointSetup, drop: DeviceDrop) -> TracePoint:
    from pfwd.files.header import setup_warnings

    return TracePoint(ARRAYS_FILE, setup, (drop,), setup_warnings(setup, [drop]))


def _offsets(offsets: float | Sequence[float] | None, sensors: int) -> list[float]:
    if offsets is None and sensors == 1:
        return [0.0]
    if offsets is None:
        expected = f"the distances of {sensors} sensors from the plate centre, in m"
        raise OptionError(refusal("offsets", expected, "none"))
    places = np.atleast_1d(_numbers("offsets", offsets))
    if places.shape != (sensors,) or np.unique(places).size != sensors:
        expected = f"{count(sensors, 'different distance')}, in m"
        raise OptionError(refusal("offsets", expected, quote(offsets)))
    distances: list[float] = places.tolist()
    return distances


def _vector(name: str, values: ArrayLike) -> NDArray[np.float64]:
    vector = _numbers(name, values)
    if vector.ndim != 1:
        raise TraceError(refusal(name, "one dimension", f"shape {vector.shape}"))
    return vector


def _numbers(name: str, values: ArrayLike) -> NDArray[np.float64]:
    # A conversion would replace masked values by what lies under the mask, discard imaginary parts
    # and turn dates into counts of their units.
    if any(map(np.ma.is_masked, values if isinstance(values, list | tuple) else [values])):
        hint = "interpolate the missing values"
        raise TraceError(refusal(name, "numbers", "masked values", hint))
    try:
        array = np.asarray(values)
        casting: Literal["unsafe", "same_kind"] = (
            "unsafe" if array.dtype.kind in "OSU" else "same_kind"
        )
        numbers = array.astype(np.float64, casting=casting)
    except (TypeError, ValueError) as err:
        raise TraceError(refusal(name, "real numbers", quote(values))) from err
    if not np.all(np.isfinite(numbers)):
        raise TraceError(refusal(name, "finite numbers", "NaN or infinity"))
    return numbers


def points_of(
    data: object,
    header: str | os.PathLike[str] | Mapping[str, object] | None,
    overrides: Mapping[str, float],
) -> list[TracePoint]:
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
    if isinstance(data, Drop):
        return [_declared(replace(data._point, drops=(data._drop,)), overrides)]
    if isinstance(data, Point):
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


def _check_path(path: object) -> None:
    if not isinstance(path, str | os.PathLike):
        raise OptionError(refusal("path", "the path of a file or folder", type(path).__name__))


def _name(setup: PointSetup) -> str | None:
    return None if setup.point is None else str(setup.point)


_DROP_TABLE_COLUMNS = (
    "point",
    "drop",
    "peak load, kN",
    "peak displacement in the centre, µm",
    "sensors at, m",
)


def _row(drop: Drop) -> tuple[object, ...]:
    load, centre = drop.peak_load, drop.peak_displacement
    return (
        drop.point or "",
        drop.number,
        "" if load is None else f"{load / 1e3:.3f}",
        "" if centre is None else f"{centre * 1e6:.1f}",
        ", ".join(f"{offset:g}" for offset in drop.offsets),
    )


def _summary(drop: Drop) -> dict[str, Any]:
    return {
        "file": drop.file,
        "point": drop.point,
        "drop": drop.number,
        "peak_load_n": drop.peak_load,
        "peak_displacement_m": drop.peak_displacement,
        **{key: value for key, value in drop.declared.items() if key != "point"},
    }


def _plot_drops(drops: Sequence[Drop], ax: Axes | None, source: Point | Points) -> Axes:
    ax = axes_or_new(ax)
    for drop_ in drops:
        drop_.plot(ax)
    ax.set_title(repr(source), fontsize="small", parse_math=False)
    return ax
