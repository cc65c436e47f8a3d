"""What the host has stored of the calibration of a simulated instrument; it outlasts a reset."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from pfwd_device.errors import SetupError
from pfwd_device.identity import LONGEST_NAME, ChannelIdentity, Identity
from pfwd_device.wire.fields import day_of
from pfwd_device.wire.messages import Calibrate


@dataclass(frozen=True)
class StoredCalibration:
    """What is said in place of what the scenario declares; the samples stay as they are."""

    channels: dict[int, Calibrate] = field(default_factory=dict)
    serial_number: str = ""

    def applied(self, identity: Identity) -> Identity:
        """The identity with what is stored."""
        channels = list(identity.channels)
        for number, stored in self.channels.items():
            channels[number] = _calibrated(channels[number], stored)
        serial = self.serial_number or identity.serial_number
        return replace(identity, channels=tuple(channels), serial_number=serial)

    def with_one_more(self, wanted: Calibrate, identity: Identity) -> StoredCalibration:
        """With one channel more, or another value of it; `SetupError` when it is nonsense."""
        serial = wanted.serial_number
        sound = len(serial.encode()) <= LONGEST_NAME and serial.isascii() and serial.isprintable()
        if wanted.channel >= len(identity.channels) or not (sound or not serial):
            raise SetupError("channel or serial number")
        _calibrated(identity.channels[wanted.channel], wanted)
        return StoredCalibration(
            {**self.channels, wanted.channel: wanted}, serial or self.serial_number
        )


def _calibrated(channel: ChannelIdentity, stored: Calibrate) -> ChannelIdentity:
    try:
        calibrated, due = day_of(stored.calibrated), day_of(stored.due)
    except (ValueError, OverflowError) as err:
        raise SetupError(f"channel {channel.name!r}: no such day") from err
    return replace(
        channel,
        sensitivity=stored.sensitivity,
        zero=stored.zero,
        natural_frequency=stored.natural_frequency,
        damping=stored.damping,
        shunt=stored.shunt,
        calibrated=calibrated,
        due=due,
    )
