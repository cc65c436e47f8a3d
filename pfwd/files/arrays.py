"""Checks of arrays from which a drop is made."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfwd.errors import OptionError, TraceError, quote, refusal
from pfwd.files.traces import MIN_SAMPLES, RELATIVE_STEP_TOLERANCE, too_short


def time_and_load(
    time: ArrayLike, load: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Check the arrays of time and load and return them as (n,) float, s and N.

    Raises
    ------
    TraceError
        If they differ in length, have too few samples, or the time steps are not uniform.
    """
    axis, force = numbers("time", time), numbers("load", load)
    for name, vector in (("time", axis), ("load", force)):
        if vector.ndim != 1:
            raise TraceError(refusal(name, "one dimension", f"shape {vector.shape}"))
    if axis.size < MIN_SAMPLES:
        raise TraceError(too_short("time", axis.size))
    if force.size != axis.size:
        raise TraceError(refusal("load", f"{axis.size} samples as in time", str(force.size)))
    steps = np.diff(axis)
    step = float(np.median(steps))
    if not (step > 0 and np.all(np.abs(steps - step) <= RELATIVE_STEP_TOLERANCE * step)):
        expected = "uniform, rising steps in s"
        raise TraceError(refusal("time", expected, "other steps", "resample the record"))
    return axis, force


def sensor_offsets(offsets: float | Sequence[float] | None, sensors: int) -> list[float]:
    """Return the distance of each sensor from the plate centre, m.

    Raises
    ------
    SurveyError
        If there is not one for each sensor, or two are equal.
    """
    if offsets is None and sensors == 1:
        return [0.0]
    places = np.empty(0) if offsets is None else np.atleast_1d(numbers("offsets", offsets))
    if places.shape != (sensors,) or np.unique(places).size != sensors:
        expected = f"the distances of {sensors} sensors from the plate centre, all different, in m"
        got = "none" if offsets is None else quote(offsets)
        raise OptionError(refusal("offsets", expected, got))
    return [float(place) for place in places]


def numbers(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return an array as numbers.

    Raises
    ------
    TraceError
        If a value is missing, or is no finite real number.
    """
    # A conversion would replace masked values by what lies under the mask, discard imaginary parts
    # and turn dates into counts of their units.
    if any(map(np.ma.is_masked, values if isinstance(values, list | tuple) else [values])):
        hint = "interpolate the missing values"
        raise TraceError(refusal(name, "numbers", "masked values", hint))
    try:
        array = np.asarray(values)
        is_text = array.dtype.kind in "OSU"
        numbers = array.astype(np.float64, casting="unsafe" if is_text else "same_kind")
    except (TypeError, ValueError) as err:
        raise TraceError(refusal(name, "real numbers", quote(values))) from err
    if not np.all(np.isfinite(numbers)):
        raise TraceError(refusal(name, "finite numbers", "NaN or infinity"))
    return numbers
