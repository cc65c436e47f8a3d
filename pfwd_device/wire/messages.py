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
    newest_version: int = 2


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


@dataclass(frozen=True, slots=True)
class Trigger:
    """When the instrument itself finds a drop and how much of it is kept.

    From the host: find drops so, or none; from the instrument: what was really set.
    """

    on: bool
    """Whether drops are looked for."""
    channel: int
    """Whose counts are looked at."""
    threshold: int
    """Counts away from rest."""
    confirm: int
    """Samples for which the counts have to stay beyond half of the threshold."""
    before: int
    """Samples kept before the trigger."""
    after: int
    """Samples kept from the trigger on."""
    hold_off: int
    """For so many samples after a drop only a larger one begins another."""


@dataclass(frozen=True, slots=True)
class Arm:
    """Host: find drops yourself and keep them. Answered by `Armed`."""

    trigger: Trigger


@dataclass(frozen=True, slots=True)
class Fetch:
    """Host: send these blocks of a drop that waits. Answered by `DropBlock`."""

    stream: int
    first_sample: int
    first_block: int = 0
    blocks: int = 0
    """How many; 0: all up to the last."""


@dataclass(frozen=True, slots=True)
class Acknowledge:
    """Host: this drop is safe on the disk, forget it. Answered by `Released`."""

    stream: int
    first_sample: int


@dataclass(frozen=True, slots=True)
class Resend:
    """Host: send these samples of the stream again. Answered by `SampleBlock`, `SamplesGone`."""

    stream: int
    first_sample: int
    count: int


@dataclass(frozen=True, slots=True)
class Calibrate:
    """Host: keep this calibration of a channel. Answered by an `Identity` with it."""

    channel: int
    """From 0, in the order of the samples."""
    sensitivity: float
    """V per N, m/s or m; not 0."""
    zero: float
    """Volts at rest."""
    natural_frequency: float | None = None
    """Hz, > 0, with the damping or not at all."""
    damping: float | None = None
    shunt: float | None = None
    """What the calibration shunt simulates, N, > 0."""
    calibrated: int = 0
    """Day of the calibration as yyyymmdd; 0: not said. A number, since an instrument has to refuse
    one that is no day."""
    due: int = 0
    """Day on which it expires, likewise."""
    serial_number: str = ""
    """Of the instrument; empty: it stays as it is."""


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
    drops_waiting: int | None = None
    """Drops that wait to be acknowledged; None: not said (version 1)."""
    drops_lost: int | None = None
    """Drops for which there was no room since it was switched on; None: not said."""


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


@dataclass(frozen=True, slots=True)
class Armed:
    """Instrument: drops are looked for so."""

    trigger: Trigger


@dataclass(frozen=True, slots=True)
class DropOffer:
    """Instrument: a drop waits here; fetch it and acknowledge it when it is safe."""

    stream: int
    """Number of the run of the sampler."""
    first_sample: int
    """Index of the first sample within the run; with the number of the run the drop's name."""
    clock_us: int | None
    """Clock of the instrument at the trigger, microseconds; None: not known any more."""
    trigger: int
    """Samples before time 0."""
    samples: int
    """How many there are."""
    channels: int
    block_samples: int
    """Samples in each block but the last."""
    crc: int
    """CRC-32 of the counts of all samples as they travel, 3 bytes each."""
    sampling_rate: float
    """Hz per channel, when the drop fell."""
    shunt: bool = False
    """The calibration shunt was on for a part of it or all of it."""
    by_operator: bool = False
    """Triggered by the button of the instrument."""
    earlier: bool = False
    """From before the last reset: its clock is not the one of now."""

    @property
    def blocks(self) -> int:
        """How many blocks it comes in."""
        return -(-self.samples // self.block_samples)


@dataclass(frozen=True, eq=False, slots=True)
class DropBlock:
    """Instrument: a piece of a drop that waits."""

    stream: int
    first_sample: int
    """Both together name the drop."""
    number: int
    """Of the block within the drop, from 0."""
    data: bytes
    """Counts as they travel: 3 bytes each, channel by channel of each sample."""


@dataclass(frozen=True, slots=True)
class Released:
    """Instrument: this drop is not kept any more, or never was."""

    stream: int
    first_sample: int


@dataclass(frozen=True, slots=True)
class SamplesGone:
    """Instrument: these samples cannot be sent again."""

    stream: int
    first_sample: int
    count: int


HostMessage = (
    Hello | Configure | Start | Stop | Shunt | Arm | Fetch | Acknowledge | Resend | Calibrate
)
InstrumentMessage = (
    Identity
    | SampleBlock
    | Status
    | Event
    | Refusal
    | Armed
    | DropOffer
    | DropBlock
    | Released
    | SamplesGone
)
Message = HostMessage | InstrumentMessage
