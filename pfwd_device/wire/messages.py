"""What instrument and host say to each other, free of any encoding."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from pfwd_device.identity import Identity


@dataclass(frozen=True, slots=True)
class Hello:
    """Host: who are you, and which versions of the protocol do we share?"""

    oldest_version: int = 1
    newest_version: int = 1


@dataclass(frozen=True, slots=True)
class Configure:
    """Host: sample so fast. Answered by an `Identity` that holds what was really set."""

    sampling_rate: float
    """Hz per channel; the instrument takes the nearest it can."""


@dataclass(frozen=True, slots=True)
class Start:
    """Host: send samples. Answered by the first `SampleBlock`."""


@dataclass(frozen=True, slots=True)
class Stop:
    """Host: send no more samples."""


@dataclass(frozen=True, slots=True)
class Shunt:
    """Host: switch the calibration shunt of the load cell; samples tell by a flag."""

    on: bool


@dataclass(frozen=True, eq=False, slots=True)
class SampleBlock:
    """Instrument: consecutive samples of all channels."""

    stream: int
    """Random number of this run of the sampler, 32 bits; another one after a start or a reset."""
    first_sample: int
    """Index of the first sample within the stream, from 0."""
    clock_us: int | None
    """Clock of the instrument at the first sample, microseconds; None: it has none."""
    counts: NDArray[np.int32]
    """(n, channels)."""
    shunt: bool = False
    """The calibration shunt is on: these samples are no measurement."""


@dataclass(frozen=True, slots=True)
class Status:
    """Instrument: how it is, at least every half second, also when it does not sample."""

    clock_us: int
    """Clock of the instrument, microseconds."""
    battery_v: float | None
    """V."""
    temperature_c: float | None
    """Of the electronics, degrees Celsius."""
    overruns: int
    """Samples that the instrument itself has thrown away since it was switched on."""
    sampling: bool
    """Whether samples are being sent."""


class EventKind(IntEnum):
    """What an `Event` tells."""

    BOOT = 1
    """The instrument has just started."""
    TRIGGER = 2
    """The operator pressed the button: record now, whatever the load does."""
    LOW_BATTERY = 3
    """The battery will not last."""
    END = 4
    """There is nothing more to come (a replayed or simulated instrument)."""
    SHUNT_ON = 5
    SHUNT_OFF = 6


@dataclass(frozen=True, slots=True)
class Event:
    """Instrument: something happened."""

    kind: int
    """An `EventKind`, or a number that a newer instrument knows."""
    clock_us: int
    """When, by the clock of the instrument, microseconds."""
    text: str = ""
    """More, for people."""


class RefusalCode(IntEnum):
    """Why an instrument does not do what was asked."""

    VERSION = 1
    """No version in common."""
    UNKNOWN = 2
    """The message means nothing to it."""
    ARGUMENT = 3
    """A value is outside of its range."""
    BUSY = 4
    """Not now."""
    FAULT = 5
    """Something in it is broken."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """Instrument: no, or: I am broken."""

    code: int
    """A `RefusalCode`, or a number that a newer instrument knows."""
    text: str = ""
    """Why, for people."""


HostMessage = Hello | Configure | Start | Stop | Shunt
InstrumentMessage = Identity | SampleBlock | Status | Event | Refusal
Message = HostMessage | InstrumentMessage
