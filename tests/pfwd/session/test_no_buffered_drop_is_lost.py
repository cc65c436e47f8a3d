"""Whatever drops an instrument keeps, and whatever is lost on the way: what it erases is recorded.

The instrument is the keeper of the simulator behind a link that delays and loses messages; time is
counted in tenths of a second and passes in no time.
"""

import itertools
import tempfile
import zlib
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pfwd.session.buffered_drops import trigger_for
from pfwd.session.plan import SessionPlan
from pfwd.session.session import Session
from pfwd_device.acquisition.drop_transfers import DropTransfers
from pfwd_device.acquisition.items import BufferedDrop, Counters, UnusableDrop
from pfwd_device.recording import DropRecord, SurveyWriter, read_survey
from pfwd_device.wire.fields import pack_int24
from pfwd_device.wire.messages import Acknowledge, Armed, DropBlock, DropOffer, Fetch, Released
from simulators.instrument.memory import DropBuffer, WaitingDrop
from tests.pfwd import scripted_feed
from tests.pfwd.judging.stories import UnsyncedStorage
from tests.pfwd.scripted_feed import IDENTITY, Log, ScriptedFeed
from tests.records import known

TICK = 0.1
"""s."""
STATUS_EVERY = 5
"""Ticks between two Offers of a drop that waits."""
MAX_LOST = 3
"""Messages in a row: the order of the drops of a name is known from their first eight Offers."""
SLOWEST = 4
"""Ticks that a message takes at most: an answer comes within 1 s."""

FromInstrument = DropOffer | DropBlock | Released


@dataclass(frozen=True)
class Fallen:
    """A drop that the instrument finds."""

    name: int
    """First sample; drops share it, because names are used repeatedly."""
    samples: int
    trigger: int
    rate: float
    channels: int
    seed: int

    def to_waiting(self) -> WaitingDrop:
        # Not the same samples cut or sampled in another way: one of the two could stand for both.
        rng = np.random.default_rng([self.seed, self.trigger, round(self.rate)])
        counts = rng.integers(-1000, 1000, (self.samples, self.channels), np.int32)
        data = pack_int24(counts)
        trigger = min(self.trigger, self.samples)
        each = max(1, -(-self.samples // 3))
        size = trigger, self.samples, self.channels, each
        offer = DropOffer(1, self.name, None, *size, zlib.crc32(data), self.rate)
        return WaitingDrop(offer, data)


def is_usable(offer: DropOffer) -> bool:
    """Return whether a replay can detect the recorded drop."""
    after = max(1, offer.samples - offer.trigger)
    return (
        offer.channels == len(IDENTITY.channels)
        and offer.trigger + after >= 16
        and max(offer.trigger, after) <= 10 * offer.sampling_rate
    )


class Instrument:
    """Keeps drops, offers them, and notes what it was told to erase."""

    def __init__(self) -> None:
        self.keeper = DropBuffer(100, np.zeros(2, np.int32))
        self.erased: list[WaitingDrop] = []

    def take(self, message: object) -> Sequence[FromInstrument]:
        match message:
            case Fetch(stream, first):
                waiting = self.keeper.find(stream, first)
                return waiting.blocks(message) if waiting is not None else []
            case Acknowledge(stream, first):
                waiting = self.keeper.find(stream, first)
                if waiting is not None:
                    self.erased.append(waiting)
                self.keeper.release(stream, first)
                return [Released(stream, first), *self.offer()]
        return []

    def offer(self) -> list[FromInstrument]:
        offer = self.keeper.next_offer()
        return [] if offer is None else [offer]


class Host:
    """The host's part, from its start to its end."""

    def __init__(self, folder: Path, log: Log) -> None:
        self.writer = SurveyWriter.open(
            folder, publish=False, reserve_bytes=0, storage=UnsyncedStorage()
        )
        self.transfers = DropTransfers(Counters())
        self.transfers.channels = len(IDENTITY.channels)
        self.log = log
        self.time = 0.0
        feed = ScriptedFeed(forever=True)
        feed.acknowledge = lambda offer: self.transfers.acknowledge(offer, self.time)  # type: ignore[method-assign]
        self.session = Session(feed, log, SessionPlan(options=None), self.writer)
        self.session._take(scripted_feed.connected())
        self.session._take(Armed(trigger_for(IDENTITY, self.session._plan.setup.device.detection)))

    def take(self, message: FromInstrument, time: float) -> None:
        self.time = time
        item = self.transfers.take(message, time, None)
        if isinstance(item, BufferedDrop | UnusableDrop):
            self.session._take(item)

    def say(self, time: float) -> list[object]:
        self.transfers.tick(time)
        messages, self.transfers.outbox = self.transfers.outbox, []
        return list(messages)

    def end(self) -> None:
        self.writer.close()


class Way:
    """One direction of the link: in order, late, and with losses."""

    def __init__(self, delays: Sequence[int]) -> None:
        self._delays = itertools.cycle(delays)
        self._under_way: deque[tuple[int, object]] = deque()
        self.losing = 0

    def put(self, message: object, tick: int) -> None:
        if self.losing:
            self.losing -= 1
            return
        arrives = tick + next(self._delays)
        if self._under_way:
            arrives = max(arrives, self._under_way[-1][0])
        self._under_way.append((arrives, message))

    def take(self, tick: int) -> list[object]:
        arrived = []
        while self._under_way and self._under_way[0][0] <= tick:
            arrived.append(self._under_way.popleft()[1])
        return arrived

    def cut(self) -> None:
        self._under_way.clear()


def first_of_names(instrument: Instrument) -> list[WaitingDrop]:
    """The drops that wait, but for those behind another one of their name: it alone is fetched."""
    first = {waiting.offer.first_sample: waiting for waiting in reversed(instrument.keeper.waiting)}
    return list(first.values())


fallen = st.builds(
    Fallen,
    name=st.sampled_from([0, 5]),
    samples=st.sampled_from([1, 15, 16, 40, 700]),
    trigger=st.sampled_from([0, 5, 10, 600]),
    rate=st.sampled_from([50.0, 10_000.0]),
    channels=st.sampled_from([2, 2, 2, 3]),
    seed=st.integers(0, 2),
)
step = st.one_of(
    fallen, st.sampled_from(["wait", "wait", "lose to", "lose from", "restart", "cut", "power"])
)


@settings(max_examples=50, deadline=None)
@given(
    steps=st.lists(step, max_size=20),
    to_delays=st.lists(st.integers(0, SLOWEST), min_size=1, max_size=4),
    from_delays=st.lists(st.integers(0, SLOWEST), min_size=1, max_size=4),
)
def test_each_erased_drop_is_in_the_survey_once(
    steps: list[Fallen | str], to_delays: list[int], from_delays: list[int]
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        survey = Path(folder) / "survey"
        log, instrument = Log(), Instrument()
        outward, back = Way(to_delays), Way(from_delays)
        host = Host(survey, log)
        everything: list[WaitingDrop] = []
        tick = 0

        def pass_time(ticks: int) -> None:
            nonlocal tick
            for _ in range(ticks):
                tick += 1
                answers = [
                    answer
                    for messages in outward.take(tick)
                    for answer in instrument.take(messages)
                ]
                if tick % STATUS_EVERY == 0:
                    answers += instrument.offer()
                for answer in answers:
                    back.put(answer, tick)
                for message in back.take(tick):
                    host.take(message, tick * TICK)  # type: ignore[arg-type]
                for messages in host.say(tick * TICK):
                    outward.put(messages, tick)

        def reconnect() -> None:
            outward.cut()
            back.cut()
            instrument.keeper.offer_oldest()

        for each in steps:
            match each:
                case Fallen():
                    everything.append(each.to_waiting())
                    instrument.keeper.waiting.append(everything[-1])
                case "lose to":
                    outward.losing = min(MAX_LOST, outward.losing + 1)
                case "lose from":
                    back.losing = min(MAX_LOST, back.losing + 1)
                case "restart":
                    host.end()
                    reconnect()
                    host = Host(survey, log)
                case "cut":
                    host.transfers.cut()
                    reconnect()
                case "power":
                    host.transfers.cut()
                    reconnect()
                    instrument.keeper.switched_off()
            pass_time(2)
        outward.losing = back.losing = 0
        for _ in range(5 + len(everything) ** 2 + 5 * len(everything)):
            if not any(is_usable(waiting.offer) for waiting in first_of_names(instrument)):
                break
            pass_time(10)
        pass_time(50 + 10 * len(everything))  # each of those that stay is offered
        host.end()
        recorded = Counter(_facts_of_record(drop.read()) for drop in read_survey(survey).drops)
        erased = Counter(_facts(waiting) for waiting in instrument.erased)
        # Two drops that are alike in everything, name included, are one.
        assert set(erased) <= set(recorded)
        assert set(recorded.values()) <= {1}
        # One that is recorded stays where an unusable one of its name could be erased in its place.
        stay = first_of_names(instrument)
        refused = {
            waiting.offer.first_sample for waiting in everything if not is_usable(waiting.offer)
        }
        for waiting in stay:
            if is_usable(waiting.offer):
                assert _facts(waiting) in recorded
                assert waiting.offer.first_sample in refused
        assert all(is_usable(waiting.offer) for waiting in instrument.erased)


Facts = tuple[int, int, float, bytes]


def _facts(waiting: WaitingDrop) -> Facts:
    offer = waiting.offer
    return offer.first_sample, offer.trigger, offer.sampling_rate, waiting.data


def _facts_of_record(record: DropRecord) -> Facts:
    detection, identity = record.metadata["detection"], record.metadata["identity"]
    cut = detection["first_sample"], detection["trigger"]
    return *cut, identity["sampling_rate"], pack_int24(known(record.counts))
