"""Simulated instrument without port and clock.

Its caller passes received bytes, takes bytes to send, and advances the simulated time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfwd_device.errors import SetupError
from pfwd_device.identity import FASTEST_SAMPLING, Identity
from pfwd_device.wire.binary import MAX_SAMPLE_BYTES
from pfwd_device.wire.identity_layout import VERSION
from pfwd_device.wire.messages import (
    DISARMED,
    Acknowledge,
    Arm,
    Armed,
    Calibrate,
    Configure,
    Event,
    EventKind,
    Fetch,
    Hello,
    HostMessage,
    InstrumentMessage,
    Refusal,
    RefusalCode,
    Released,
    Resend,
    SampleBlock,
    SamplesGone,
    Shunt,
    Start,
    Status,
    Stop,
    Trigger,
)
from simulators.instrument.faults import BadCable
from simulators.instrument.language import LANGUAGES
from simulators.instrument.memory import DropBuffer, Ring, StoredCalibration, split_block
from simulators.instrument.scenario import Fault, Scenario
from simulators.instrument.timeline import PAGE, Bench, Knock, Timeline
from simulators.instrument.units import UnitDrops, with_drawn_soil

MAX_BLOCK_S = 0.005
"""Longest time that the samples of a frame cover, s, so that a lost frame hides only part of a
pulse."""
MAX_SHUNT_S = 10.0
"""Time after which the shunt is switched off without a command, s."""
COMPUTE_AHEAD_S = 1.0
"""Time before the first touch of a drop at which its motion must have been computed, s; longer than
one cycle of the server."""
_STREAM = 7  # stream of random numbers


@dataclass(slots=True)
class _Stream:
    """Run of samples from a start or reset of the instrument to the next."""

    number: int
    """Random number that identifies the stream."""
    began: float
    """Simulated time at which it began, s."""
    origin: float
    """Duration of all earlier streams, s."""
    timeline: Timeline
    """Samples of the stream."""
    end: int | None
    """Number of samples after the last drop; None without a last drop."""
    index: int = 0
    """Index of the next sample."""


class PortlessInstrument:
    """Simulated instrument whose caller connects it to a port and to a clock.

    The caller passes the bytes of the host (`receive`), advances the time (`advance`), and takes
    the bytes to send (`output`, `sent`).

    Parameters
    ----------
    scenario : Scenario
        Description of soil, falling weight, instrument, link and faults.
    seed : int
        Seed of the random numbers.
    drops : int or None
        Number of drops before the end; None: no end.
    overruns : bool
        True: samples are lost if the caller does not take them in time. False: they wait without
        limit, and the caller must stop the time; the identity states that it is not real time.
    power_on : int, >= 0
        Seed of the stream numbers, which must be different at every start of an instrument.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int = 0,
        drops: int | None = None,
        overruns: bool = True,
        power_on: int = 0,
    ) -> None:
        self.scenario = with_drawn_soil(scenario, seed)
        self._seed, self._last_drop, self._power_on = seed, drops, power_on
        settings = self.scenario.drops
        seating = settings.seating if drops is None else settings.seating[:drops]
        self._bench = Bench(self.scenario, UnitDrops(self.scenario, (*seating, 1.0)), seed)
        self._rate = self.scenario.device.sampling_rate
        self._language = LANGUAGES[self.scenario.link.dialect](self._rate)
        self._cable = BadCable(self.scenario.link, seed)
        self._overruns_on = overruns
        self._due = list(self.scenario.faults_of(*(k for k in Fault.KEYS if k != "knock")))
        self._starts = 0
        self._drops_sent = 0
        self._truth: list[dict[str, Any]] = []
        self._sampled = 0.0
        self._bytes_per_sample = 3.0 * len(self.scenario.device.channels)
        self._stream: _Stream | None = None
        self._greeted = False
        self._sending = False
        link = self.scenario.link
        longest = max(link.ring, 2 * link.kept_seconds if link.kept_drops else 0.0)
        self._has_ring = longest > 0
        self._ring = Ring(math.ceil(longest * self._rate))
        self._drop_buffer = DropBuffer(link.kept_drops, self._shunt_shift())
        self._calibration = StoredCalibration()
        self.output = bytearray()
        """Bytes to send; `sent` removes them."""
        self.ended = False
        """True after the last message."""
        self.unplugged: Fault | None = None
        """Fault that unplugs the cable when the host has all bytes, until `plug`; None without."""
        self.time = 0.0
        """Time since the instrument was first switched on, s."""
        self._switch_on()

    def _switch_on(self) -> None:
        self._halt()
        self._drop_buffer.switched_off()
        self._on_since = self.time
        self._starts_since_power_on = 0
        self._clock_offset = self.scenario.device.clock_start_us
        self._overruns = 0
        self._shunt, self._shunt_until = False, math.inf
        self._stalled_until = -math.inf
        if self._drop_buffer.trigger.on:  # the trigger outlasts a reset
            self._run()

    @property
    def sampling(self) -> bool:
        """True while samples are taken, also if they are not sent."""
        return self._stream is not None

    @property
    def stalled(self) -> bool:
        """True while a fault prevents the instrument from sending."""
        return self.time < self._stalled_until

    @property
    def ready(self) -> bool:
        """True if the time can advance without a wait for the computation of the next drop."""
        stream, number = self._stream, self._drops_sent + 1
        if stream is None or (self._last_drop is not None and number > self._last_drop):
            return True
        remaining = stream.timeline.touch(number) - stream.index / self._rate
        soon = remaining < COMPUTE_AHEAD_S + PAGE / self._rate
        return not soon or self._bench.ready(self._bench.schedule.modulus_factor(number))

    # Actions of the host

    def connect(self) -> None:
        """Notify the instrument that a host has opened its port."""
        if not self._greeted:
            self._greeted = True
            self.output += self._cable.garbage(self.scenario.link.garbage_at_start)
        if self._language.starts_by_itself and not self.sampling and not self.ended:
            self._send(self._identity())
            self._start()

    def disconnect(self) -> None:
        """Notify the instrument that the host has closed the port.

        Bytes that the host did not read are lost. Sampling stops unless the instrument detects
        drops itself.
        """
        self._sending = False
        if not self._drop_buffer.trigger.on:
            self._halt()
        self._cable.release()
        self.output.clear()
        self.ended = self.ended or self._all_drops_sent()

    def receive(self, data: bytes) -> None:
        """Process bytes from the host; responses are appended to `output`."""
        for message in self._language.receive(data):
            self._answer(message)

    def _answer(self, message: HostMessage | None) -> None:
        match message:
            case Hello():
                self._greet(message)
            case Configure():
                self._configure(message.sampling_rate)
            case Start():
                if not self.scenario.link.streams:
                    self._refuse(
                        RefusalCode.UNKNOWN, "the instrument stores drops and sends no samples"
                    )
                elif self.ended:
                    self._refuse(RefusalCode.BUSY, "there are no more drops")
                else:
                    self._start()
            case Stop():
                self._sending = False
                if not self._drop_buffer.trigger.on:
                    self._halt()
                self.status()
                if self._all_drops_sent() and not self.ended:  # the host has all drops
                    self._send_end()
            case Shunt():
                self._switch_shunt(message.on)
            case Arm() | Fetch() | Acknowledge() | Resend():
                self._answer_buffer_request(message)
            case Calibrate():
                self._calibrate(message)
            case _:
                self._refuse(RefusalCode.UNKNOWN, "unknown message")

    def _greet(self, hello: Hello) -> None:
        if not hello.oldest_version <= VERSION <= hello.newest_version:
            self._refuse(RefusalCode.VERSION, f"this instrument supports version {VERSION}")
            return
        self._send(self._identity())
        self._drop_buffer.offer_oldest()
        self._offer()

    def _identity(self) -> Identity:
        link, identity = self.scenario.link, self.scenario.device.identity(self._rate)
        calibrated = self._calibration.applied(identity)
        return replace(
            calibrated,
            real_time=self._overruns_on,
            ring_samples=round(link.ring * self._rate),
            drop_samples=round(link.kept_seconds * self._rate) if link.kept_drops else 0,
            drop_slots=link.kept_drops,
            lasting=link.kept_drops > 0,
            streams=link.streams,
        )

    def _answer_buffer_request(self, message: Arm | Fetch | Acknowledge | Resend) -> None:
        match message:
            case Arm():
                self._arm(message.trigger)
            case Fetch():
                drop = self._drop_buffer.find(message.stream, message.first_sample)
                blocks = drop.blocks(message) if drop is not None else []
                if not blocks:
                    self._refuse(RefusalCode.ARGUMENT, "there is no such drop or block")
                for block in blocks:
                    self._send(block)
            case Acknowledge():
                self._drop_buffer.release(message.stream, message.first_sample)
                self._send(Released(message.stream, message.first_sample))
                self._offer()
            case Resend(count=0):
                self._refuse(RefusalCode.ARGUMENT, "expected a request for one sample or more")
            case Resend():
                for stored in self._ring.find_samples(message):
                    for part in (
                        [stored]
                        if isinstance(stored, SamplesGone)
                        else split_block(stored, self._block_samples())
                    ):
                        self._send(part)

    def _arm(self, trigger: Trigger) -> None:
        longest = self._identity().drop_samples
        sound = trigger.channel < len(self.scenario.device.channels) and (
            trigger.threshold and trigger.confirm and trigger.after
        )
        if not sound or (trigger.on and longest == 0):
            self._refuse(RefusalCode.ARGUMENT, "channel, threshold, confirm or after is invalid")
            return
        after = min(trigger.after, longest)
        before = min(trigger.before, longest - after)
        self._drop_buffer.trigger = replace(trigger, before=before, after=after)
        self._send(Armed(self._drop_buffer.trigger))
        if trigger.on and self._stream is None and not self.ended:
            self._run()
        elif not trigger.on and not self._sending:
            self._halt()

    def _calibrate(self, request: Calibrate) -> None:
        try:
            stored = self._calibration.with_channel(request, self._identity())
        except SetupError as err:
            self._refuse(RefusalCode.ARGUMENT, str(err)[:255])
            return
        if self._sending or self._shunt or self._drop_buffer.busy:
            reason = "stop sampling, switch off the shunt, and acknowledge stored drops first"
            self._refuse(RefusalCode.BUSY, reason)
            return
        self._calibration = stored
        self._send(self._identity())

    def _offer(self) -> None:
        """Send the announcement of a stored drop to the host, if there is one."""
        if (offer := self._drop_buffer.next_offer()) is not None:
            self._send(offer)

    def _configure(self, requested_rate: float) -> None:
        if self._sending:
            self._refuse(RefusalCode.BUSY, "stop sampling first")
        elif not 0 < requested_rate <= FASTEST_SAMPLING:  # false for NaN too
            self._refuse(
                RefusalCode.ARGUMENT, f"a sampling rate of {requested_rate:g} Hz is impossible"
            )
        else:
            rates = self.scenario.device.sampling_rates
            self._rate = min(rates, key=lambda rate: (abs(rate - requested_rate), rate))
            self._drop_buffer.trigger = DISARMED
            self._halt()
            self._send(self._identity())

    def _switch_shunt(self, on: bool) -> None:
        if all(channel.shunt is None for channel in self.scenario.device.channels):
            self._refuse(RefusalCode.ARGUMENT, "the instrument has no calibration shunt")
            return
        self._shunt = on
        self._shunt_until = self.time + MAX_SHUNT_S
        self._event(EventKind.SHUNT_ON if on else EventKind.SHUNT_OFF)

    def _watch_shunt(self) -> None:
        if self._shunt and self.time >= self._shunt_until:
            self._switch_shunt(False)

    def _halt(self) -> None:
        if self._stream is not None:
            self._sampled += self._stream.index / self._rate
            self._stream = None
        self._sending = False

    def _start(self) -> None:
        if not self._drop_buffer.trigger.on or self._stream is None:
            self._run()
        self._sending = True

    def _run(self) -> None:
        """Begin a new stream of samples."""
        self._halt()
        self._ring.begin()
        self._drop_buffer.begin()
        self._starts += 1
        sources = [self._seed, _STREAM, self._starts, self._power_on]
        number = int(np.random.default_rng(sources).integers(1 << 32))
        self._starts_since_power_on += 1
        if not self.scenario.device.random_streams:
            number = self._starts_since_power_on
        knocks = tuple(
            Knock(fault.at_s - self._sampled, fault.load)
            for fault in self.scenario.faults_of("knock")
        )
        first = self._drops_sent + 1
        timeline = Timeline(self._bench, self._rate, first, self._last_drop, knocks)
        end = timeline.end_index()
        self._stream = _Stream(number, self.time, self._sampled, timeline, end)

    # Time

    def advance(self, seconds: float) -> None:
        """Advance the simulated time and append the samples of this time to `output`.

        The time advances less if a fault unplugs the cable meanwhile; see `unplugged`.
        """
        until = self.time + seconds
        while self._stream is not None and self.unplugged is None:
            stream = self._stream
            if stream.end is not None and stream.index >= stream.end:
                self._end(stream)
                break
            stop = stream.index + self._block_samples()
            if stream.end is not None:
                stop = min(stop, stream.end)
            if self._due:
                at = math.ceil((self._due[0].at_s - stream.origin) * self._rate - 1e-6)
                if at <= stream.index:
                    self.time = max(self.time, stream.began + stream.index / self._rate)
                    self._happen(self._due.pop(0))
                    continue
                stop = min(stop, at)  # a block of samples ends where a fault happens
            if stream.began + stop / self._rate > until + 1e-9:
                break
            self.time = max(self.time, stream.began + stream.index / self._rate)
            self._watch_shunt()
            self._emit(stream, stop)
        if self.unplugged is None:
            self.time = max(self.time, until)
            self._watch_shunt()

    def pass_unplugged(self, seconds: float) -> None:
        """Advance the time while the cable is unplugged; samples in this time are lost."""
        self.time += seconds
        stream = self._stream
        if stream is not None:
            index = math.floor((self.time - stream.began) * self._rate)
            index = index if stream.end is None else min(index, stream.end - 1)
            self._skip(stream, max(0, index - stream.index))

    def plug(self) -> None:
        """Plug the cable in again; after a loss of power the instrument restarts."""
        fault, self.unplugged = self.unplugged, None
        self._cable.release()
        self.output.clear()
        if fault is not None and not fault.powered:
            self._switch_on()
            self._event(EventKind.BOOT)

    def _block_samples(self) -> int:
        max_samples = MAX_SAMPLE_BYTES // (3 * len(self.scenario.device.channels))
        samples = self.scenario.link.block_samples or math.ceil(MAX_BLOCK_S * self._rate)
        return min(samples, max_samples)

    def _emit(self, stream: _Stream, stop: int) -> None:
        """Send and store the samples before the index `stop`; lose them if the output is full."""
        room = self.scenario.link.buffer * self._rate * self._bytes_per_sample
        if self._overruns_on and self._sending and len(self.output) > room:
            self._overruns += stop - stream.index
            self._skip(stream, stop - stream.index)
            return
        counts = stream.timeline.counts(stream.index, stop)
        if self._shunt:
            full = 1 << (self.scenario.device.adc_bits - 1)
            counts = np.clip(counts + self._shunt_shift(), -full, full - 1)
        clock = self._clock_us(stream.began + stream.index / self._rate)
        block = SampleBlock(stream.number, stream.index, clock, counts, self._shunt)
        if self._sending:
            frame = self._language.frame(block)
            self._bytes_per_sample = len(frame) / len(counts)
            self.output += self._cable.carry(frame)
        self._skip(stream, stop - stream.index)
        if self._has_ring:
            self._ring.add(block)
            if self._drop_buffer.take(block, self._ring, self._rate):
                self._offer()

    def _skip(self, stream: _Stream, count: int) -> None:
        stream.index += count
        self._note_drops(stream)

    def _shunt_shift(self) -> NDArray[np.int32]:
        """Return the counts that the calibration shunt adds to each channel, (channels,)."""
        device = self.scenario.device
        full = 1 << (device.adc_bits - 1)
        volts = [channel.sensitivity * (channel.shunt or 0.0) for channel in device.channels]
        return np.rint(np.array(volts) * full / device.adc_range).astype(np.int32)

    def _note_drops(self, stream: _Stream) -> None:
        """Store the true values of the drops whose samples have begun."""
        while self._last_drop is None or self._drops_sent < self._last_drop:
            number = self._drops_sent + 1
            index = stream.timeline.touch_index(number)
            if index >= stream.index:
                break
            self._drops_sent = number
            where = {
                "stream": stream.number,
                "touch_sample": index,
                "touch_s": stream.timeline.touch(number),
            }
            self._truth.append({**self._bench.truth(number), **where})

    def _end(self, stream: _Stream) -> None:
        self.time = stream.began + stream.index / self._rate
        self._halt()
        self._send_end()

    def _all_drops_sent(self) -> bool:
        return self._last_drop is not None and self._drops_sent >= self._last_drop

    def _send_end(self) -> None:
        self._event(EventKind.END)
        self.output += self._cable.release()
        self.ended = True

    # Faults

    def _happen(self, fault: Fault) -> None:
        match fault.kind:
            case "lost" | "repeated" | "reordered" | "bit-errors":
                self._cable.order(fault.kind, fault.count)
            case "garbage":
                self.output += self._cable.garbage(fault.count)
            case "overrun":
                if self._stream is not None:
                    self._overruns += fault.count
                    self._skip(self._stream, fault.count)
            case "stall":
                self._stalled_until = self.time + fault.seconds
            case "clock-jump":
                self._clock_offset += round(fault.seconds * 1e6)
            case "reset":
                self._switch_on()
                self._event(EventKind.BOOT)
                if self._language.starts_by_itself:
                    self._start()
            case "unplug":
                self.unplugged = fault
                if not fault.powered:
                    self._halt()
            case "trigger":
                self._event(EventKind.TRIGGER)
            case "low-battery":
                self._event(EventKind.LOW_BATTERY)

    # Messages of the instrument

    def status(self) -> None:
        """Append a status message to `output`; call it at least every half second of real time."""
        device = self.scenario.device
        clock = self._clock_us(self.time)
        drops = len(self._drop_buffer.waiting), self._drop_buffer.lost
        health = device.battery, device.temperature
        self._send(Status(clock, *health, self._overruns, self._sending, *drops))
        self._offer()

    def sent(self, count: int) -> None:
        """Remove the first bytes of `output`, which have been sent."""
        del self.output[:count]

    def _clock_us(self, time: float) -> int:
        drift = 1 + 1e-6 * self.scenario.device.clock_drift_ppm
        return max(0, self._clock_offset + round((time - self._on_since) * drift * 1e6))

    def _event(self, kind: EventKind) -> None:
        self._send(Event(kind, self._clock_us(self.time), self.scenario.device.message))

    def _refuse(self, code: RefusalCode, reason: str) -> None:
        self._send(Refusal(code, reason))

    def _send(self, message: InstrumentMessage) -> None:
        self.output += self._cable.carry(self._language.frame(message), samples=False)

    # True values, which are not sent

    def truth(self) -> list[dict[str, Any]]:
        """Return the true values of each drop so far, in SI units, with the units in the keys."""
        return list(self._truth)
