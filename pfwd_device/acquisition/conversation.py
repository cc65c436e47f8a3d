"""What to say to an instrument, and when; free of ports, threads and clocks.

Greet until it says what it is, set the rate if one is asked for, start it, and begin anew when it
was reset. An instrument that samples already is not started again: that would begin a new stream
and cost what it still has to send.
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

ANSWER_TIME = 4.0
"""s; an instrument that resets when its port is opened needs half of it."""
_GREET_EVERY = 0.3
_REQUEST_EVERY = 1.0
_LOOK_TIME = 0.75
"""s; the instrument says at least every half second whether it samples."""
_BLOCK_TIME = 0.3
"""s; a status may be older than the blocks around it by less."""
_PERMANENT = (RefusalCode.VERSION, RefusalCode.UNKNOWN, RefusalCode.ARGUMENT)


class Stage(Enum):
    """Where the conversation is."""

    CLOSED = auto()
    GREETING = auto()
    CONFIGURING = auto()
    LOOKING = auto()
    """Whether it samples still, after the link was cut."""
    STARTING = auto()
    RUNNING = auto()
    RESTING = auto()
    """No samples are wanted."""


class SampleAction(Enum):
    """What the driver has to do about the samples."""

    NOTHING = auto()
    SUSPEND = auto()
    """Let them wait: they may belong to other settings."""
    ACCEPT = auto()
    """The instrument is the right one and as it should be."""
    ACCEPT_ANEW = auto()
    """The same, but what waits was sampled with other settings."""


@dataclass(frozen=True, slots=True)
class Failure:
    """Why it came to nothing with this instrument."""

    reason: str
    """One sentence, with what to try."""
    refused: bool = False
    """It said no, and would again."""


class Conversation:
    """The host's side of the conversation.

    Parameters
    ----------
    sampling_rate : float or None, Hz
        What to ask for; None: as it is.
    serial_number : str or None
        The only instrument to talk to; None: the first that answers, from then on.
    sampling : bool
        Whether samples are wanted.
    answers : bool
        Whether the instrument listens at all.
    answer_time : float, s
        How long to wait for an answer.
    """

    def __init__(
        self,
        sampling_rate: float | None = None,
        serial_number: str | None = None,
        *,
        sampling: bool = True,
        answers: bool = True,
        answer_time: float = ANSWER_TIME,
    ) -> None:
        self.outbox: list[HostMessage] = []
        """What is to be said now; the driver takes it."""
        self.failure: Failure | None = None
        self.stage = Stage.CLOSED
        self._rate = sampling_rate
        self._settled_rate: float | None = None
        self._serial_number = serial_number
        self._wanted = sampling
        self._answers = answers
        self._answer_time = answer_time
        self._met = False
        self._ended = False
        self._greetings = 0
        """Not answered yet."""
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
        """Monotonic time of the next `tick`, s; None: nothing is waited for."""
        return None if self._next is None else min(self._next, self._deadline)

    def opened(self, now: float) -> None:
        """The link is there."""
        self.failure = None
        self._ended = False
        self._greetings = 0
        self._forget_samples()
        self._greet(now)

    def closed(self) -> None:
        """The link is gone."""
        self.outbox.clear()
        self._enter(Stage.CLOSED, 0.0)

    def request(self, message: HostMessage, now: float) -> SampleAction:
        """Take in a command of the user.

        Parameters
        ----------
        message : Start, Stop, Configure or Shunt
        now : float, s
        """
        talking = self.stage not in (Stage.CLOSED, Stage.GREETING)
        match message:
            case Start():
                self._wanted, self._ended = True, False
                if self.stage is Stage.RESTING and self._streams:
                    self._start(now)
            case Stop():
                self._wanted = False
                if talking:
                    self._rest(now)
                    self.outbox.append(message)
            case Configure(rate):
                self._rate, self._settled_rate = rate, None
                if talking and self._answers:
                    self._configure(now)
                    return SampleAction.SUSPEND
            case _:
                if self.stage is not Stage.CLOSED:
                    self.outbox.append(message)
        return SampleAction.NOTHING

    def tick(self, now: float, *, received_all: bool = True) -> None:
        """Say what is due, repeat what was not answered, or give up.

        Parameters
        ----------
        now : float, s
        received_all : bool
            Nothing waits to be received: what was not answered by now is late.
        """
        if self._next is None or self.due is None or now < self.due:
            return
        if now >= self._deadline:
            if received_all:
                self._give_up(now)
        elif self.stage is Stage.GREETING:
            self.outbox.append(Hello())
            self._greetings += 1
            self._next = now + _GREET_EVERY
        elif self.stage is Stage.CONFIGURING:
            self._say_rate()
            self._next = now + _REQUEST_EVERY
        elif self.stage is Stage.STARTING:
            self.outbox.append(Start())
            self._next = now + _REQUEST_EVERY
        else:
            self._next = self._deadline

    def receive(self, message: InstrumentMessage, now: float) -> SampleAction:
        """Take in a message, before its samples are handed on."""
        if self.stage is Stage.CLOSED:
            return SampleAction.NOTHING
        match message:
            case SampleBlock():
                return self._receive_block(message, now)
            case Identity():
                return self._receive_identity(message, now)
            case Status():
                return self._receive_status(message, now)
            case Event(kind=EventKind.BOOT):
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
        return SampleAction.NOTHING

    def _receive_block(self, block: SampleBlock, now: float) -> SampleAction:
        known = self._stream
        self._stream, self._last_block, self._sampling = block.stream, now, True
        if self.stage in (Stage.LOOKING, Stage.STARTING):
            self._enter(Stage.RUNNING, now)
        elif self.stage is Stage.RESTING and now >= self._quiet_until:
            self.outbox.append(Stop())  # the first one did not arrive
            self._quiet_until = now + _REQUEST_EVERY
        elif self.stage is Stage.RUNNING and known not in (None, block.stream) and self._answers:
            self._greet(now)  # it was reset: its settings may be others
            return SampleAction.SUSPEND
        return SampleAction.NOTHING

    def _receive_identity(self, identity: Identity, now: float) -> SampleAction:
        if self._serial_number not in (None, identity.serial_number):
            reason = (
                f"another instrument answers: {identity.serial_number}, waiting for "
                f"{self._serial_number}; connect that one or begin a new survey"
            )
            self.failure = Failure(reason)
            return SampleAction.SUSPEND
        wanted = self._settled_rate or self._rate
        if self.stage is Stage.GREETING:
            self._greetings -= 1
            if self._answers and wanted not in (None, identity.sampling_rate):
                self._configure(now)
                return SampleAction.SUSPEND
            return self._settle(identity, now, SampleAction.ACCEPT)
        if self.stage is Stage.CONFIGURING:
            if identity.sampling_rate != wanted and self._greetings > 0:
                self._greetings -= 1  # the answer to an earlier greeting
                return SampleAction.NOTHING
            self._settled_rate = identity.sampling_rate
            self._forget_samples()
            self._sampling = False
            return self._settle(identity, now, SampleAction.ACCEPT_ANEW)
        return SampleAction.NOTHING

    def _settle(self, identity: Identity, now: float, action: SampleAction) -> SampleAction:
        again, self._met = self._met, True
        self._serial_number = identity.serial_number
        self._streams = identity.streams
        if not (self._wanted and self._streams):
            self._rest(now)
        elif self._last_block is not None or not self._answers:
            self._enter(Stage.RUNNING, now)
        elif self._sampling is False or not again:
            self._start(now)
        else:
            self._enter(Stage.LOOKING, now, _LOOK_TIME, _LOOK_TIME)
        return action

    def _receive_status(self, status: Status, now: float) -> SampleAction:
        self._sampling = status.sampling
        if status.sampling:
            if self.stage in (Stage.LOOKING, Stage.STARTING):  # the first block may take long
                self._next = now + _REQUEST_EVERY
                self._deadline = now + self._answer_time
        elif self.stage is Stage.LOOKING and not self._ended:
            self._start(now)
        elif self.stage is Stage.RUNNING and self._has_stopped(now):
            self._forget_samples()
            self._sampling = False
            self._greet(now)
            return SampleAction.SUSPEND
        return SampleAction.NOTHING

    def _has_stopped(self, now: float) -> bool:
        """Whether an instrument that says it does not sample should, and has for a while."""
        quiet = self._last_block is None or now - self._last_block > _BLOCK_TIME
        return quiet and self._answers and not self._ended

    def _receive_refusal(self, refusal: Refusal) -> None:
        said = f": {refusal.text}" if refusal.text else ""
        self._last_refusal = f"it refused (code {refusal.code}{said})"
        what = {
            Stage.GREETING: "the greeting; its firmware and this program have no version in common",
            Stage.CONFIGURING: f"a sampling rate of {self._rate} Hz; ask for another one or none",
            Stage.STARTING: "to send samples; see its manual",
        }.get(self.stage)
        # A greeting may have met the end of noise: only the version is final.
        final = refusal.code in (_PERMANENT[:1] if self.stage is Stage.GREETING else _PERMANENT)
        if what and final:
            number = "" if self._serial_number is None else f" {self._serial_number}"
            reason = f"the instrument{number} refuses (code {refusal.code}{said}) {what}"
            self.failure = Failure(reason, refused=True)

    def _give_up(self, now: float) -> None:
        if self.stage is Stage.LOOKING:
            self._start(now)
            return
        expected = {
            Stage.GREETING: "the instrument to say what it is",
            Stage.CONFIGURING: "an answer to the sampling rate",
            Stage.STARTING: "samples",
        }[self.stage]
        came = self._last_refusal or "nothing of the kind"
        hint = "is it a PFWD, and switched on?"
        seconds = f"{self._answer_time:g} s"
        self.failure = Failure(f"expected {expected}, got {came} within {seconds}; {hint}")

    def _greet(self, now: float) -> None:
        self._enter(Stage.GREETING, now, 0.0, self._answer_time)

    def _configure(self, now: float) -> None:
        self._enter(Stage.CONFIGURING, now, _REQUEST_EVERY, self._answer_time)
        self._say_rate()

    def _say_rate(self) -> None:
        if self._rate is not None:
            if self._sampling is not False or self._last_refusal:  # some are busy while they sample
                self.outbox.append(Stop())
            self.outbox.append(Configure(self._rate))

    def _start(self, now: float) -> None:
        if self._ended:
            self._rest(now)
            return
        self._forget_samples()
        self._enter(Stage.STARTING, now, 0.0, self._answer_time)

    def _rest(self, now: float) -> None:
        self._enter(Stage.RESTING, now)
        self._quiet_until = now + _REQUEST_EVERY

    def _enter(
        self, stage: Stage, now: float, first: float | None = None, patience: float = 0.0
    ) -> None:
        self.stage = stage
        self._last_refusal = None
        self._next = None if first is None else now + first
        self._deadline = now + patience

    def _forget_samples(self) -> None:
        self._stream = self._last_block = self._sampling = None
