"""A feed that says what is written out in the test, and drops whose shape is known here."""

import datetime
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfwd.judging import SurveyView
from pfwd.session.events import SessionEvent, SessionNotice
from pfwd.session.feeds import Ended, FeedItem
from pfwd.session.live_view import apply_event
from pfwd.session.plan import Ending, SessionPlan
from pfwd.session.session import Session
from pfwd_device.acquisition.items import Connected, Disconnected, Gap, Samples, StreamBegan
from pfwd_device.errors import StorageFull
from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_device.recording import DropRecord, ReboundRecord, SurveyWriter, read_survey
from pfwd_device.wire.messages import DropOffer, Status
from pfwd_plugins.quantities import Measurand

RATE = 10_000
NOW = datetime.datetime(2026, 5, 4, 12, 0, tzinfo=datetime.UTC)
# 24 bits over 8 V: a count of the load is 1 N, one of the geophone a micrometre per second.
VOLTS_PER_COUNT = 8.0 / 2**23
LOAD = ChannelIdentity("load", Measurand.LOAD, sensitivity=VOLTS_PER_COUNT)
GEOPHONE = ChannelIdentity(
    "g0", Measurand.VELOCITY, sensitivity=1e6 * VOLTS_PER_COUNT, natural_frequency=4.5, damping=0.6
)
IDENTITY = Identity(
    serial_number="T-1",
    model="Test",
    firmware="1.0",
    sampling_rate=RATE,
    adc_bits=24,
    adc_range=8.0,
    channels=(LOAD, GEOPHONE),
    plate_radius=0.15,
    plate_mass=10.0,
)


def stream(
    seconds: float, pulses: Iterable[tuple[float, float]] = (), seed: int = 1
) -> NDArray[np.int32]:
    """Counts of an instrument at rest with half-sines of (s, N), 15 ms long.

    The velocity is the derivative of a half-sine of 20 ms that goes down 0.4 mm under 8 kN.
    """
    rng = np.random.default_rng(seed)
    count = round(seconds * RATE)
    load = 20.0 + 3.0 * rng.standard_normal(count)
    velocity = 30.0 * rng.standard_normal(count)
    for at, peak in pulses:
        start = round(at * RATE)
        load[start : start + 150] += peak * np.sin(np.pi * np.arange(150) / 150)
        deflection = 400.0 * peak / 8000.0  # micrometres
        bend = deflection * np.pi / 0.02 * np.cos(np.pi * np.arange(200) / 200)
        velocity[start + 5 : start + 205] += bend
    return np.rint(np.column_stack([load, velocity])).astype(np.int32)


def pieces(
    counts: NDArray[np.int32], number: int = 7, first: int = 0, chunk: int = 500, **more: Any
) -> list[FeedItem]:
    """Consecutive samples in parts."""
    shunt = bool(more.get("shunt", False))
    return [
        Samples(number, first + at, counts[at : at + chunk], shunt, float(at) / RATE, NOW)
        for at in range(0, len(counts), chunk)
    ]


def with_gaps(items: Sequence[FeedItem], gaps: Sequence[tuple[int, int]]) -> list[FeedItem]:
    """The same with samples (index, length) missing."""
    result: list[FeedItem] = []
    for item in items:
        assert isinstance(item, Samples)
        position = item.first
        end = item.first + len(item.counts)
        for start, length in gaps:
            low, high = max(position, start), min(end, start + length)
            if low >= high:
                continue
            if low > position:
                part = item.counts[position - item.first : low - item.first]
                result.append(Samples(item.stream, position, part, False, 0.0, item.time_utc))
            result.append(Gap(item.stream, low, high - low))
            position = high
        if position < end:
            part = item.counts[position - item.first :]
            result.append(Samples(item.stream, position, part, False, 0.0, item.time_utc))
    return result


def connected(identity: Identity = IDENTITY, *, again: bool = False) -> Connected:
    return Connected("script://", identity, NOW, again)


def lost() -> Disconnected:
    return Disconnected("unplugged; plug it in again", NOW)


def began(number: int = 7) -> StreamBegan:
    return StreamBegan(number)


class ScriptedFeed:
    """Says items one by one; a callable among them is called when its turn comes."""

    def __init__(self, *parts: Any, live: bool = True, forever: bool = False) -> None:
        self.live = live
        self.lost_since: float | None = None
        self.shunts: list[bool] = []
        self.acknowledged: list[tuple[int, int]] = []
        self.last_status: Status | None = None
        self.closed = False
        self.session: Any = None
        self.hushed = 0
        self._forever = forever
        self._items: list[Any] = []
        for part in parts:
            self._items += part if isinstance(part, list) else [part]

    def next(self, timeout: float) -> FeedItem | None:
        if self._items:
            item = self._items.pop(0)
            if callable(item):
                item()
                return None
            return item  # type: ignore[no-any-return]
        self.hushed += 1
        return None if self._forever else Ended()

    def shunt(self, on: bool) -> None:
        self.shunts.append(on)

    def acknowledge(self, offer: DropOffer) -> None:
        self.acknowledged.append((offer.stream, offer.first_sample))

    def settle(self) -> Status | None:
        return self.last_status

    def counters(self) -> dict[str, float | None]:
        return {"samples_lost": 3, "drift_ppm": None}

    def close(self) -> None:
        self.closed = True


class Log(list[SessionEvent]):
    """A listener that keeps what it is told."""

    def __call__(self, event: SessionEvent) -> None:
        self.append(event)

    def of(self, kind: type) -> list[Any]:
        return [event for event in self if isinstance(event, kind)]

    @property
    def texts(self) -> str:
        return "\n".join(event.text for event in self.of(SessionNotice))


class Publisher:
    """Gives listeners events, each followed by the survey that it makes, as a session does."""

    def __init__(self, *listeners: Callable[[Any], object]) -> None:
        self.view = SurveyView()
        self._listeners = listeners

    def __call__(self, event: SessionEvent) -> None:
        change = apply_event(self.view, event)
        self.view = self.view if change is None else change.view
        for listener in self._listeners:
            listener(event)
            if change is not None:
                listener(change)


class SpyWriter:
    """A survey's writer that says in `log` what was saved, and fails when it is told to."""

    def __init__(self, writer: SurveyWriter, log: Log) -> None:
        self._writer = writer
        self._log = log
        self.failures = 0
        self.saved: list[tuple[str, int]] = []
        self.published: list[int] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._writer, name)

    def save_drop(self, record: DropRecord) -> int:
        if self.failures:
            self.failures -= 1
            raise StorageFull("disk: expected room, got none")
        number = self._writer.save_drop(record)
        self.saved.append((record.point, record.drop.number))
        self._log.append(("saved", record.point, record.drop.number))  # type: ignore[arg-type]
        return number

    def save_rebound(self, number: int, rebound: ReboundRecord) -> None:
        self._writer.save_rebound(number, rebound)

    def publish(self, number: int) -> None:
        self.published.append(number)
        self._writer.publish(number)


def run(
    feed: ScriptedFeed, log: Log, writer: Any = None, *, options: Any = None, **plan: Any
) -> Ending:
    """The ending of a session without inversion; what the feed calls may use its `session`."""
    feed.session = Session(feed, log, SessionPlan(options=options, **plan), writer)
    return feed.session.run()


ONE_DROP = stream(3.0, [(1.0, 8000.0)])


def recorded(writer: Any) -> list[Any]:
    return [drop.read() for drop in read_survey(writer.folder).drops]
