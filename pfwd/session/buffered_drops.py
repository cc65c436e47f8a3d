"""Drops that the instrument itself detects and buffers: settings, conversion, reports of lost ones.

Other instruments stream all samples, and this program detects the drops. Of an instrument that does
both, `StreamedDrops` are recorded only if the instrument has not buffered them.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from inversion.notices import Notice
from pfwd.session.events import DropsWaiting, Repeats, SessionNotice
from pfwd.session.survey_recorder import SurveyRecorder
from pfwd_device.acquisition.detection import AtRest, DetectionSettings, PulseReport, RawDrop
from pfwd_device.acquisition.items import BufferedDrop
from pfwd_device.calibration import counts_per_unit, load_channel
from pfwd_device.identity import Identity
from pfwd_device.recording.record import DropRecord, ReboundRecord
from pfwd_device.wire.messages import DropOffer, Status, Trigger

LOST_EVENT = "drops lost"
"""Event of a survey: drops that the instrument lost."""
_MIN_SAMPLES_AT_REST = 8
"""Smallest number of samples before the trigger from which the load at rest is estimated."""
OFFER_WAIT_S = 5.0
"""Time for which a drop in the stream waits for the instrument's own record, s of samples: an
instrument announces it at least every 0.5 s, and its transfer at 115200 baud takes 1 s."""
PULSE_RISE_S = 0.01
"""Time from the trigger of a pulse to its peak, s; a record may end between them."""
NOT_BUFFERED = Notice("not-buffered")
_MIN_PRE_TRIGGER = 1e-9
"""Shortest time before the trigger, s, in place of 0, which the settings of a detection refuse."""


def trigger_for(identity: Identity, settings: DetectionSettings) -> Trigger:
    """Return the instrument's trigger settings that correspond to the settings of the detection.

    Parameters
    ----------
    identity : Identity
        Identity of the instrument, with the values of the setup file.
    settings : DetectionSettings

    Raises
    ------
    SetupError
        If the instrument has no load cell.
    """
    channel = load_channel(identity)
    rate = identity.sampling_rate
    per_newton = abs(counts_per_unit(identity.channels[channel], identity))
    highest = 1 << (identity.adc_bits - 1)
    return Trigger(
        on=True,
        channel=channel,
        threshold=min(highest - 1, max(1, math.ceil(settings.threshold * per_newton))),
        confirm=max(2, round(settings.confirm * rate)),
        before=round(settings.pre_trigger * rate),
        after=max(1, round(settings.post_trigger * rate)),
        hold_off=round(settings.rebound_window * rate),
    )


def trigger_differences(requested: Trigger, answer: Trigger) -> str:
    """Return the settings, in counts and samples, in which an instrument's answer differs."""
    names = [each.name for each in fields(Trigger)]
    values = ((name, getattr(requested, name), getattr(answer, name)) for name in names)
    different = (each for each in values if each[1] != each[2])
    return ", ".join(f"{name}: expected {wanted:d}, got {got:d}" for name, wanted, got in different)


def raw_drop_of(item: BufferedDrop, trigger: Trigger | None, identity: Identity) -> RawDrop:
    """Convert a buffered drop to the form of a drop that this program detects.

    Parameters
    ----------
    item : BufferedDrop
    trigger : Trigger or None
        Present trigger settings of the instrument; None: not known.
    identity : Identity
        Identity of the instrument when the drop fell.
    """
    offer, counts = item.offer, item.counts
    load = counts[:, load_channel(identity)]
    before = load[: offer.trigger]
    at_rest = AtRest(0.0, 0.0)
    if len(before) >= _MIN_SAMPLES_AT_REST:
        steps = np.diff(before.astype(float))
        noise = math.sqrt(float(steps @ steps) / (2 * len(steps)))
        at_rest = AtRest(float(np.median(before)), noise)
    full = 1 << (identity.adc_bits - 1)
    over = (counts >= full - 1) | (counts <= -full)
    return RawDrop(
        stream=offer.stream,
        first=offer.first_sample,
        trigger=offer.trigger,
        counts=counts,
        missing=(),
        at_rest=at_rest,
        threshold=0.0 if offer.by_operator or trigger is None else float(trigger.threshold),
        by_operator=offer.by_operator,
        cut_off=None,
        saturated=tuple(
            (channel, int(count)) for channel, count in enumerate(over.sum(axis=0)) if count
        ),
    )


def settings_of(item: BufferedDrop, settings: DetectionSettings) -> DetectionSettings:
    """Return the settings of the detection with the pre-trigger and post-trigger of a buffered
    drop.

    With them a replay cuts the drop out of its samples in the same way.
    """
    rate, offer = item.offer.sampling_rate, item.offer
    return replace(
        settings,
        pre_trigger=max(_MIN_PRE_TRIGGER, offer.trigger / rate),
        post_trigger=max(1, offer.samples - offer.trigger) / rate,
    )


def marks_of_buffered(item: BufferedDrop) -> list[Notice]:
    """Return the irregularities that only buffered drops have."""
    marks = []
    if item.offer.shunt:
        marks.append(Notice("shunt-was-on"))
    if item.offer.earlier:
        marks.append(Notice("buffered-before-restart"))
    return marks


class UnrecordedDrops:
    """Reports of drops that an instrument lost, or stores at the end of a session.

    Parameters
    ----------
    report : callable
        Receives the messages.
    recorder : SurveyRecorder or None
        Survey that stores them as events; None: nothing is recorded.
    """

    def __init__(
        self, report: Callable[[SessionNotice], None], recorder: SurveyRecorder | None
    ) -> None:
        self._report = report
        self._recorder = recorder
        self._lost: dict[str, int] = {}
        """Number of drops lost by each instrument since its power-on, by serial number."""
        self._stored_events = Repeats()

    def restart(self, identity: Identity | None) -> None:
        """Expect that a restarted instrument counts its lost drops from 0 again."""
        if identity is not None:
            self._lost[identity.serial_number] = 0

    def compare(self, status: Status, identity: Identity | None) -> None:
        """Report the drops that an instrument lost since its last status.

        Parameters
        ----------
        status : Status
        identity : Identity or None
            None: the instrument is not known yet.
        """
        total = status.drops_lost
        if identity is None or total is None:
            return
        serial = identity.serial_number
        before = self._lost.get(serial)
        if before is None and self._recorder is not None:
            before = _last_recorded(self._recorder.writer.contents().events, serial)
        self._lost[serial] = total
        # After a power-on the instrument counts from 0 again.
        count = total if before is None or total < before else total - before
        if not count:
            return
        if self._recorder is not None and self._stored_events.due(LOST_EVENT) is not None:
            details = {"serial_number": serial, "drops": count, "since_power_on": total}
            self._recorder.keep_event(LOST_EVENT, details)
        older = "; they may be older than this survey" if before is None else ""
        text = (
            f"drops lost by the instrument {serial}: {count} ({total} since power-on{older}). Its "
            "memory was full, or its sampling was started again. Compare the recorded drops with "
            "those that fell, and repeat the missing ones"
        )
        self._report(SessionNotice(text, serious=True, kind="lost drops"))

    def report_waiting(self, status: Status, identity: Identity | None) -> None:
        """Report the drops that an instrument stores at the end of a session."""
        count = status.drops_waiting
        if not count:
            return
        serial = "" if identity is None else identity.serial_number
        if self._recorder is not None:
            self._recorder.keep_event("drops waiting", {"serial_number": serial, "drops": count})
        text = (
            f"drops that wait in the instrument and are not recorded: {count}. Measure with this "
            "survey again to record them"
        )
        if identity is None or not identity.lasting:
            text += ", and do not switch the instrument off before"
        self._report(DropsWaiting(text, serious=True))


def _last_recorded(events: Iterable[Mapping[str, Any]], serial_number: str) -> int | None:
    """Return the number of lost drops, since its power-on, in the last event of an instrument."""
    details = [each.get("details") for each in events if each.get("event") == LOST_EVENT]
    totals = [
        each.get("since_power_on")
        for each in details
        if isinstance(each, Mapping) and each.get("serial_number") == serial_number
    ]
    return totals[-1] if totals and type(totals[-1]) is int else None


@dataclass(frozen=True, eq=False, slots=True)
class StreamedItem:
    """Drop, or report of a pulse, in the stream of an instrument that detects drops itself."""

    stream: int
    trigger: int
    """Index of its trigger in the stream."""
    last: int
    """Index of the last sample of the drop above the threshold; of a report, its trigger."""
    due: float
    """Time from which it no longer waits, samples."""
    content: DropRecord | PulseReport
    received: float | None = None
    """Time at which the last sample of a drop arrived, s, monotonic clock."""
    rebounds: list[ReboundRecord] = field(default_factory=list)

    def is_in(self, offer: DropOffer) -> bool:
        """Return whether a record of the instrument contains the peaks of all its pulses."""
        rise = PULSE_RISE_S * offer.sampling_rate
        last = max(self.trigger + rise, self.last - rise) - offer.first_sample
        is_in_time = offer.first_sample <= self.trigger and last < offer.samples
        return self.stream == offer.stream and is_in_time


class StreamedDrops:
    """Drops and reports in the stream that wait for the instrument's own record of the drop."""

    def __init__(self) -> None:
        self._waiting: list[StreamedItem] = []
        self._buffered: deque[DropOffer] = deque(maxlen=256)

    def add(self, item: StreamedItem) -> None:
        """Let an item wait, unless the instrument's own record contains it already."""
        if not any(item.is_in(offer) for offer in self._buffered):
            self._waiting.append(item)

    def add_rebound(self, after: int, rebound: ReboundRecord) -> None:
        """Add a rebound to the drop whose trigger has the index `after`."""
        for item in self._waiting:
            if item.trigger == after:
                item.rebounds.append(rebound)

    def cover(self, offer: DropOffer) -> None:
        """Discard the items that a record of the instrument contains."""
        self._buffered.append(offer)
        self._waiting = [item for item in self._waiting if not item.is_in(offer)]

    def take_due(self, sampled: float) -> list[StreamedItem]:
        """Return and remove the items that have waited long enough.

        Parameters
        ----------
        sampled : float
            Number of samples since the session began.
        """
        due = [item for item in self._waiting if item.due <= sampled]
        self._waiting = [item for item in self._waiting if item.due > sampled]
        return due
