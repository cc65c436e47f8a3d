"""Metadata recorded with a drop beside its samples, and the way back to a replay."""

import dataclasses
import datetime
import operator
from collections.abc import Mapping
from typing import Any

from pfwd.session.feeds import ImportedDrop, RecordedDrop
from pfwd_device.acquisition.detection import AtRest, DetectionSettings, RawDrop, RawRebound
from pfwd_device.calibration import counts_per_unit, load_channel
from pfwd_device.errors import SetupError
from pfwd_device.identity import Identity, identity_as_dict, identity_from_dict
from pfwd_device.recording.drop_file import software_version
from pfwd_device.recording.record import DropRecord, Rebound
from pfwd_device.wire.messages import Status

SATURATED = "saturated"
"""Beginning of the mark of a drop of which a channel was at the end of its range."""


def metadata_of(
    raw: RawDrop,
    identity: Identity,
    settings: DetectionSettings,
    time_utc: datetime.datetime,
    more: Mapping[str, Any],
    *,
    by_instrument: bool = False,
) -> dict[str, Any]:
    """Return the metadata recorded with a drop.

    Parameters
    ----------
    raw : RawDrop
    identity : Identity
        That the counts were calibrated with.
    settings : DetectionSettings
        That the drop was found with.
    time_utc : datetime
        Of the trigger, by the host.
    more : mapping
        Checks, status, link counters.
    by_instrument : bool
        The instrument found it, not the detection here.
    """
    trigger = raw.first + raw.trigger
    return {
        # The same samples of the same run of the same instrument are the same drop.
        "key": f"{identity.serial_number}/{raw.stream}/{trigger}",
        "time_utc": time_utc.isoformat(),
        "time_local": time_utc.astimezone().isoformat(),  # with the offset of the host's zone
        "software_version": software_version(),
        "identity": identity_as_dict(identity),
        "detection": {
            "settings": dataclasses.asdict(settings),
            "stream": raw.stream,
            "first_sample": raw.first,
            "trigger": raw.trigger,
            "at_rest": dataclasses.asdict(raw.at_rest),
            "threshold": raw.threshold,
            "by_operator": raw.by_operator,
            **({"by_instrument": True} if by_instrument else {}),
        },
        "missing": [list(gap) for gap in raw.missing],
        "marks": list(marks_of(raw, identity)),
        **more,
    }


def state_of(
    check: Mapping[str, Any] | None, status: Status | None, counters: Mapping[str, float | None]
) -> dict[str, Any]:
    """Return the instrument's recorded state: last check and status, counters of the link."""
    answers = status and {
        "battery_v": status.battery_v,
        "temperature_c": status.temperature_c,
        "overruns": status.overruns,
    }
    return {"check": check, "status": answers, "link": dict(counters)}


def marks_of(raw: RawDrop, identity: Identity) -> tuple[str, ...]:
    """Return the irregularities of a record, one phrase each."""
    marks = []
    if raw.cut_off:
        marks.append(f"cut off: {raw.cut_off}")
    if raw.missing:
        count = sum(length for _, length in raw.missing)
        start = (raw.missing[0][0] - raw.trigger) / identity.sampling_rate
        marks.append(
            f"{count} of {len(raw.counts)} samples missing, the first at {start * 1e3:.1f} ms"
        )
    for channel, count in raw.saturated:
        name = identity.channels[channel].name
        marks.append(f"{SATURATED}: {count} samples of {name} at the end of the converter's range")
    if raw.by_operator:
        marks.append("triggered by the operator")
    return tuple(marks)


def load_of(counts: float, identity: Identity) -> float:
    """Return the load of a number of counts above rest, N."""
    load = identity.channels[load_channel(identity)]
    return counts / abs(counts_per_unit(load, identity))


def rebound_of(raw: RawRebound, identity: Identity) -> Rebound:
    """Return a rebound in SI units."""
    return Rebound(
        delay=(raw.trigger - raw.after) / identity.sampling_rate,
        peak_load=load_of(raw.peak, identity),
        first_sample=raw.first,
        counts=raw.counts,
    )


def feed_item_of(record: DropRecord, file: str) -> RecordedDrop | ImportedDrop:
    """Return the item by which a recorded drop goes through the detection again.

    Parameters
    ----------
    record : DropRecord
    file : str
        Where it is kept.

    Raises
    ------
    SetupError
        If what was recorded with it is incomplete.
    """
    detection = record.metadata.get("detection")
    if record.counts is None or detection is None:
        return ImportedDrop(record, file)
    try:
        for start, length in record.metadata["missing"]:
            _ = operator.index(start) + operator.index(length)
        first = detection["first_sample"]
        # The trigger was not this detection's: it is given, not looked for.
        forced = detection["by_operator"] or detection.get("by_instrument", False)
        return RecordedDrop(
            record,
            identity_from_dict(record.metadata["identity"]),
            DetectionSettings(**detection["settings"]),
            operator.index(detection["stream"]),
            operator.index(first),
            AtRest(**detection["at_rest"]),
            first + detection["trigger"] if forced else None,
            file,
        )
    except (KeyError, TypeError, ValueError) as err:
        raise SetupError(
            f"drop {record.point}/{record.drop.number}: expected a complete record of its "
            f"detection: {err}"
        ) from err
