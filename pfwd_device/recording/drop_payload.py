"""A drop and its rebounds as the data and arrays of a record, and back, bit by bit."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pfwd_device.drop import Channel, Drop, Peaks
from pfwd_device.errors import RecordingError
from pfwd_device.recording.layout import PEAKS_FORMAT_VERSION
from pfwd_device.recording.payload import Array, decode_payload, encode_payload
from pfwd_device.recording.record import DropRecord, Rebound
from pfwd_device.signals import trace_peaks

MOST_SENSORS = 1024
MOST_REBOUNDS = 1024

PEAKS_VERSION = 1
"""Version of the peaks in a record. Increment it when :func:`pfwd_device.signals.trace_peaks`
changes: the peaks of an older record are then computed from its traces."""

SAME_PEAKS = 1e-9
"""Of the largest value of a trace: another processor adds up in another order. A peak that somebody
changed so little nobody can tell from one that was not."""

Parts = tuple[dict[str, Any], dict[str, Array]]


def drop_parts(record: DropRecord) -> Parts:
    """Data and arrays of a drop with the rebounds that it has."""
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
        # What was recorded; ``peaks`` is what is found in traces, and may be found anew.
        found = [peak for _, peak in drop.only_peaks.displacements]
        data["only_peaks"] = {"load": drop.only_peaks.load, "displacements": found}
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
    """Whether an array of a drop's record is one of its traces, in SI units."""
    return name in ("time", "load") or name.startswith("sensor ")


@dataclass(frozen=True, slots=True)
class DropFacts:
    """What a row of a table needs of a drop: its peaks, or the traces to find them in."""

    declared: Mapping[str, Any]
    """As in :class:`DropRecord`."""
    metadata: Mapping[str, Any]
    """As in :class:`DropRecord`."""
    peaks: Peaks | None
    """As they were recorded; None: they were not."""
    drop: Drop | None
    """The traces; None: the peaks are there, and the traces were not read."""


def facts_of(record: DropRecord) -> DropFacts:
    """Those of a drop whose traces are there."""
    return DropFacts(record.declared, record.metadata, None, record.drop)


def peaks_data(drop: Drop) -> dict[str, Any] | None:
    """What a record says of the peaks of a drop; None when that has to be left to its readers.

    They decide what is to be done about missing samples. A drop with any value that is no finite
    number is one of those.
    """
    if drop.only_peaks is not None:
        return None  # they are in the record as what it is
    if not all(np.isfinite(trace).all() for trace in (drop.time, drop.load, *_values(drop))):
        return None
    with np.errstate(over="ignore", invalid="ignore"):  # numbers near the largest
        peaks = trace_peaks(drop)
    found = [peak for _, peak in peaks.displacements]
    if not np.isfinite([peaks.load, *found]).all():
        return None
    return {"version": PEAKS_VERSION, "load": peaks.load, "displacements": found}


def recorded_peaks(data: Mapping[str, Any]) -> Peaks | None:
    """The peaks that a record has; None when it has none, or others than this version writes."""
    if "only_peaks" in data:
        return None  # made with the drop
    said = data.get("peaks")
    if not isinstance(said, dict) or said.get("version") != PEAKS_VERSION:
        return None
    load, found, sensors = said.get("load"), said.get("displacements"), data.get("sensors")
    if not isinstance(found, list) or not isinstance(sensors, list) or len(found) != len(sensors):
        return None
    try:
        # As Channel has it: 0.0 takes the sign off -0.
        offsets = [_number(offset) + 0.0 for offset, _ in sensors]
        return Peaks(_number(load), tuple(zip(offsets, map(_number, found), strict=True)))
    except (TypeError, ValueError):
        return None


def peaks_problem(payload: bytes) -> str | None:
    """Why what the record of a drop says of its peaks is not so; None: it is, or it says nothing.

    Raises
    ------
    RecordingError
        If the payload has no traces.
    """
    data, arrays = decode_payload(payload, is_trace)
    said = recorded_peaks(data)
    if said is None:
        return None
    drop = drop_from_parts({**data, "rebounds": []}, arrays).drop
    found = trace_peaks(drop)
    if said == found:  # nearly always
        return None
    if peaks_data(drop) is None:
        return "expected no peaks beside traces with missing samples, got some"
    largest = [float(np.abs(values).max()) for values in (drop.load, *_values(drop))]
    lasts = float(drop.time[-1] - drop.time[0])
    scales = [
        size * (lasts if channel.quantity == "velocity" else 1.0)
        for size, channel in zip(largest[1:], drop.channels, strict=True)
    ]
    pairs = [("load", "N", said.load, found.load, largest[0])]
    for index, scale in enumerate(scales):
        peaks = said.displacements[index][1], found.displacements[index][1]
        pairs.append((f"displacement of sensor {index + 1}", "m", *peaks, scale))
    for name, unit, there, expected, scale in pairs:
        if not abs(there - expected) <= SAME_PEAKS * scale:
            return (
                f"expected the peak {name} of its traces, {expected:g} {unit}, got {there:g} {unit}"
            )
    return None


def drop_from_parts(data: Mapping[str, Any], arrays: Mapping[str, Array]) -> DropRecord:
    """The drop; RecordingError when data and arrays are not those of one."""
    try:
        sensors, rebounds = list(data["sensors"]), list(data["rebounds"])
        if len(sensors) > MOST_SENSORS or len(rebounds) > MOST_REBOUNDS:
            raise RecordingError(f"expected at most {MOST_SENSORS} sensors and rebounds, got more")
        number = _whole(data["drop"])
        if "only_peaks" in data:
            drop = Drop.of_peaks(number, _only_peaks(data["only_peaks"], sensors))
        else:
            channels = tuple(
                Channel(_number(offset), _quantity(quantity), arrays[f"sensor {index}"])
                for index, (offset, quantity) in enumerate(sensors, start=1)
            )
            drop = Drop(number, arrays["time"], arrays["load"], channels)
        return DropRecord(
            point=_text(data["point"]),
            drop=drop,
            counts=arrays.get("counts"),
            declared=_mapping(data["declared"]),
            metadata=_mapping(data["metadata"]),
            rebounds=tuple(
                _rebound_from(entry, arrays[f"rebound {index}"])
                for index, entry in enumerate(rebounds, start=1)
            ),
        )
    except (KeyError, TypeError, ValueError) as err:
        raise RecordingError(f"expected the data of a drop, got others: {err}") from err


def _only_peaks(said: Any, sensors: list[Any]) -> Peaks:
    """The peaks of a record without traces."""
    offsets = [_number(offset) for offset, _ in sensors]
    found = [_number(peak) for peak in said["displacements"]]
    return Peaks(_number(said["load"]), tuple(zip(offsets, found, strict=True)))


def raised_version(info: Mapping[str, Any], data: Mapping[str, Any]) -> dict[str, Any] | None:
    """What a survey has to say of itself before it takes this drop; None: it says so already.

    Parameters
    ----------
    info : mapping
        What the survey says of itself.
    data : mapping
        Of the drop's record.
    """
    if "only_peaks" not in data or info.get("format_version") == PEAKS_FORMAT_VERSION:
        return None
    return {**info, "format_version": PEAKS_FORMAT_VERSION}


def rebound_payload(number: int, rebound: Rebound) -> bytes:
    """The record of a rebound of the drop with this survey-wide number."""
    return encode_payload(_rebound_data(rebound) | {"number": number}, {"counts": rebound.counts})


def rebound_from_payload(payload: bytes) -> Rebound:
    """The rebound; RecordingError when the payload is none."""
    data, arrays = decode_payload(payload)
    try:
        return _rebound_from(data, arrays["counts"])
    except (KeyError, TypeError, ValueError) as err:
        raise RecordingError(f"expected the data of a rebound, got others: {err}") from err


def with_rebounds(record: DropRecord, later: tuple[Rebound, ...]) -> DropRecord:
    """The drop with rebounds that were recorded after it, each of them once."""
    known = {(rebound.first_sample, rebound.delay) for rebound in record.rebounds}
    later = tuple(r for r in later if (r.first_sample, r.delay) not in known)
    if not later:
        return record
    return DropRecord(
        record.point,
        record.drop,
        record.counts,
        record.declared,
        record.metadata,
        (*record.rebounds, *later),
    )


def _rebound_data(rebound: Rebound) -> dict[str, Any]:
    return {
        "delay": rebound.delay,
        "peak_load": rebound.peak_load,
        "first_sample": rebound.first_sample,
    }


def _rebound_from(data: Mapping[str, Any], counts: Array) -> Rebound:
    return Rebound(
        delay=_number(data["delay"]),
        peak_load=_number(data["peak_load"]),
        first_sample=_whole(data["first_sample"]),
        counts=counts,
    )


def _values(drop: Drop) -> list[Array]:
    return [channel.values for channel in drop.channels]


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating):
        raise TypeError("a number is missing")
    return float(value)


def _whole(value: object) -> int:
    if type(value) is not int:
        raise TypeError("a whole number is missing")
    return value


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError("a text is missing")
    return value


def _quantity(value: object) -> Any:
    if value not in ("velocity", "displacement"):
        raise ValueError("a sensor measures velocity or displacement")
    return value


def _mapping(value: object) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise TypeError("a mapping is missing")
    return value
