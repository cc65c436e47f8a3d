"""Identity of an instrument, the description that it reports of itself, and its form in JSON.

The identity consists of serial number, converter, channels with their calibration, load plate and
buffers. It is recorded with each drop.
"""

import dataclasses
import datetime
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pfwd_device.errors import SetupError
from pfwd_plugins.quantities import QUANTITY_BY_ROLE, Measurand

MAX_CHANNELS = 8
FASTEST_SAMPLING = 50_000.0
"""Highest sampling rate of a channel, Hz."""
LONGEST_NAME = 32
"""Characters of a name or a version."""


@dataclass(frozen=True, slots=True)
class ChannelIdentity:
    """One channel: measured quantity, position, and calibration from volts to SI values."""

    name: str
    """Name as printed on the instrument, at most 32 characters."""
    quantity: Measurand
    """Measured quantity."""
    offset: float = 0.0
    """Distance from the plate centre, m; 0 is the centre (and the load cell), negative the other
    side of the plate."""
    sensitivity: float = 1.0
    """V per N, V per m/s or V per m; not 0. A sensor that is mounted upside down has a negative
    one: downward is positive."""
    zero: float = 0.0
    """Volts at rest."""
    natural_frequency: float | None = None
    """Natural frequency of the geophone, Hz, > 0; None if its record needs no correction."""
    damping: float | None = None
    """Damping ratio of the geophone, > 0; given with the natural frequency or not at all."""
    shunt: float | None = None
    """Force that the calibration shunt of the load cell simulates, N; None without a shunt."""
    calibrated: datetime.date | None = None
    """Date of the calibration."""
    due: datetime.date | None = None
    """Date on which the calibration expires."""
    adc_range: float | None = None
    """Volts at full scale of this channel, > 0; None: that of the converter."""
    delay: float = 0.0
    """Time of its sample after the start of the scan, s, >= 0, for a converter that samples one
    channel after the other."""

    @property
    def is_used(self) -> bool:
        """True if the channel has a sensor."""
        return self.quantity is not Measurand.VOLTAGE

    def __post_init__(self) -> None:
        where = f"channel {self.name!r}"
        length = len(self.name)
        _require(length <= LONGEST_NAME, where, f"a name up to {LONGEST_NAME} letters", length)
        _require(math.isfinite(self.offset), where, "a finite offset, m", self.offset)
        sound = self.sensitivity != 0 and math.isfinite(self.sensitivity)
        _require(sound, where, "a finite sensitivity other than 0", self.sensitivity)
        _require(math.isfinite(self.zero), where, "a finite zero, V", self.zero)
        for name in ("natural_frequency", "damping", "shunt", "adc_range"):
            value = getattr(self, name)
            sound = value is None or (value > 0 and math.isfinite(value))
            _require(sound, where, f"{name} > 0", value)
        both = (self.natural_frequency is None) == (self.damping is None)
        _require(both, where, "natural_frequency and damping together", "one of them")


@dataclass(frozen=True, slots=True)
class Identity:
    """Description of an instrument; a field that is None was not declared."""

    serial_number: str
    """Unique to the instrument, at most 32 characters."""
    model: str
    """Name of the product, at most 32 characters."""
    firmware: str
    """Version of its firmware, at most 32 characters."""
    sampling_rate: float
    """Configured sampling rate of each channel, Hz, > 0."""
    adc_bits: int
    """Bits of the converter, 8 to 24; counts run from -2^(bits-1) to 2^(bits-1) - 1."""
    adc_range: float
    """Volts at full scale, > 0: the converter covers -range to +range."""
    channels: tuple[ChannelIdentity, ...]
    """1 to 8, in the order of the samples."""
    plate_radius: float | None = None
    """Radius of the load plate, m, > 0."""
    plate_mass: float | None = None
    """Mass between load cell and ground, kg, >= 0."""
    centre_sensor: Literal["plate", "ground"] = "plate"
    """Base of the sensor at offset 0."""
    protocol_version: int = 2
    """Version of the protocol."""
    ring_samples: int = 0
    """Number of the latest samples that can be requested again; 0: no buffer."""
    drop_samples: int = 0
    """Samples of the longest drop that the instrument can store; 0: it stores no drops."""
    drop_slots: int = 0
    """Number of drops that the instrument can store until the host has saved them."""
    lasting: bool = False
    """True if stored drops survive a reset."""
    streams: bool = True
    """True if it can send samples continuously."""
    real_time: bool = True
    """False if it is simulated faster or slower than real time."""

    @property
    def title(self) -> str:
        """Model, serial number and firmware, as far as they are declared."""
        firmware = f", firmware {self.firmware}" if self.firmware else ""
        return f"{self.model} {self.serial_number}".strip() + firmware

    def __post_init__(self) -> None:
        where = f"identity of {self.serial_number!r}"
        for name in ("serial_number", "model", "firmware"):
            length = len(getattr(self, name))
            _require(length <= LONGEST_NAME, where, f"{name} up to {LONGEST_NAME} letters", length)
        rate = self.sampling_rate
        fits = 0 < rate <= FASTEST_SAMPLING
        _require(fits, where, f"sampling_rate > 0 and <= {FASTEST_SAMPLING:g} Hz", rate)
        _require(8 <= self.adc_bits <= 24, where, "adc_bits from 8 to 24", self.adc_bits)
        _require(0 < self.adc_range < math.inf, where, "adc_range > 0 V", self.adc_range)
        for channel in self.channels:
            within = 0 <= channel.delay * rate <= 1
            _require(within, f"channel {channel.name!r}", "a delay within one scan", channel.delay)
        count = len(self.channels)
        _require(1 <= count <= MAX_CHANNELS, where, f"1 to {MAX_CHANNELS} channels", count)
        radius, mass = self.plate_radius, self.plate_mass
        _require(radius is None or 0 < radius < math.inf, where, "plate_radius > 0 m", radius)
        _require(mass is None or 0 <= mass < math.inf, where, "plate_mass >= 0 kg", mass)
        seat = self.centre_sensor
        _require(seat in ("plate", "ground"), where, 'centre_sensor "plate" or "ground"', seat)

    def volts_per_count(self, channel: ChannelIdentity) -> float:
        """Return the voltage that corresponds to one count of a channel, V."""
        full_scale = self.adc_range if channel.adc_range is None else channel.adc_range
        return full_scale / (1 << (self.adc_bits - 1))

    @property
    def keeps_drops(self) -> bool:
        """True if the instrument detects drops itself and stores them until the host saved them."""
        return self.drop_samples > 0 and self.drop_slots > 0

    @property
    def has_shunt(self) -> bool:
        """True if a channel has a calibration shunt."""
        return any(channel.shunt is not None for channel in self.channels)


def _require(holds: bool, where: str, expected: str, value: object) -> None:
    if not holds:
        raise SetupError(f"{where}: expected {expected}, got {value}")


_DATES = ("calibrated", "due")
"""Date fields of a channel, in JSON as ISO 8601 texts."""


def identity_as_dict(identity: Identity) -> dict[str, Any]:
    """Return all fields of an identity as JSON values, dates as ISO 8601 texts."""
    table = dataclasses.asdict(identity)
    table["channels"] = [_channel_as_dict(channel) for channel in identity.channels]
    return table


def _channel_as_dict(channel: ChannelIdentity) -> dict[str, Any]:
    values = dataclasses.asdict(channel) | {"quantity": channel.quantity.role}
    table = {"role" if name == "quantity" else name: value for name, value in values.items()}
    for name in _DATES:
        table[name] = table[name] and table[name].isoformat()
    return table


def identity_from_dict(table: Mapping[str, Any]) -> Identity:
    """Return an identity from its JSON values, the inverse of `identity_as_dict`.

    Raises
    ------
    SetupError
        If a field is missing or out of range.
    """
    try:
        channels = tuple(map(_channel_from_dict, table["channels"]))
        return Identity(**{**table, "channels": channels})
    except (AttributeError, KeyError, TypeError, ValueError) as err:
        if isinstance(err, SetupError):
            raise
        raise SetupError(
            f"recorded identity: expected the fields of Identity with valid values, got {err!r}"
        ) from err


def _channel_from_dict(table: Mapping[str, Any]) -> ChannelIdentity:
    dates = {
        name: datetime.date.fromisoformat(table[name]) if table.get(name) else None
        for name in _DATES
    }
    values = {name: value for name, value in table.items() if name != "role"} | dates
    return ChannelIdentity(quantity=QUANTITY_BY_ROLE[table["role"]], **values)
