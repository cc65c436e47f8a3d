"""Shared parts of the readers: options of the user, drops and points with their checks,
conversions.
"""

import datetime
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from inversion import notices
from inversion.notices import Notice, text_of
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.header import (
    HEADER_KEYS,
    IMPORTED,
    MAX_REMARK_CHARACTERS,
    REMARK_CODES,
    Declaration,
    Declarations,
    is_position,
    setup_from,
    setup_warnings,
)
from pfwd.files.traces import MIN_SAMPLES, TracePoint, too_short
from pfwd_device import Channel, Drop
from pfwd_device.drop import Peaks
from pfwd_device.text import LONGEST_TEXT, clean
from pfwd_plugins.quantities import Measurand

MAX_TIME_DEVIATION_STEPS = 0.05
"""Largest deviation of a time from an even axis, in steps: more than the rounding of times that are
printed with three digits, less than a missing sample."""

SAME_OFFSET_M = 1e-6
"""Distance below which two offsets are equal: some programs store them in single precision."""

Channels = Literal["raw", "stored"]
Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Request:
    """Options of the user for reading a file."""

    declarations: Declarations = field(default_factory=dict)
    """Header keys that override those of the file."""
    channels: Channels | None = None
    """Channels to read: "raw" as measured, "stored" as processed by the other program; None: raw
    ones if the file has any."""
    column_map: str | None = None
    """Path of the TOML file that describes the columns of a delimited text."""

    def without(self, key: str) -> tuple["Request", Declaration | None]:
        """Return a copy without one declared header key, and the declaration of that key."""
        remaining = {name: each for name, each in self.declarations.items() if name != key}
        return replace(self, declarations=remaining), self.declarations.get(key)


def sampled_time(samples: int, rate: float, pre_trigger: float) -> Values:
    """Return the times of evenly sampled values, s, 0 at the trigger.

    Parameters
    ----------
    samples : int
    rate : float, Hz
    pre_trigger : float, s
        Recorded time before the trigger, >= 0.
    """
    # The sample nearest to the trigger is at 0: the trigger is one of the samples.
    first = round(pre_trigger * rate)
    return np.asarray((np.arange(samples) - first) / rate, np.float64)


def even_time(times: Values, where: str) -> Values:
    """Return an exactly even time axis, s, from times that were rounded when they were printed.

    Parameters
    ----------
    times : (n,) ndarray of float, s
    where : str
        File and place, for messages.

    Raises
    ------
    TraceError
        If a time deviates from an even axis by more than `MAX_TIME_DEVIATION_STEPS`.
    """
    if times.size < MIN_SAMPLES:
        raise TraceError(too_short(where, times.size))
    refuse_infinite(times, "the time", where)
    step = (times[-1] - times[0]) / (times.size - 1)
    index = np.arange(times.size)
    off = np.abs(times - (times[0] + step * index))
    if not (step > 0 and off.max() <= MAX_TIME_DEVIATION_STEPS * step):
        row = int(np.argmax(off))
        expected = "even, growing time steps"
        raise TraceError(refusal(where, expected, f"{times[row]:.6g} s as sample {row + 1}"))
    # An axis that is even already stays as the other program wrote it.
    if np.abs(np.diff(times) - step).max() <= 1e-9 * step:
        return times
    return np.asarray(times[0] + step * index, np.float64)


def make_drop(
    number: int,
    time: Values,
    load: Values,
    channels: Sequence[tuple[float, Measurand, Values]],
    where: str,
) -> Drop:
    """Return a drop with traces.

    Parameters
    ----------
    number : int
    time : (n,) ndarray of float, s
    load : (n,) ndarray of float, N, downward positive
    channels : sequence of offset (m), quantity, and values (m/s or m, downward positive)
    where : str
        File and place, for messages.

    Raises
    ------
    TraceError
        If it has too few samples, traces of different lengths, NaN or infinity.
    """
    if time.size < MIN_SAMPLES:
        raise TraceError(too_short(where, time.size))
    for values, name in (
        (load, "the load"),
        *((c[2], f"the sensor at {c[0]:g} m") for c in channels),
    ):
        if values.shape != time.shape:
            raise TraceError(refusal(where, f"{time.size} samples of {name}", str(values.size)))
        refuse_infinite(values, name, where)
    traces = tuple(Channel(offset, quantity, values) for offset, quantity, values in channels)
    return Drop(number, time, load, traces)


def peaks_drop(
    number: int, load: float, deflections: Sequence[tuple[float, float | None]], where: str
) -> Drop:
    """Return a drop that has peaks and no traces.

    Parameters
    ----------
    number : int
    load : float, N
        Peak load.
    deflections : sequence of offset (m) and peak deflection (m)
        A sensor whose peak is None is omitted.
    where : str
        File and line, for messages.

    Raises
    ------
    TraceError
        If a value is not finite, or no sensor has a peak.
    """
    pairs = tuple((offset, peak) for offset, peak in deflections if peak is not None)
    numbers = [load, *(n for offset_and_peak in pairs for n in offset_and_peak)]
    if not pairs or not all(math.isfinite(n) for n in numbers):
        raise TraceError(refusal(where, "a load and deflections, finite numbers", "others"))
    return Drop.of_peaks(number, Peaks(load, pairs))


def refuse_infinite(values: Values, name: str, where: str) -> None:
    """Raise TraceError if values are NaN or infinite."""
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        actual = f"{values[bad[0]]} as sample {int(bad[0]) + 1}"
        raise TraceError(refusal(where, f"finite numbers in {name}", actual))


def distinct_sensors(offsets: Sequence[float]) -> tuple[list[int], list[Notice]]:
    """Return the sensors to use: of several with the same offset only the first.

    Parameters
    ----------
    offsets : sequence of float, m
        Distance from the plate centre, negative on the other side of the plate; NaN: the sensor is
        omitted without a remark.

    Returns
    -------
    indices : list of int
        Indices of the sensors to use, in ascending order.
    remarks : list of Notice
        A remark on each omitted sensor.
    """
    indices: list[int] = []
    remarks = []
    for index, offset in enumerate(offsets):
        if math.isnan(offset):
            continue
        if any(abs(offsets[index_before] - offset) < SAME_OFFSET_M for index_before in indices):
            remarks.append(Notice("sensor-at-same-place", {"offset_m": offset}))
        else:
            indices.append(index)
    return indices, remarks


def point_of(
    file: str,
    values: Mapping[str, Any],
    drops: Sequence[Drop],
    request: Request,
    *,
    noted: Mapping[str, Any] | None = None,
    remarks: Sequence[Notice] = (),
) -> TracePoint:
    """Return a test point from the values in a file and the user's declarations, which override
    them.

    Parameters
    ----------
    file : str
        Path of the file.
    values : mapping of header key to value
        Values in the file; a value of None is left out.
    drops : sequence of Drop
    request : Request
        Options of the user.
    noted : mapping, optional
        Further data of the file, stored under the header key `IMPORTED`; keys end with the unit.
    remarks : sequence of Notice
        Remarks on how the file was read.

    Raises
    ------
    TraceError
        If a value is outside its range, or the plate radius is missing.
    """
    where = f"{file}, point {values['point']}" if values.get("point") else file
    details = {key: value for key, value in (noted or {}).items() if value not in (None, "")}
    if remarks:
        # Remarks whose numbers are equal as shown are one.
        distinct = {text_of(remark): remark for remark in remarks}
        details["remarks"] = [clean(text, limit=MAX_REMARK_CHARACTERS) for text in distinct]
        details[REMARK_CODES] = notices.codes(distinct.values())
    stated: dict[str, Any] = {key: value for key, value in values.items() if value is not None}
    if details:
        stated[IMPORTED] = details
    declared = {key: Declaration(value, where) for key, value in stated.items()}
    setup = setup_from(declared | request.declarations, where)
    return TracePoint(file, setup, tuple(drops), setup_warnings(setup, drops))


def short_text(value: object, limit: int = LONGEST_TEXT) -> str | None:
    """Return a value as one line of text, cut to `limit` characters.

    Returns
    -------
    str or None
        None: the value is blank, or neither text nor number.
    """
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        return None
    text = clean(str(value), limit=limit)
    # Fields of fixed width are filled with NUL, for which `clean` puts a visible character.
    return text.replace("\N{REPLACEMENT CHARACTER}", "").strip() or None


def finite(value: object) -> float | None:
    """Convert a number or its text to a finite float; None: it is neither, or not finite."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def within(value: object, name: str, low: float, high: float, where: str, hint: str = "") -> float:
    """Convert a number or its text to a float from `low` to `high`.

    Parameters
    ----------
    value : object
    name : str
        Name of the quantity, for the message.
    low, high : float
    where, hint : str
        File and place, and what to try, for the message.

    Raises
    ------
    TraceError
        If the value is no number in the range.
    """
    number = finite(value)
    if number is None or not low <= number <= high:
        actual = "none" if value is None else quote(value)
        raise TraceError(refusal(where, f"{name}, a number from {low:g} to {high:g}", actual, hint))
    return number


def position_of(latitude: object, longitude: object) -> dict[str, float]:
    """Return the header keys of a position.

    Parameters
    ----------
    latitude, longitude : object
        Numbers or their texts, degrees, north and east positive.

    Returns
    -------
    dict
        Empty: the values are no position, or both are 0, which receivers write before they have a
        position.
    """
    north, east = finite(latitude), finite(longitude)
    if north is None or east is None or (north, east) == (0.0, 0.0):
        return {}
    return {"latitude": north, "longitude": east} if is_position(north, east) else {}


def decoded(data: bytes) -> tuple[str, str]:
    """Return a text and its encoding: UTF-8, else that of Windows."""
    try:
        return data.decode("utf-8-sig"), "utf-8-sig"
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace"), "cp1252"


def temperature_of(value: object, *, fahrenheit: bool = False) -> float | None:
    """Convert a number or its text to degrees Celsius; None: no number, or outside the range of
    ground.

    Parameters
    ----------
    value : object
    fahrenheit : bool
        True: the number is in degrees Fahrenheit.
    """
    number = finite(value)
    if number is not None and fahrenheit:
        number = (number - 32.0) / 1.8
    return number if HEADER_KEYS["temperature_c"].value.accepts(number) else None


def moment_of(text: object) -> dict[str, str]:
    """Return the header keys of a date and time.

    Parameters
    ----------
    text : object
        ISO 8601.

    Returns
    -------
    dict
        ``time_utc``, or ``time_local`` if the text has no time zone. Empty: no date, or one that
        programs write in place of none (before 1980).
    """
    if not isinstance(text, str):
        return {}
    try:
        moment = datetime.datetime.fromisoformat(text.strip())
    except ValueError:
        return {}
    if moment.year < 1980:  # programs write the years 1, 1899 or 1970 for an unknown date
        return {}
    if moment.tzinfo is None:
        return {"time_local": moment.isoformat()}
    return {"time_utc": moment.astimezone(datetime.UTC).isoformat()}


def distinct_names(names: Sequence[str]) -> list[str]:
    """Return the names cut to the allowed length, with a number appended to repeated ones."""
    counts: dict[str, int] = {}
    distinct = []
    for name in names:
        name = name.strip()[:LONGEST_TEXT] or "point"
        title = name
        count = counts[title] = counts.get(title, 0) + 1
        while count > 1:
            tail = f" ({count})"
            candidate = title[: LONGEST_TEXT - len(tail)] + tail
            if candidate not in counts:
                counts[candidate] = 1
                name = candidate
                break
            # The count is stored, so that the time does not grow with the square of equal names.
            count = counts[title] = count + 1
        distinct.append(name)
    return distinct
