"""Encoding of the identity of an instrument as bytes of the binary protocol.

docs/protocol.md has the byte tables.
"""

import datetime
import struct

from pfwd_device.errors import SetupError
from pfwd_device.identity import LONGEST_NAME, ChannelIdentity, Identity
from pfwd_device.wire.fields import (
    BYTE,
    Reader,
    day,
    day_of,
    decode_optional,
    encode_optional,
    text,
)
from pfwd_plugins.quantities import Measurand

VERSION = 2
"""Version of the protocol."""

_CONVERTER = struct.Struct("<dBdddBB")
_CHANNEL = struct.Struct("<BddddddII")
_BUFFERS = struct.Struct("<IIHB")
"""Samples of the ring, samples of the longest drop, drop slots, flags."""
_LASTING, _STREAMS, _OTHER_SPEED = 1, 2, 4
_QUANTITY_BY_CODE = {quantity.code: quantity for quantity in Measurand}
_SEATS = ("plate", "ground")


def pack_identity(identity: Identity) -> bytes:
    """Return an identity as the bytes of a message's payload."""
    converter = _CONVERTER.pack(
        identity.sampling_rate,
        identity.adc_bits,
        identity.adc_range,
        encode_optional(identity.plate_radius),
        encode_optional(identity.plate_mass),
        _SEATS.index(identity.centre_sensor),
        len(identity.channels),
    )
    names = (identity.serial_number, identity.model, identity.firmware)
    channels = map(_pack_channel, identity.channels)
    version = BYTE.pack(identity.protocol_version)
    flags = _LASTING * identity.lasting + _STREAMS * identity.streams
    flags += _OTHER_SPEED * (not identity.real_time)
    slots = identity.drop_slots
    buffers = _BUFFERS.pack(identity.ring_samples, identity.drop_samples, slots, flags)
    return b"".join([version, *map(text, names), converter, *channels, buffers])


def _pack_channel(channel: ChannelIdentity) -> bytes:
    return text(channel.name) + _CHANNEL.pack(
        channel.quantity.code,
        channel.offset,
        channel.sensitivity,
        channel.zero,
        encode_optional(channel.natural_frequency),
        encode_optional(channel.damping),
        encode_optional(channel.shunt),
        day(channel.calibrated),
        day(channel.due),
    )


def read_identity(payload: bytes) -> Identity:
    """Return the identity that the bytes of a message's payload contain.

    Raises
    ------
    struct.error
        If the payload is too short.
    SetupError
        If a value is out of range, or the version is another one.
    """
    reader = Reader(payload)
    (version,) = reader.fields(BYTE)
    if version != VERSION:
        raise SetupError(f"expected version {VERSION} of the protocol, got {version}")
    serial_number, model, firmware = (reader.text(LONGEST_NAME) for _ in range(3))
    rate, bits, volts, radius, mass, seat, count = reader.fields(_CONVERTER)
    channels = tuple(_read_channel(reader) for _ in range(count))
    ring, longest, slots, flags = reader.fields(_BUFFERS)
    return Identity(
        serial_number=serial_number,
        model=model,
        firmware=firmware,
        sampling_rate=rate,
        adc_bits=bits,
        adc_range=volts,
        plate_radius=decode_optional(radius),
        plate_mass=decode_optional(mass),
        centre_sensor="ground" if seat == 1 else "plate",
        channels=channels,
        protocol_version=version,
        ring_samples=ring,
        drop_samples=longest,
        drop_slots=slots,
        lasting=bool(flags & _LASTING),
        streams=bool(flags & _STREAMS),
        real_time=not flags & _OTHER_SPEED,
    )


def _read_channel(reader: Reader) -> ChannelIdentity:
    name = reader.text(LONGEST_NAME)
    code, offset, sensitivity, zero, frequency, damping, shunt, calibrated, due = reader.fields(
        _CHANNEL
    )
    return ChannelIdentity(
        name=name,
        # A role of a newer version is unknown to this program, so it ignores the channel.
        quantity=_QUANTITY_BY_CODE.get(code, Measurand.VOLTAGE),
        offset=offset,
        sensitivity=sensitivity,
        zero=zero,
        natural_frequency=decode_optional(frequency),
        damping=decode_optional(damping),
        shunt=decode_optional(shunt),
        calibrated=_day_of(calibrated, name, "calibrated"),
        due=_day_of(due, name, "due"),
    )


def _day_of(number: int, channel: str, field: str) -> datetime.date | None:
    try:
        return day_of(number)
    except ValueError as err:
        where = f"channel {channel!r}: {field}"
        raise SetupError(f"{where}: expected a day as yyyymmdd or 0, got {number}") from err
