"""Conversion of a drop to the content of its record in the journal, and back, bit by bit.

The journal contains all records of a survey. The content of a record consists of data (values that
JSON can express) and arrays. A rebound is a later impact of the same fall.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from pfwd_device.drop import Channel, Drop, Peaks
from pfwd_device.errors import RecordingError
from pfwd_device.recording.payload import Array, decode_payload, encode_payload
from pfwd_device.recording.record import DropRecord, ReboundRecord
from pfwd_device.signals import trace_peaks
from pfwd_plugins.quantities import motion

MAX_SENSORS = 1024
MAX_REBOUNDS = 1024

TRACE_PEAKS_VERSION = 1
"""Version of the computation of the peaks in a record. It has to be incremented when
:func:`pfwd_device.signals.trace_peaks` changes: readers then ignore the peaks of older records and
compute them from the traces."""

PEAK_TOLERANCE = 1e-9
"""Largest difference of a recorded peak from the computed one, relative to the largest value of the
trace: another processor may add in another order."""

_T = TypeVar("_T")
Parts = tuple[dict[str, Any], dict[str, Array]]


def drop_parts(record: DropRecord) -> Parts:
    """Return a drop with its rebounds as the data and the arrays of a record."""
    drop = record.drop
    data: dict[str, Any] = {
        "point": record.point,
        "drop": drop.number,
        "declared": record.declared,
        "metadata": record.metadata,
        "sensors": [[channel.offset, channel.quantity] for channel in drop.channels],
        "rebounds": [_rebound_data(rebound) for rebound in record.rebounds],
    }
    if drop.only_peaks is not None:
        # The key differs from "peaks", which are computed from traces.
        displacements = [peak for _, peak in drop.only_peaks.displacements]
        data["only_peaks"] = {"load": drop.only_peaks.load, "displacements": displacements}
        return data, {}
    arrays: dict[str, Array] = {"time": drop.time, "load": drop.load}
    for index, channel in enumerate(drop.channels, start=1):
        arrays[f"sensor {index}"] = channel.values
    if record.counts is not None:
        arrays["counts"] = record.counts
    for index, rebound in enumerate(record.rebounds, start=1):
        arrays[f"rebound {index}"] = rebound.counts
    return data, arrays


def is_trace(name: str) -> bool:
    """Return True if the name of an array in the record of a drop is that of a trace in SI units.

    Traces are the time, the load and the sensors; other arrays are raw counts.
    """
    return name in ("time", "load") or name.startswith("sensor ")


@dataclass(frozen=True, slots=True)
class DropFacts:
    """Values of a drop for the row of a table: declarations, and either its peaks or its traces."""

    declared: Mapping[str, Any]
    """Declared values; see :class:`DropRecord`."""
    metadata: Mapping[str, Any]
    """Metadata; see :class:`DropRecord`."""
    peaks: Peaks | None
    """Recorded peaks; None if the record has none."""
    drop: Drop | None
    """Drop with its traces; None if `peaks` has them, so that the traces were not read."""


def facts_of(record: DropRecord) -> DropFacts:
    """Return the `DropFacts` of a record that was read with its traces."""
    return DropFacts(record.declared, record.metadata, None, record.drop)


def peaks_data(drop: Drop) -> dict[str, Any] | None:
    """Return the peaks of the traces of a drop as data for its record.

    None for a drop with missing samples (NaN), because each reader treats these differently, and
    for a drop without traces, whose record contains its peaks already.
    """
    if drop.only_peaks is not None:
        return None  # `drop_parts` writes them
    if not all(np.isfinite(trace).all() for trace in (drop.time, drop.load, *_values(drop))):
        return None
    with np.errstate(over="ignore", invalid="ignore"):  # values near the largest number overflow
        peaks = trace_peaks(drop)
    displacements = [peak for _, peak in peaks.displacements]
    if not np.isfinite([peaks.load, *displacements]).all():
        return None
    return {"version": TRACE_PEAKS_VERSION, "load": peaks.load, "displacements": displacements}


def recorded_peaks(data: Mapping[str, Any]) -> Peaks | None:
    """Return the peaks that were computed from the traces when a drop was recorded.

    None if the record has none, or those of another `TRACE_PEAKS_VERSION`.

    Parameters
    ----------
    data : mapping
        Data of the record.
    """
    if "only_peaks" in data:
        return None  # `drop_from_parts` reads them
    recorded = data.get("peaks")
    if not isinstance(recorded, dict) or recorded.get("version") != TRACE_PEAKS_VERSION:
        return None
    load, displacements, sensors = (
        recorded.get("load"),
        recorded.get("displacements"),
        data.get("sensors"),
    )
    if (
        not isinstance(displacements, list)
        or not isinstance(sensors, list)
        or len(displacements) != len(sensors)
    ):
        return None
    try:
        # Adding 0.0 turns -0.0 into 0.0, as in Channel.
        offsets = [_number(offset) + 0.0 for offset, _ in sensors]
        return Peaks(_number(load), tuple(zip(offsets, map(_number, displacements), strict=True)))
    except (TypeError, ValueError):
        return None


def peaks_problem(payload: bytes) -> str | None:
    """Return a message if the recorded peaks of a drop differ from those of its traces, or None.

    Parameters
    ----------
    payload : bytes
        Content of the record of the drop.

    Raises
    ------
    RecordingError
        If the content is not that of a drop.
    """
    data, arrays = decode_payload(payload, is_trace)
    recorded = recorded_peaks(data)
    if recorded is None:
        return None
    drop = drop_from_parts({**data, "rebounds": []}, arrays).drop
    computed = trace_peaks(drop)
    if recorded == computed:  # the usual case needs no tolerance
        return None
    if peaks_data(drop) is None:
        return "expected no recorded peaks, because samples of the traces are missing, got some"
    largest = [float(np.abs(values).max()) for values in (drop.load, *_values(drop))]
    duration = float(drop.time[-1] - drop.time[0])
    scales = [
        size * duration**channel.quantity.integrations
        for size, channel in zip(largest[1:], drop.channels, strict=True)
    ]
    pairs = [("load", "N", recorded.load, computed.load, largest[0])]
    for index, scale in enumerate(scales):
        peaks = recorded.displacements[index][1], computed.displacements[index][1]
        pairs.append((f"displacement of sensor {index + 1}", "m", *peaks, scale))
    for name, unit, actual, expected, scale in pairs:
        if not abs(actual - expected) <= PEAK_TOLERANCE * scale:
            return (
                f"expected the peak {name} of its traces, {expected:g} {unit}, "
                f"got {actual:g} {unit}"
            )
    return None


def drop_from_parts(data: Mapping[str, Any], arrays: Mapping[str, Array]) -> DropRecord:
    """Return the drop of a record from its data and arrays, the inverse of `drop_parts`.

    Raises
    ------
    RecordingError
        If they are not the data and arrays of a drop.
    """
    try:
        sensors, rebounds = list(data["sensors"]), list(data["rebounds"])
        if len(sensors) > MAX_SENSORS or len(rebounds) > MAX_REBOUNDS:
            raise RecordingError(f"expected at most {MAX_SENSORS} sensors and rebounds, got more")
        number = _typed(int, data["drop"])
        if "only_peaks" in data:
            drop = Drop.of_peaks(number, _only_peaks(data["only_peaks"], sensors))
        else:
            channels = tuple(
                Channel(_number(offset), motion(quantity), arrays[f"sensor {index}"])
                for index, (offset, quantity) in enumerate(sensors, start=1)
            )
            drop = Drop(number, arrays["time"], arrays["load"], channels)
        return DropRecord(
            point=_typed(str, data["point"]),
            drop=drop,
            counts=arrays.get("counts"),
            declared=_typed(dict, data["declared"]),
            metadata=_typed(dict, data["metadata"]),
            rebounds=tuple(
                _rebound_from(entry, arrays[f"rebound {index}"])
                for index, entry in enumerate(rebounds, start=1)
            ),
        )
    except (KeyError, TypeError, ValueError) as err:
        raise RecordingError(f"expected the data of a drop, got other data: {err}") from err


def _only_peaks(recorded: Any, sensors: list[Any]) -> Peaks:
    offsets = [_number(offset) for offset, _ in sensors]
    displacements = [_number(peak) for peak in recorded["displacements"]]
    return Peaks(_number(recorded["load"]), tuple(zip(offsets, displacements, strict=True)))


def rebound_payload(number: int, rebound: ReboundRecord) -> bytes:
    """Return the content of the record of a rebound.

    Parameters
    ----------
    number : int
        Number within the survey of the drop to which the rebound belongs.
    rebound : Rebound
    """
    return encode_payload(_rebound_data(rebound) | {"number": number}, {"counts": rebound.counts})


def rebound_from_payload(payload: bytes) -> ReboundRecord:
    """Return the rebound in the content of a record.

    Raises
    ------
    RecordingError
        If the record is not that of a rebound.
    """
    data, arrays = decode_payload(payload)
    try:
        return _rebound_from(data, arrays["counts"])
    except (KeyError, TypeError, ValueError) as err:
        raise RecordingError(f"expected the data of a rebound, got other data: {err}") from err


def with_rebounds(record: DropRecord, later: tuple[ReboundRecord, ...]) -> DropRecord:
    """Return the drop with further rebounds, which were recorded after it; skip those it has."""
    recorded_earlier = {(rebound.first_sample, rebound.delay) for rebound in record.rebounds}
    later = tuple(r for r in later if (r.first_sample, r.delay) not in recorded_earlier)
    return replace(record, rebounds=(*record.rebounds, *later)) if later else record


def _rebound_data(rebound: ReboundRecord) -> dict[str, Any]:
    return {
        "delay": rebound.delay,
        "peak_load": rebound.peak_load,
        "first_sample": rebound.first_sample,
    }


def _rebound_from(data: Mapping[str, Any], counts: Array) -> ReboundRecord:
    return ReboundRecord(
        delay=_number(data["delay"]),
        peak_load=_number(data["peak_load"]),
        first_sample=_typed(int, data["first_sample"]),
        counts=counts,
    )


def _values(drop: Drop) -> list[Array]:
    return [channel.values for channel in drop.channels]


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating):
        raise TypeError(f"expected a number, got {type(value).__name__}")
    return float(value)


def _typed(kind: type[_T], value: object) -> _T:
    if type(value) is not kind:
        raise TypeError(f"expected {kind.__name__}, got {type(value).__name__}")
    return value
