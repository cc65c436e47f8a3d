"""State machine of the dialogue with an instrument, seen from the computer that reads it.

It requests the identity (greeting), sets the sampling rate if one is requested, starts the
sampling, and does so again after a reset of the instrument. An instrument that already samples is
not started again, because a start begins a new stream and discards samples that are not sent yet.

The state machine has no port, thread or clock of its own: times are arguments, and messages to send
are appended to a list.
"""

from dataclasses import dataclass
from enum import Enum, auto

from pfwd_device.identity import Identity
from pfwd_device.wire.messages import (
    Configure,
    Event,
    EventKind,
    Hello,
    HostMessage,
    InstrumentMessage,
    Refusal,
    RefusalCode,
    SampleBlock,
    Start,
    Status,
    Stop,
)

RESPONSE_TIMEOUT_S = 4.0
"""Longest wait for a response, s: twice the time of an instrument that resets when its port is
opened."""
_GREETING_INTERVAL_S = 0.3
_REQUEST_INTERVAL_S = 1.0
STATUS_TIMEOUT_S = 0.75
"""Longest wait for a status, s: an instrument sends one at least every half second."""
_MAX_STATUS_AGE_S = 0.3
"""Time since the last block of samples after which the status "does not sample" is believed, s."""
_PERMANENT_REFUSALS = (RefusalCode.VERSION, RefusalCode.UNKNOWN, RefusalCode.ARGUMENT)


class Stage(Enum):
    """State of the dialogue with the instrument."""

    CLOSED = auto()
    """The link is closed."""
    GREETING = auto()
    """Waiting for the identity."""
    CONFIGURING = auto()
    """Waiting for the confirmation of the sampling rate."""
    LOOKING = auto()
    """Waiting, after the link was cut, for samples or a status that reports whether the instrument
    still samples."""
    STARTING = auto()
    """Waiting for the first samples after a start."""
    RUNNING = auto()
    """Samples arrive."""
    RESTING = auto()
    """No samples are requested."""


class SampleAction(Enum):
    """Instruction to the driver on the treatment of received samples."""

    NO_ACTION = auto()
    """Continue as before."""
    SUSPEND = auto()
    """Let samples wait: they may belong to other settings."""
    ACCEPT = auto()
    """Accept the identity: instrument and settings are the requested ones."""
    ACCEPT_NEW_SETTINGS = auto()
    """Accept the identity and discard waiting samples: they were taken with other settings."""


@dataclass(frozen=True, slots=True)
class Failure:
    """Failure of the dialogue, after which the link has to be closed."""

    reason: str
    """Reason and remedy, one sentence."""
    refused: bool = False
    """True if the instrument refused a command for a reason that a repetition does not change."""


class Conversation:
    """State machine that decides which message the host sends to the instrument next.

    Parameters
    ----------
    sampling_rate : float or None, Hz
        Requested rate; None: the present rate of the instrument.
    serial_number : str or None
        Serial number of the only instrument to accept. None: the first that responds, and from
        then on no other.
    sampling : bool
        True: request samples.
    accepts_commands : bool
        False for an instrument that only sends.
    response_timeout : float, s
        Longest wait for a response.
    """

    def __init__(
        self,
        sampling_rate: float | None = None,
        serial_number: str | None = None,
        *,
        sampling: bool = True,
        accepts_commands: bool = True,
        response_timeout: float = RESPONSE_TIMEOUT_S,
    ) -> None:
        self.outbox: list[HostMessage] = []
        """Messages to send; the driver removes them."""
        self.failure: Failure | None = None
        self.stage = Stage.CLOSED
        self._rate = sampling_rate
        self._settled_rate: float | None = None
        self._serial_number = serial_number
        self._sampling_requested = sampling
        self._accepts_commands = accepts_commands
        self._response_timeout = response_timeout
        self._was_connected = False
        self._ended = False
        self._greetings = 0
        """Number of greetings without a response."""
        self._quiet_until = 0.0
        self._next: float | None = None
        self._deadline = 0.0
        self._last_refusal: str | None = None
        self._stream: int | None = None
        self._last_block: float | None = None
        self._sampling: bool | None = None
        self._streams = True

    @property
    def due(self) -> float | None:
        """Monotonic time at which to call `tick` next, s; None if nothing is due."""
        return None if self._next is None else min(self._next, self._deadline)

    def opened(self, now: float) -> None:
        """Begin the dialogue after the link was opened; `now` is the monotonic time, s."""
        self.failure = None
        self._ended = False
        self._greetings = 0
        self._forget_samples()
        self._greet(now)

    def closed(self) -> None:
        """End the dialogue after the link was closed."""
        self.outbox.clear()
        self._enter(Stage.CLOSED, 0.0)

    def request(self, message: HostMessage, now: float) -> SampleAction:
        """Process a command of the user and return what the driver has to do with samples.

        Parameters
        ----------
        message : Start, Stop, Configure or Shunt
        now : float, s
            Monotonic time.
        """
        talking = self.stage not in (Stage.CLOSED, Stage.GREETING)
        match message:
            case Start():
                self._sampling_requested, self._ended = True, False
                if self.stage is Stage.RESTING and self._streams:
                    self._start(now)
            case Stop():
                self._sampling_requested = False
                if talking:
                    self._rest(now)
                    self.outbox.append(message)
            case Configure(rate):
                self._rate, self._settled_rate = rate, None
                if talking and self._accepts_commands:
                    self._configure(now)
                    return SampleAction.SUSPEND
            case _:
                if self.stage is not Stage.CLOSED:
                    self.outbox.append(message)
        return SampleAction.NO_ACTION

    def tick(self, now: float, *, received_all: bool = True) -> None:
        """Append due messages to the outbox, repeat unanswered ones, or fail after the timeout.

        Parameters
        ----------
        now : float, s
            Monotonic time.
        received_all : bool
            True if all received bytes are decoded. Only then is a response that is missing late.
        """
        if self._next is None or self.due is None or now < self.due:
            return
        if now >= self._deadline:
            if received_all:
                self._give_up(now)
        elif self.stage is Stage.GREETING:
            self.outbox.append(Hello())
            self._greetings += 1
            self._next = now + _GREETING_INTERVAL_S
        elif self.stage is Stage.CONFIGURING:
            self._request_rate()
            self._next = now + _REQUEST_INTERVAL_S
        elif self.stage is Stage.STARTING:
            self.outbox.append(Start())
            self._next = now + _REQUEST_INTERVAL_S
        else:
            self._next = self._deadline

    def receive(self, message: InstrumentMessage, now: float) -> SampleAction:
        """Process a message of the instrument and return what the driver has to do with samples.

        Parameters
        ----------
        message : InstrumentMessage
        now : float, s
            Monotonic time.
        """
        if self.stage is Stage.CLOSED:
            return SampleAction.NO_ACTION
        match message:
            case SampleBlock():
                return self._receive_block(message, now)
            case Identity():
                return self._receive_identity(message, now)
            case Status():
                return self._receive_status(message, now)
            case Event(kind=EventKind.BOOT | EventKind.STOPPED):
                self._forget_samples()
                self._sampling = False
                self._greet(now)
                return SampleAction.SUSPEND
            case Event(kind=EventKind.END):
                self._ended = True
            case Refusal():
                self._receive_refusal(message)
            case Event():
                pass
        return SampleAction.NO_ACTION

    def _receive_block(self, block: SampleBlock, now: float) -> SampleAction:
        previous_stream = self._stream
        self._stream, self._last_block, self._sampling = block.stream, now, True
        if self.stage in (Stage.LOOKING, Stage.STARTING):
            self._enter(Stage.RUNNING, now)
        elif self.stage is Stage.RESTING and now >= self._quiet_until:
            self.outbox.append(Stop())  # the earlier Stop did not arrive
            self._quiet_until = now + _REQUEST_INTERVAL_S
        elif (
            self.stage is Stage.RUNNING
            and previous_stream not in (None, block.stream)
            and self._accepts_commands
        ):
            self._greet(now)  # the instrument was reset: its settings may have changed
            return SampleAction.SUSPEND
        return SampleAction.NO_ACTION

    def _receive_identity(self, identity: Identity, now: float) -> SampleAction:
        if self._serial_number not in (None, identity.serial_number):
            reason = (
                f"expected the instrument {self._serial_number}, got {identity.serial_number}; "
                f"connect {self._serial_number} or begin a new survey"
            )
            self.failure = Failure(reason)
            return SampleAction.SUSPEND
        requested_rate = self._settled_rate or self._rate
        if self.stage is Stage.GREETING:
            self._greetings -= 1
            if self._accepts_commands and requested_rate not in (None, identity.sampling_rate):
                self._configure(now)
                return SampleAction.SUSPEND
            return self._settle(identity, now, SampleAction.ACCEPT)
        if self.stage is Stage.CONFIGURING:
            if identity.sampling_rate != requested_rate and self._greetings > 0:
                self._greetings -= 1  # the response to an earlier greeting
                return SampleAction.NO_ACTION
            self._settled_rate = identity.sampling_rate
            self._forget_samples()
            self._sampling = False
            return self._settle(identity, now, SampleAction.ACCEPT_NEW_SETTINGS)
        return SampleAction.NO_ACTION

    def _settle(self, identity: Identity, now: float, action: SampleAction) -> SampleAction:
        was_connected, self._was_connected = self._was_connected, True
        self._serial_number = identity.serial_number
        self._streams = identity.streams
        if not (self._sampling_requested and self._streams):
            self._rest(now)
        elif self._last_block is not None or not self._accepts_commands:
            self._enter(Stage.RUNNING, now)
        elif self._sampling is False or not was_connected:
            self._start(now)
        else:
            self._enter(Stage.LOOKING, now, STATUS_TIMEOUT_S, STATUS_TIMEOUT_S)
        return action

    def _receive_status(self, status: Status, now: float) -> SampleAction:
        self._sampling = status.sampling
        if status.sampling:
            if self.stage in (Stage.LOOKING, Stage.STARTING):  # the first block may be late
                self._next = now + _REQUEST_INTERVAL_S
                self._deadline = now + self._response_timeout
        elif self.stage is Stage.LOOKING and not self._ended:
            self._start(now)
        elif self.stage is Stage.RUNNING and self._has_stopped(now):
            self._forget_samples()
            self._sampling = False
            self._greet(now)
            return SampleAction.SUSPEND
        return SampleAction.NO_ACTION

    def _has_stopped(self, now: float) -> bool:
        """Return True if an instrument that should sample does not.

        A status may be older than the blocks received with it, so a recent block outweighs it.
        """
        quiet = self._last_block is None or now - self._last_block > _MAX_STATUS_AGE_S
        return quiet and self._accepts_commands and not self._ended

    def _receive_refusal(self, refusal: Refusal) -> None:
        detail = f": {refusal.text}" if refusal.text else ""
        self._last_refusal = f"a refusal (code {refusal.code}{detail})"
        command = {
            Stage.GREETING: "the protocol versions of this program; update firmware or program",
            Stage.CONFIGURING: f"a sampling rate of {self._rate} Hz; request another one or none",
            Stage.STARTING: "to send samples; see its manual",
        }.get(self.stage)
        if refusal.code == RefusalCode.UNSUITABLE:
            self.failure = Failure(refusal.text, refused=True)
            return
        # During the greeting the instrument may have taken noise on the line for a command. So
        # only a refusal of the version is final then.
        final = refusal.code in (
            _PERMANENT_REFUSALS[:1] if self.stage is Stage.GREETING else _PERMANENT_REFUSALS
        )
        if command and final:
            number = "" if self._serial_number is None else f" {self._serial_number}"
            reason = f"the instrument{number} refuses (code {refusal.code}{detail}) {command}"
            self.failure = Failure(reason, refused=True)

    def _give_up(self, now: float) -> None:
        if self.stage is Stage.LOOKING:
            self._start(now)
            return
        expected = {
            Stage.GREETING: "the identity of the instrument",
            Stage.CONFIGURING: "a confirmation of the sampling rate",
            Stage.STARTING: "samples",
        }[self.stage]
        response = self._last_refusal or "no response"
        hint = (
            "check that it is the declared instrument and switched on, and that no other program "
            "uses the port"
        )
        seconds = f"{self._response_timeout:g} s"
        self.failure = Failure(f"expected {expected}, got {response} within {seconds}; {hint}")

    def _greet(self, now: float) -> None:
        self._enter(Stage.GREETING, now, 0.0, self._response_timeout)

    def _configure(self, now: float) -> None:
        self._enter(Stage.CONFIGURING, now, _REQUEST_INTERVAL_S, self._response_timeout)
        self._request_rate()

    def _request_rate(self) -> None:
        if self._rate is not None:
            # Some instruments refuse a rate while they sample.
            if self._sampling is not False or self._last_refusal:
                self.outbox.append(Stop())
            self.outbox.append(Configure(self._rate))

    def _start(self, now: float) -> None:
        if self._ended:
            self._rest(now)
            return
        self._forget_samples()
        self._enter(Stage.STARTING, now, 0.0, self._response_timeout)

    def _rest(self, now: float) -> None:
        self._enter(Stage.RESTING, now)
        self._quiet_until = now + _REQUEST_INTERVAL_S

    def _enter(
        self, stage: Stage, now: float, first: float | None = None, patience: float = 0.0
    ) -> None:
        self.stage = stage
        self._last_refusal = None
        self._next = None if first is None else now + first
        self._deadline = now + patience

    def _forget_samples(self) -> None:
        self._stream = self._last_block = self._sampling = None
