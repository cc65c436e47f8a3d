"""Shared parts of the readers of other programs' files: request, checked drops, points."""

import datetime
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from inversion.notices import Notice
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.header import (
    HEADER_KEYS,
    IMPORTED,
    MAX_REMARK_CHARACTERS,
    Declaration,
    Declarations,
    is_position,
    setup_from,
    setup_warnings,
)
from pfwd.files.traces import MIN_SAMPLES, TracePoint
from pfwd_device import Channel, Drop
from pfwd_device.drop import Peaks, Quantity
from pfwd_device.text import LONGEST_TEXT, clean

MAX_TIME_DEVIATION_STEPS = 0.05
"""Largest deviation of a time from an even axis, in steps: more than the rounding of times that are
printed with three digits, far less than a lost sample."""

SAME_OFFSET_M = 1e-6
"""Distance below which two offsets are the same: offsets are stored in single precision."""

Channels = Literal["raw", "stored"]
Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Request:
    """Options for reading a file."""

    declarations: Declarations = field(default_factory=dict)
    """Header keys that override those of the file."""
    channels: Channels | None = None
    """Raw channels, or those that the other program processed and stored; None: raw ones if there
    are any."""
    column_map: str | None = None
    """Path of a TOML file that describes the columns of a text."""

    def without(self, key: str) -> tuple["Request", Declaration | None]:
        """Return the request without one declared key, and the declaration of that key."""
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
    """Return an exactly even time axis, s, for one that was rounded when it was printed.

    Raises
    ------
    TraceError
        If a time deviates by more than rounding explains.
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
    channels: Sequence[tuple[float, Quantity, Values]],
    where: str,
) -> Drop:
    """Return a drop after the checks for drops of trace files.

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
    """Return a drop with peaks and without time histories.

    Parameters
    ----------
    number : int
    load : float, N
    deflections : sequence of offset (m) and peak (m)
        None: no value; the sensor is omitted.
    where : str
        File and line, for messages.

    Raises
    ------
    TraceError
    """
    pairs = tuple((offset, peak) for offset, peak in deflections if peak is not None)
    numbers = [load, *(n for offset_and_peak in pairs for n in offset_and_peak)]
    if not pairs or not all(math.isfinite(n) for n in numbers):
        raise TraceError(refusal(where, "a load and deflections, finite numbers", "others"))
    return Drop.of_peaks(number, Peaks(load, pairs))


def too_short(where: str, samples: int) -> str:
    """Return the message for a record that is too short."""
    return refusal(where, f"at least {MIN_SAMPLES} samples", str(samples))


def refuse_infinite(values: Values, name: str, where: str) -> None:
    """Refuse NaN and infinity.

    Raises
    ------
    TraceError
    """
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        actual = f"{values[bad[0]]} as sample {int(bad[0]) + 1}"
        raise TraceError(refusal(where, f"finite numbers in {name}", actual))


def distinct_sensors(offsets: Sequence[float]) -> tuple[list[int], list[Notice]]:
    """Return the sensors to use: of two at one offset the first.

    Equal distances on two sides of the plate are two offsets.

    Parameters
    ----------
    offsets : sequence of float, m, negative on the other side

    Returns
    -------
    indices : list of int
        Indices of the sensors to use, in their order.
    remarks : list of Notice
        One for each omitted sensor.
    """
    indices: list[int] = []
    remarks = []
    for index, offset in enumerate(offsets):
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
    """Return a test point from the values of a file and the declarations that override them.

    Parameters
    ----------
    file : str
    values : mapping of header key to value
        Values of the file; None: it has none.
    drops : sequence of Drop
    request : Request
    noted : mapping, optional
        Other data of the file to store, with units in the names.
    remarks : sequence of Notice
        Remarks on how the file was read, shown with every result.

    Raises
    ------
    TraceError
        If a value is outside its range, or the plate radius is missing.
    """
    where = f"{file}, point {values['point']}" if values.get("point") else file
    details = {key: value for key, value in (noted or {}).items() if value not in (None, "")}
    if remarks:
        details["remarks"] = [
            clean(text, limit=MAX_REMARK_CHARACTERS) for text in dict.fromkeys(remarks)
        ]
    stated: dict[str, Any] = {key: value for key, value in values.items() if value is not None}
    if details:
        stated[IMPORTED] = details
    declared = {key: Declaration(value, where) for key, value in stated.items()}
    setup = setup_from(declared | request.declarations, where)
    return TracePoint(file, setup, tuple(drops), setup_warnings(setup, drops))


def short_text(value: object, limit: int = LONGEST_TEXT) -> str | None:
    """Return a text on one line and of bounded length; None if it is no text or blank."""
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        return None
    text = clean(str(value), limit=limit)
    # Programs in C fill fields with NUL, which `clean` makes visible.
    return text.replace("\N{REPLACEMENT CHARACTER}", "").strip() or None


def finite(value: object) -> float | None:
    """Return a finite number, also from a text; None if it is none."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def within(value: object, name: str, low: float, high: float, where: str, hint: str = "") -> float:
    """Return a number from `low` to `high`.

    Raises
    ------
    TraceError
        The message names the quantity.
    """
    number = finite(value)
    if number is None or not low <= number <= high:
        actual = "none" if value is None else quote(value)
        raise TraceError(refusal(where, f"{name}, a number from {low:g} to {high:g}", actual, hint))
    return number


def position_of(latitude: object, longitude: object) -> dict[str, float]:
    """Return the keys of a position; empty if there is none. Receivers without a fix write 0, 0."""
    north, east = finite(latitude), finite(longitude)
    if north is None or east is None or (north, east) == (0.0, 0.0):
        return {}
    return {"latitude": north, "longitude": east} if is_position(north, east) else {}


def temperature_of(value: object) -> float | None:
    """Return a temperature in degrees Celsius; None if it is none, or out of range for ground."""
    number = finite(value)
    return (
        number
        if number is not None and HEADER_KEYS["temperature_c"].value.accepts(number)
        else None
    )


def moment_of(text: object) -> dict[str, str]:
    """Return a time as `time_utc`, or as `time_local` if it has no time zone; empty: no time."""
    if not isinstance(text, str):
        return {}
    try:
        moment = datetime.datetime.fromisoformat(text.strip())
    except ValueError:
        return {}
    if moment.year < 1980:  # programs write 0001, 1899 or 1970 for no date
        return {}
    if moment.tzinfo is None:
        return {"time_local": moment.isoformat()}
    return {"time_utc": moment.astimezone(datetime.UTC).isoformat()}


def distinct_names(names: Sequence[str]) -> list[str]:
    """Return the names with a number behind repeated ones; none is longer than allowed."""
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
            # Stored, so that no number is tried twice, however many equal names there are.
            count = counts[title] = count + 1
        distinct.append(name)
    return distinct
