"""Feeds of a session from the recorded drops of a survey or the recorded bytes of a link."""

import dataclasses
import datetime
import os
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass

from pfwd.errors import SurveyError, refusal
from pfwd.files.editing import later_declarations
from pfwd.procedures import parse_procedure
from pfwd.session.drop_metadata import feed_item_of
from pfwd.session.feeds import Ended, FeedItem, ImportedDrop, RecordedDrop
from pfwd.session.setup_file import MeasuringSetup, parse_setup, with_procedure
from pfwd_device.acquisition.decoder import Decoder
from pfwd_device.acquisition.items import Disconnected, Gap, Samples
from pfwd_device.recording import CaptureReader, DropRecord, Survey
from pfwd_device.text import clean
from pfwd_device.wire.binary import BinaryInstrumentEnd
from pfwd_device.wire.messages import DropOffer


class Pace:
    """Speed of a replay, with pause and single steps; all methods may be called from any thread.

    Parameters
    ----------
    speed : float
        Speed over real time; 0: as fast as possible.
    paused : bool
        True: the replay begins with a pause.

    Examples
    --------
    >>> pace = Pace(2.0, paused=True)
    >>> pace.step()
    >>> pace.flows, pace.may_begin(), pace.may_begin(), pace.flows
    (True, True, False, False)
    """

    def __init__(self, speed: float = 0.0, *, paused: bool = False) -> None:
        self._lock = threading.Lock()
        self._speed = speed
        self._paused = paused
        self._steps = 0
        self._stepping = False

    @property
    def speed(self) -> float:
        """Speed over real time; 0: as fast as possible."""
        return self._speed

    @speed.setter
    def speed(self, value: float) -> None:
        self._speed = max(0.0, value)

    @property
    def paused(self) -> bool:
        """True during a pause, also while a single step runs."""
        return self._paused

    @property
    def flows(self) -> bool:
        """True if the replay may go on: it is not paused, or a single step runs."""
        return not self._paused or self._stepping

    def pause(self) -> None:
        """Start a pause."""
        with self._lock:
            self._paused, self._steps, self._stepping = True, 0, False

    def go_on(self) -> None:
        """End the pause."""
        with self._lock:
            self._paused, self._steps, self._stepping = False, 0, False

    def step(self) -> None:
        """Replay one more drop during a pause."""
        with self._lock:
            self._steps += 1
            self._stepping = True

    def may_begin(self) -> bool:
        """Return whether the next drop may begin; False ends a single step."""
        with self._lock:
            if not self._paused:
                return True
            if self._steps > 0:
                self._steps -= 1
                return True
            self._stepping = False
            return False


CHUNKS_PER_SECOND = 50
"""Number of blocks of samples per second, as an instrument sends them."""

LONGEST_PAUSE = 10.0
"""Longest time between two drops at speed 1, s; longer pauses of the recording are shortened."""

FIRST_PAUSE = 1.0
"""Time before the first drop at speed 1, s."""


@dataclass(frozen=True, slots=True)
class Pause:
    """Time before the next item of a recording."""

    seconds: float
    """Length at speed 1, s."""


class RecordedFeed:
    """Feed from a sequence of recorded items.

    Parameters
    ----------
    items : iterable of FeedItem or Pause
    speed : float or Pace
        Speed over real time; 0: as fast as possible. A `Pace` can be changed during the replay.
    sleep : callable
        Waits for a number of seconds.
    """

    live = False
    lost_since: float | None = None

    def __init__(
        self,
        items: Iterable[FeedItem | Pause],
        speed: float | Pace = 0.0,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._items = _generator(items)
        self._pace = speed if isinstance(speed, Pace) else Pace(speed)
        self._sleep = sleep
        self._pause_remaining = 0.0  # s at speed 1
        self._held: FeedItem | None = None

    def next(self, timeout: float) -> FeedItem | None:
        """Return the next item; None: a pause lasts longer than `timeout`, s."""
        while True:
            if not self._pace.flows:
                self._sleep(timeout)
                return None
            speed = self._pace.speed
            if self._pause_remaining > 0 and speed > 0:
                nap = min(self._pause_remaining / speed, timeout)
                self._sleep(nap)
                self._pause_remaining -= nap * speed
                if self._pause_remaining > 1e-9:
                    return None
            self._pause_remaining = 0.0
            item = self._held or next(self._items, Ended())
            self._held = None
            if isinstance(item, Pause):
                self._pause_remaining = item.seconds
                continue
            if isinstance(item, RecordedDrop | ImportedDrop) and not self._pace.may_begin():
                self._held = item
                continue
            return item

    def shunt(self, on: bool) -> None:
        """Do nothing: a recording has no shunt."""

    def acknowledge(self, offer: DropOffer) -> None:
        """Do nothing: there is no instrument."""

    def settle(self) -> None:
        """Do nothing: there is no instrument."""

    def counters(self) -> dict[str, float | None]:
        """Return an empty dict: a recording discards no messages."""
        return {}

    def close(self) -> None:
        """Close the sequence of items."""
        self._items.close()


def _generator(items: Iterable[FeedItem | Pause]) -> Generator[FeedItem | Pause, None, None]:
    yield from items


def survey_feed(
    survey: Survey, speed: float | Pace = 0.0, sleep: Callable[[float], None] = time.sleep
) -> RecordedFeed:
    """Return a feed of the drops of a survey in the order of measurement, discarded ones included.

    Parameters
    ----------
    survey : Survey
    speed : float or Pace
        Speed over real time; 0: as fast as possible.
    sleep : callable
        Waits for a number of seconds.
    """
    return RecordedFeed(_drops(survey), speed, sleep)


def _drops(survey: Survey) -> Iterator[FeedItem | Pause]:
    before: datetime.datetime | None = None
    later = {point.name: later_declarations(point) for point in survey.points}
    for drop in survey.drops:
        record = drop.read()
        # Declarations that were edited later apply to the drops as well.
        declared = {**record.declared, **later.get(drop.point, {})}
        record = dataclasses.replace(record, declared=declared)
        now = _time_of(record)
        pause = FIRST_PAUSE
        if now is not None and before is not None:
            pause = (now - before).total_seconds()
        yield Pause(min(max(pause, 0.0), LONGEST_PAUSE))
        before = now or before
        item = feed_item_of(record, str(drop.file or survey.folder))
        yield item
        if not isinstance(item, ImportedDrop):
            yield from _samples(item)
    yield Ended()


def _time_of(record: DropRecord) -> datetime.datetime | None:
    try:
        return datetime.datetime.fromisoformat(str(record.metadata.get("time_utc")))
    except ValueError:
        return None


def _samples(item: RecordedDrop) -> Iterator[Samples | Gap | Pause]:
    """Yield the samples of a drop and its rebounds in blocks, with the gaps in and between them."""
    record = item.record
    assert record.counts is not None
    rate = item.identity.sampling_rate
    end = item.first + len(record.counts)
    missing = [(item.first + start, length) for start, length in record.metadata["missing"]]
    parts = [(item.first, record.counts)]
    for rebound in record.rebounds:
        skipped = max(0, end - rebound.first_sample)
        parts.append((rebound.first_sample + skipped, rebound.counts[skipped:]))
        end = rebound.first_sample + len(rebound.counts)
    chunk = max(1, round(rate / CHUNKS_PER_SECOND))
    position = item.first
    for first, counts in parts:
        if first > position:
            yield Gap(item.stream, position, first - position)
        position = first
        while position < first + len(counts):
            gap = next((gap for gap in missing if gap[0] <= position < sum(gap)), None)
            if gap is not None:
                length = sum(gap) - position
                yield Gap(item.stream, position, length)
                position += length
                continue
            gap_starts = [start for start, _ in missing if start > position]
            stop = min([first + len(counts), position + chunk, *gap_starts])
            part = counts[position - first : stop - first]
            yield Pause(len(part) / rate)
            utc = datetime.datetime.now(datetime.UTC)
            yield Samples(item.stream, position, part, False, time.monotonic(), utc)
            position = stop
    # A gap of 20 s lets the detection complete the drop and its rebounds.
    yield Gap(item.stream, position, round(20 * rate))


def capture_feed(
    path: str | os.PathLike[str],
    speed: float | Pace = 0.0,
    setup: MeasuringSetup | None = None,
    sleep: Callable[[float], None] = time.sleep,
) -> tuple[RecordedFeed, MeasuringSetup, CaptureReader]:
    """Return a feed of the recorded bytes of a link.

    Parameters
    ----------
    path : path of a capture
    speed : float or Pace
        Speed over real time; 0: as fast as possible.
    setup : MeasuringSetup, optional
        Setup with which the bytes are parsed; None: the recorded one.
    sleep : callable
        Waits for a number of seconds.

    Returns
    -------
    feed : RecordedFeed
    setup : MeasuringSetup
        Setup with which the bytes are parsed.
    reader : CaptureReader
        Reader of the file; its attribute `damage` is complete when the feed has ended.

    Raises
    ------
    SurveyError, DeviceError
        If the file is no capture, or its setup cannot be read.
    """
    reader = CaptureReader(path)
    if not reader.header:
        hint = "name a file that pfwd log --capture has made"
        raise SurveyError(refusal(os.fspath(path), "a capture", "another file", hint))
    if setup is None:
        text = str(reader.header.get("setup_text") or "")
        procedure = str(reader.header.get("procedure_text") or "")
        where = f"setup recorded in {os.fspath(path)}"
        setup = parse_setup(text, where, procedure)
        if procedure and setup.procedure is None:  # the procedure was an option, not in the setup
            setup = with_procedure(setup, parse_procedure(procedure, where), where)
    first_stream = reader.header.get("first_stream")
    dialect = setup.device.make_dialect(first_stream if type(first_stream) is int else 0)
    decoder = Decoder(dialect, clean(str(reader.header.get("url", "")), limit=200))
    return RecordedFeed(_captured(reader, decoder), speed, sleep), setup, reader


def _captured(reader: CaptureReader, decoder: Decoder) -> Iterator[FeedItem | Pause]:
    before: int | None = None
    messages = BinaryInstrumentEnd()
    for captured in reader:
        if captured.direction == "message":
            for message in messages.feed(captured.data):
                decoder.encode(message)
        if captured.direction != "from":
            continue
        yield Pause(0.0 if before is None else (captured.monotonic_ns - before) * 1e-9)
        before = captured.monotonic_ns
        utc = datetime.datetime.fromtimestamp(captured.utc_ns * 1e-9, datetime.UTC)
        if captured.data:
            yield from decoder.feed(captured.data, captured.monotonic_ns / 1e9, utc)
            continue
        yield from decoder.cut()
        yield Disconnected("the connection was lost at this place of the recording", utc)
    yield from decoder.idle(float("inf"))
    yield Ended()
