"""Messages between the instrument and the host, independent of their encoding.

The host is the computer that reads the instrument. The docstring of a message names its
sender. Terms:

- A stream is a run of samples from a start or reset of the instrument to the next. It has a random
  number, and its samples are counted from 0.
- A drop in the memory of the instrument is identified by its stream and its first sample.
- A block is a part of the samples that fits into one message.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from pfwd_device.identity import Identity


@dataclass(frozen=True, slots=True)
class Hello:
    """Request of the host for the identity of the instrument, with the versions it supports."""

    oldest_version: int = 2
    newest_version: int = 2


@dataclass(frozen=True, slots=True)
class Configure:
    """Request of the host: set the sampling rate. The response is an `Identity` with it."""

    sampling_rate: float
    """Requested rate of each channel, Hz; the instrument sets the nearest possible one."""


@dataclass(frozen=True, slots=True)
class Start:
    """Request of the host: begin to send samples. The response is the first `SampleBlock`."""


@dataclass(frozen=True, slots=True)
class Stop:
    """Request of the host: stop sending samples."""


@dataclass(frozen=True, slots=True)
class Shunt:
    """Request of the host: switch the calibration shunt of the load cell on or off.

    The shunt is a resistor that simulates a known load. `SampleBlock.shunt` reports its state.
    """

    on: bool


@dataclass(frozen=True, slots=True)
class Trigger:
    """Settings of the drop detection inside the instrument.

    The host sends the requested settings, the instrument the settings in force.
    """

    on: bool
    """True if drops are detected."""
    channel: int
    """Index of the monitored channel."""
    threshold: int
    """Deviation from the value at rest that triggers a drop, counts."""
    confirm: int
    """Number of samples for which the counts must exceed half of the threshold."""
    before: int
    """Number of stored samples before the trigger."""
    after: int
    """Number of stored samples from the trigger on."""
    hold_off: int
    """Number of samples after a drop within which only a larger pulse is a new drop."""


DISARMED = Trigger(False, 0, 1, 1, 0, 1, 0)
"""Settings that switch the drop detection off."""


@dataclass(frozen=True, slots=True)
class Arm:
    """Request of the host: detect drops and store them. The response is `Armed`."""

    trigger: Trigger


@dataclass(frozen=True, slots=True)
class Fetch:
    """Request of the host: send blocks of a stored drop. Each is returned as a `DropBlock`."""

    stream: int
    first_sample: int
    """Index of the first sample of the drop; stream and index identify the drop."""
    first_block: int = 0
    blocks: int = 0
    """Number of blocks; 0: all up to the last."""


@dataclass(frozen=True, slots=True)
class Acknowledge:
    """Request of the host: delete a stored drop, which is safe on the disk.

    The response is `Released`.
    """

    stream: int
    first_sample: int
    """Index of the first sample of the drop; stream and index identify the drop."""


@dataclass(frozen=True, slots=True)
class Resend:
    """Request of the host: send samples of a stream again, as far as the instrument still has them.

    The responses are a `SampleBlock` for available samples and `SamplesGone` for the others.
    """

    stream: int
    first_sample: int
    """Index of the first requested sample within the stream."""
    count: int
    """Number of requested samples."""


@dataclass(frozen=True, slots=True)
class Calibrate:
    """Request of the host: store a calibration of a channel.

    The response is an `Identity` that contains it.
    """

    channel: int
    """Index of the channel from 0, in the order of the samples."""
    sensitivity: float
    """V per N, m/s or m; not 0."""
    zero: float
    """Volts at rest."""
    natural_frequency: float | None = None
    """Natural frequency, Hz, > 0; declared together with the damping."""
    damping: float | None = None
    shunt: float | None = None
    """Force that the calibration shunt simulates, N, > 0."""
    calibrated: int = 0
    """Day of the calibration as yyyymmdd; 0: not declared. It is a number so that a test can send
    an invalid day, which an instrument must refuse."""
    due: int = 0
    """Day of expiry as yyyymmdd; 0: not declared."""
    serial_number: str = ""
    """New serial number of the instrument; empty: no change."""


@dataclass(frozen=True, eq=False, slots=True)
class SampleBlock:
    """Message of the instrument: samples of all channels without a gap between them."""

    stream: int
    """Random number of this run of the sampler, 32 bits; another one after a start or a reset."""
    first_sample: int
    """Index of the first sample within the stream, from 0."""
    clock_us: int | None
    """Clock of the instrument at the first sample, microseconds; None without a clock."""
    counts: NDArray[np.int32]
    """Counts, (n, channels)."""
    shunt: bool = False
    """True if the calibration shunt is on: these samples are no measurement."""


@dataclass(frozen=True, slots=True)
class Status:
    """Message of the instrument: report of its state.

    It is sent at least every half second, also without sampling.
    """

    clock_us: int
    """Clock of the instrument, microseconds."""
    battery_v: float | None
    """Voltage of the battery, V."""
    temperature_c: float | None
    """Temperature of the electronics, degrees Celsius."""
    overruns: int
    """Number of samples that the instrument has discarded since it was switched on."""
    sampling: bool
    """True while samples are sent."""
    drops_waiting: int | None = None
    """Number of stored drops that are not acknowledged; None: not known."""
    drops_lost: int | None = None
    """Number of drops for which there was no room since it was switched on; None: not known."""


class EventKind(IntEnum):
    """Kind of event that an instrument reports by `Event`."""

    BOOT = 1
    """The instrument has just started."""
    TRIGGER = 2
    """The operator pressed the button: record now, independent of the load."""
    LOW_BATTERY = 3
    """The battery is nearly empty."""
    END = 4
    """End of the data of a replayed or simulated instrument."""
    SHUNT_ON = 5
    SHUNT_OFF = 6
    STOPPED = 256
    """The instrument stopped by itself, or its samples are out of order; it is started again. No
    instrument sends this number: a dialect concludes it."""


@dataclass(frozen=True, slots=True)
class Event:
    """Message of the instrument: report of an event, such as a restart or a pressed button."""

    kind: int
    """An `EventKind`, or a number of a newer version."""
    clock_us: int
    """Clock of the instrument at the event, microseconds."""
    text: str = ""
    """Details as text."""


class RefusalCode(IntEnum):
    """Reason why an instrument refuses a command."""

    VERSION = 1
    """Instrument and host have no version of the protocol in common."""
    UNKNOWN = 2
    """The instrument does not have the command."""
    ARGUMENT = 3
    """A value is out of range."""
    BUSY = 4
    """The command is not possible at present."""
    FAULT = 5
    """The instrument has a fault."""
    UNSUITABLE = 256
    """The setup asks for what this instrument does not have. No instrument sends this number: a
    dialect concludes it."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """Message of the instrument: refusal of a command, or report of a fault."""

    code: int
    """A `RefusalCode`, or a number of a newer version."""
    text: str = ""
    """Reason as text."""


@dataclass(frozen=True, slots=True)
class Armed:
    """Message of the instrument: the settings of the drop detection in force."""

    trigger: Trigger


@dataclass(frozen=True, slots=True)
class DropOffer:
    """Message of the instrument: announcement of a stored drop.

    The host requests its samples by `Fetch` and deletes it by `Acknowledge` when it is on the disk.
    """

    stream: int
    """Number of the stream in which the drop was recorded."""
    first_sample: int
    """Index of the first sample within the stream; stream and index identify the drop."""
    clock_us: int | None
    """Clock of the instrument at the trigger, microseconds; None if it is unknown."""
    trigger: int
    """Number of samples before time 0."""
    samples: int
    """Number of samples."""
    channels: int
    block_samples: int
    """Samples in each block but the last."""
    crc: int
    """CRC-32 of the counts of all samples as they are sent, 3 bytes each."""
    sampling_rate: float
    """Sampling rate of each channel at the time of the drop, Hz."""
    shunt: bool = False
    """True if the calibration shunt was on for a part of the drop or all of it."""
    by_operator: bool = False
    """True if the button of the instrument triggered it."""
    earlier: bool = False
    """True if it was recorded before the last reset, by another run of the clock."""

    @property
    def blocks(self) -> int:
        """Number of blocks in which the drop is sent."""
        return -(-self.samples // self.block_samples)


@dataclass(frozen=True, eq=False, slots=True)
class DropBlock:
    """Message of the instrument: a block of samples of a stored drop, the response to `Fetch`."""

    stream: int
    first_sample: int
    """Index of the first sample of the drop; stream and index identify the drop."""
    number: int
    """Number of the block within the drop, from 0."""
    data: bytes
    """Counts as they are sent: 3 bytes each, the channels of each sample together."""


@dataclass(frozen=True, slots=True)
class Released:
    """Message of the instrument: a drop is not stored, because it was deleted or never existed."""

    stream: int
    first_sample: int
    """Index of the first sample of the drop; stream and index identify the drop."""


@dataclass(frozen=True, slots=True)
class SamplesGone:
    """Message of the instrument: requested samples of a stream are no longer available."""

    stream: int
    first_sample: int
    """Index of the first unavailable sample within the stream."""
    count: int
    """Number of unavailable samples."""


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
