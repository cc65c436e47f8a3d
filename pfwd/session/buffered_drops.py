"""Drops that the instrument itself detects and buffers: trigger settings, conversion to raw drops.

Other instruments stream all samples, and this program detects the drops.
"""

import math
from dataclasses import replace

import numpy as np

from pfwd_device.acquisition.detection import AtRest, DetectionSettings, RawDrop
from pfwd_device.acquisition.items import BufferedDrop
from pfwd_device.calibration import counts_per_unit, load_channel
from pfwd_device.identity import Identity
from pfwd_device.wire.messages import Trigger

_MIN_SAMPLES_AT_REST = 8
"""Smallest number of samples before the trigger from which the load at rest is estimated."""
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


def marks_of_buffered(item: BufferedDrop) -> list[str]:
    """Return the irregularities that only buffered drops have, one phrase each."""
    marks = []
    if item.offer.shunt:
        marks.append("the calibration shunt was on")
    if item.offer.earlier:
        marks.append("buffered before the instrument restarted: its time is that of the transfer")
    return marks
