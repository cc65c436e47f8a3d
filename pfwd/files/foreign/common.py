"""What every reader of another program's files shares: the request, checked drops, whole points."""

import datetime
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from inversion.notices import Notice
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.header import (
    IMPORTED,
    KEYS,
    LONGEST_REMARK,
    Declaration,
    Declarations,
    setup_from,
    setup_warnings,
)
from pfwd.files.traces import MIN_SAMPLES, TracePoint
from pfwd_device import Channel, Drop
from pfwd_device.drop import Peaks, Quantity
from pfwd_device.text import LONGEST_TEXT, clean

ROUNDING = 0.05
"""Largest deviation of a time from an even axis, over its step: more than times that were printed
with three digits a step deviate, far less than a lost sample."""

SAME_PLACE = 1e-6
"""m; positions closer than that are one: they come from single precision."""

Channels = Literal["raw", "stored"]
Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Request:
    """What the caller wants of a file besides its content."""

    said: Declarations = field(default_factory=dict)
    """Header keys that win over what the file declares."""
    channels: Channels | None = None
    """Raw channels, or those that the other program had processed and stored; None: raw ones where
    there are any."""
    column_map: str | None = None
    """TOML file that says what the columns of a text hold."""


def sampled_time(samples: int, rate: float, pre_trigger: float) -> Values:
    """Times of evenly sampled values, s, 0 at the trigger.

    Parameters
    ----------
    samples : int
    rate : float, Hz
    pre_trigger : float, s
        What was recorded before the trigger, >= 0.
    """
    # The sample nearest to the trigger is at 0: the trigger is one of the samples.
    first = round(pre_trigger * rate)
    return np.asarray((np.arange(samples) - first) / rate, np.float64)


def even_time(times: Values, where: str) -> Values:
    """An exactly even time axis in place of one that was rounded when it was printed, s.

    Raises
    ------
    TraceError
        If a time is further from even than rounding explains.
    """
    if times.size < MIN_SAMPLES:
        raise TraceError(too_few(where, times.size))
    refuse_infinite(times, "the time", where)
    step = (times[-1] - times[0]) / (times.size - 1)
    index = np.arange(times.size)
    off = np.abs(times - (times[0] + step * index))
    if not (step > 0 and off.max() <= ROUNDING * step):
        row = int(np.argmax(off))
        expected = "even, growing time steps"
        raise TraceError(refusal(where, expected, f"{times[row]:.6g} s as sample {row + 1}"))
    # Kept where it is even already: what another program wrote exactly is not touched.
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
    """A drop, checked as those of trace files are.

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
        raise TraceError(too_few(where, time.size))
    for values, name in (
        (load, "the load"),
        *((c[2], f"the sensor at {c[0]:g} m") for c in channels),
    ):
        if values.shape != time.shape:
            raise TraceError(refusal(where, f"{time.size} samples of {name}", str(values.size)))
        refuse_infinite(values, name, where)
    kept = tuple(Channel(offset, quantity, values) for offset, quantity, values in channels)
    return Drop(number, time, load, kept)


def peaks_drop(
    number: int, load: float, deflections: Sequence[tuple[float, float | None]], where: str
) -> Drop:
    """A drop of which the file has peaks only.

    Parameters
    ----------
    number : int
    load : float, N
    deflections : sequence of offset (m) and peak (m)
        None: the sensor gave none, and is left out.
    where : str
        File and line, for messages.

    Raises
    ------
    TraceError
    """
    kept = tuple((offset, peak) for offset, peak in deflections if peak is not None)
    numbers = [load, *(n for pair in kept for n in pair)]
    if not kept or not all(math.isfinite(n) for n in numbers):
        raise TraceError(refusal(where, "a load and deflections, finite numbers", "others"))
    return Drop.of_peaks(number, Peaks(load, kept))


def too_few(where: str, samples: int) -> str:
    """The message of a record that is too short."""
    return refusal(where, f"at least {MIN_SAMPLES} samples", str(samples))


def refuse_infinite(values: Values, name: str, where: str) -> None:
    """Refuse NaN and infinity.

    Raises
    ------
    TraceError
    """
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        came = f"{values[bad[0]]} as sample {int(bad[0]) + 1}"
        raise TraceError(refusal(where, f"finite numbers in {name}", came))


def one_a_place(offsets: Sequence[float]) -> tuple[list[int], list[Notice]]:
    """Which sensors are taken where two are said to stand at one place: the first.

    Two sides of the plate at one distance are two places.

    Parameters
    ----------
    offsets : sequence of float, m, negative on the other side

    Returns
    -------
    indices : list of int
        Of the sensors that are taken, in their order.
    remarks : list of Notice
        What was left out.
    """
    taken: list[int] = []
    remarks = []
    for index, offset in enumerate(offsets):
        if any(abs(offsets[other] - offset) < SAME_PLACE for other in taken):
            remarks.append(Notice("sensor-at-same-place", {"offset_m": offset}))
        else:
            taken.append(index)
    return taken, remarks


def point_of(
    file: str,
    known: Mapping[str, Any],
    drops: Sequence[Drop],
    request: Request,
    *,
    noted: Mapping[str, Any] | None = None,
    remarks: Sequence[Notice] = (),
) -> TracePoint:
    """A test point from what a file says and what the caller says over it.

    Parameters
    ----------
    file : str
    known : mapping of header key to value
        None: the file does not say.
    drops : sequence of Drop
    request : Request
    noted : mapping, optional
        What else is kept of the file, with units in the names.
    remarks : sequence of Notice
        What a user should know of how it was read; shown with every result.

    Raises
    ------
    TraceError
        If a value is outside its range, or the plate radius is missing.
    """
    where = f"{file}, point {known['point']}" if known.get("point") else file
    kept = {key: value for key, value in (noted or {}).items() if value not in (None, "")}
    if remarks:
        kept["remarks"] = [clean(text, limit=LONGEST_REMARK) for text in dict.fromkeys(remarks)]
    said: dict[str, Any] = {key: value for key, value in known.items() if value is not None}
    if kept:
        said[IMPORTED] = kept
    declared = {key: Declaration(value, where) for key, value in said.items()} | request.said
    setup = setup_from(declared, where)
    return TracePoint(file, setup, tuple(drops), setup_warnings(setup, drops))


def short_text(value: object, limit: int = LONGEST_TEXT) -> str | None:
    """Text of a file on one line and of bounded length; None when it is none or blank."""
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        return None
    text = clean(str(value), limit=limit)
    # Programs in C fill fields with NUL, which cleaning made visible.
    return text.replace("\N{REPLACEMENT CHARACTER}", "").strip() or None


def finite(value: object) -> float | None:
    """A finite number, also when it is written as text; None when it is none."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def within(value: object, name: str, low: float, high: float, where: str, hint: str = "") -> float:
    """A number from `low` to `high`.

    Raises
    ------
    TraceError
        The message names what it is.
    """
    number = finite(value)
    if number is None or not low <= number <= high:
        came = "none" if value is None else quote(value)
        raise TraceError(refusal(where, f"{name}, a number from {low:g} to {high:g}", came, hint))
    return number


def position_of(latitude: object, longitude: object) -> dict[str, float]:
    """Keys of a position; empty when there is none. 0, 0 is what receivers without a fix write."""
    north, east = finite(latitude), finite(longitude)
    if north is None or east is None or (north, east) == (0.0, 0.0):
        return {}
    if abs(north) > 90 or abs(east) > 180:
        return {}
    return {"latitude": north, "longitude": east}


def temperature_of(value: object) -> float | None:
    """A temperature in degrees Celsius; None when it is none, or one that no ground has."""
    number = finite(value)
    return number if number is not None and KEYS["temperature_c"].value.accepts(number) else None


def moment_of(text: object) -> dict[str, str]:
    """When, as `time_utc`, or as `time_local` where the file does not say its time zone."""
    if not isinstance(text, str):
        return {}
    try:
        moment = datetime.datetime.fromisoformat(text.strip())
    except ValueError:
        return {}
    if moment.year < 1980:  # what programs write for no date: 0001, 1899, 1970
        return {}
    if moment.tzinfo is None:
        return {"time_local": moment.isoformat()}
    return {"time_utc": moment.astimezone(datetime.UTC).isoformat()}


def distinct(names: Sequence[str]) -> list[str]:
    """The names, with a number behind those that came before; none longer than allowed."""
    seen: dict[str, int] = {}
    found = []
    for name in names:
        name = name.strip()[:LONGEST_TEXT] or "point"
        wanted = name
        count = seen[wanted] = seen.get(wanted, 0) + 1
        while count > 1:
            tail = f" ({count})"
            other = wanted[: LONGEST_TEXT - len(tail)] + tail
            if other not in seen:
                seen[other] = 1
                name = other
                break
            # Kept, so that no number is tried twice, however many names came before.
            count = seen[wanted] = count + 1
        found.append(name)
    return found
