"""Drops that the instrument detects and buffers: settings of its trigger, conversion of a drop."""

import math
from dataclasses import replace

import numpy as np

from pfwd_device.acquisition.detection import AtRest, DetectionSettings, RawDrop
from pfwd_device.acquisition.items import BufferedDrop
from pfwd_device.calibration import counts_per_unit, load_channel
from pfwd_device.identity import Identity
from pfwd_device.wire.messages import Trigger

_MIN_SAMPLES_AT_REST = 8
"""Number of samples before the trigger from which the load at rest is estimated."""
_MIN_PRE_TRIGGER = 1e-9
"""Shortest time before the trigger, s; settings do not allow 0."""


def trigger_for(identity: Identity, settings: DetectionSettings) -> Trigger:
    """Return the trigger of the instrument that matches the settings of the detection.

    Parameters
    ----------
    identity : Identity
        With the values of the setup file.
    settings : DetectionSettings

    Raises
    ------
    SetupError
        If it has no load cell.
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


def raw_drop_of(item: BufferedDrop, trigger: Trigger | None, identity: Identity) -> RawDrop:
    """Return a buffered drop in the form that the detection here produces.

    Parameters
    ----------
    item : BufferedDrop
    trigger : Trigger or None
        How the instrument looks for drops now.
    identity : Identity
        Of the time when it fell.
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
    """Return the detection's settings with the times of a buffered drop, for its replay."""
    rate, offer = item.offer.sampling_rate, item.offer
    return replace(
        settings,
        pre_trigger=max(_MIN_PRE_TRIGGER, offer.trigger / rate),
        post_trigger=max(1, offer.samples - offer.trigger) / rate,
    )


def marks_of_buffered(item: BufferedDrop) -> list[str]:
    """Return irregularities beyond those of any record."""
    marks = []
    if item.offer.shunt:
        marks.append("the calibration shunt was on")
    if item.offer.earlier:
        marks.append("kept by the instrument over a reset: its time is that of its arrival")
    return marks
