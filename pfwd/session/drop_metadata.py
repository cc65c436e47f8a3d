"""Metadata recorded with a drop, and their conversion back for a replay.

Metadata are everything but samples and declarations: identity of the instrument, settings and
result of the detection, time, state of the instrument. Irregularities are listed as `MARKS`.
"""

import dataclasses
import datetime
import operator
from collections.abc import Mapping
from typing import Any

from inversion.notices import Notice, codes
from pfwd.files.record_marks import MARKS, SATURATED
from pfwd.session.feeds import ImportedDrop, RecordedDrop
from pfwd_device.acquisition.detection import (
    AtRest,
    DetectionSettings,
    PulseReport,
    RawDrop,
    RawRebound,
)
from pfwd_device.calibration import counts_per_unit, load_channel
from pfwd_device.errors import SetupError
from pfwd_device.identity import Identity, identity_as_dict, identity_from_dict
from pfwd_device.recording.drop_file import software_version
from pfwd_device.recording.record import DropRecord, ReboundRecord
from pfwd_device.wire.messages import Status


def metadata_of(
    raw: RawDrop,
    identity: Identity,
    settings: DetectionSettings,
    time_utc: datetime.datetime,
    more: Mapping[str, Any],
    *,
    by_instrument: bool = False,
) -> dict[str, Any]:
    """Return the metadata to record with a drop.

    Parameters
    ----------
    raw : RawDrop
    identity : Identity
        Identity of the instrument, with which the counts were calibrated.
    settings : DetectionSettings
        Settings with which the drop was detected.
    time_utc : datetime
        Time of the trigger by the clock of this computer.
    more : mapping
        Further entries, as :func:`state_of` returns them.
    by_instrument : bool
        True: the instrument detected the drop, not this program.
    """
    trigger = raw.first + raw.trigger
    return {
        # By this key a drop is recognised that the instrument transfers a second time.
        "key": f"{identity.serial_number}/{raw.stream}/{trigger}",
        "time_utc": time_utc.isoformat(),
        "time_local": time_utc.astimezone().isoformat(),  # with this computer's offset from UTC
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
        MARKS: codes(marks_of(raw, identity)),
        **more,
    }


def state_of(
    check: Mapping[str, Any] | None, status: Status | None, counters: Mapping[str, float | None]
) -> dict[str, Any]:
    """Return the state of the instrument to record with a drop.

    Parameters
    ----------
    check : mapping or None
        Result of the last sensor check.
    status : Status or None
        Last status of the instrument.
    counters : mapping
        Counters of the link.

    Returns
    -------
    dict
        Keys ``check``, ``status`` and ``link``.
    """
    answers = status and {
        "battery_v": status.battery_v,
        "temperature_c": status.temperature_c,
        "overruns": status.overruns,
    }
    return {"check": check, "status": answers, "link": dict(counters)}


def marks_of(raw: RawDrop, identity: Identity) -> tuple[Notice, ...]:
    """Return the irregularities of a record, such as missing samples."""
    marks = []
    if raw.cut_off:
        marks.append(Notice("cut-off", {"reason": raw.cut_off}))
    if raw.missing:
        count = sum(length for _, length in raw.missing)
        start = (raw.missing[0][0] - raw.trigger) / identity.sampling_rate
        values = {"missing": count, "samples": len(raw.counts), "first_missing_s": start}
        marks.append(Notice("samples-missing", values))
    for channel, count in raw.saturated:
        name = identity.channels[channel].name
        marks.append(Notice(SATURATED, {"samples": count, "channel": name}))
    if raw.by_operator:
        marks.append(Notice("triggered-by-operator"))
    if raw.may_bounce:
        marks.append(Notice("maybe-bounce"))
    return tuple(marks)


def load_of(counts: float, identity: Identity) -> float:
    """Convert raw counts of the load channel, above those at rest, to N."""
    load = identity.channels[load_channel(identity)]
    return counts / abs(counts_per_unit(load, identity))


def pulse_event(pulse: PulseReport, identity: Identity, point: str) -> tuple[dict[str, Any], str]:
    """Return the event and the message about a pulse that may be a missed drop."""
    peak = load_of(pulse.peak, identity)
    seconds = pulse.trigger / identity.sampling_rate
    details = {
        "point": point,
        "peak_load_n": peak,
        "stream": pulse.stream,
        "sample": pulse.trigger,
        "doubt": str(pulse.reason),
    }
    text = (
        f"point {point}: pulse of {peak / 1e3:.2f} kN at {seconds:.2f} s of run "
        f"{pulse.stream}: {pulse.reason}. Check the last drops and repeat a missing one"
    )
    return details, text


def rebound_of(raw: RawRebound, identity: Identity) -> ReboundRecord:
    """Convert a rebound from samples and counts to SI units."""
    return ReboundRecord(
        delay=(raw.trigger - raw.after) / identity.sampling_rate,
        peak_load=load_of(raw.peak, identity),
        first_sample=raw.first,
        counts=raw.counts,
    )


def feed_item_of(record: DropRecord, file: str) -> RecordedDrop | ImportedDrop:
    """Return the item by which a replay begins a recorded drop.

    Parameters
    ----------
    record : DropRecord
    file : str
        File that holds the drop, for messages.

    Returns
    -------
    RecordedDrop or ImportedDrop
        An imported drop has no record of its detection and is not detected again.

    Raises
    ------
    SetupError
        If the record of its detection is incomplete.
    """
    detection = record.metadata.get("detection")
    if record.counts is None or detection is None:
        return ImportedDrop(record, file)
    try:
        for start, length in record.metadata["missing"]:
            _ = operator.index(start) + operator.index(length)
        first = detection["first_sample"]
        # A trigger by operator or instrument is not detected again but set.
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
            f"drop {record.point}/{record.drop.number}: the record of its detection is incomplete: "
            f"{err}; the drop cannot be replayed"
        ) from err
