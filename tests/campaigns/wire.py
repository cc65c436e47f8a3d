"""Faults of the link: cables pulled, instruments killed, bytes damaged, slow links.

The compiled core plays finite-element drops into `measure`, as in `pfwd log`, through a link that
is cut or damages bytes. The recorded samples are compared with the played ones, bit for bit.
"""

import random
import tempfile
import threading
import time
import zlib
from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.output import Reporter, parse_options
from pfwd.analysis.options import AnalysisOptions
from pfwd.session.events import DropSaved, SessionEvent
from pfwd.session.measure import measure
from pfwd.session.session import Session, SessionPlan
from pfwd_device.recording import read_survey
from pfwd_device.wire.fields import pack_int24
from simulators.bad_link import BadLink
from simulators.firmware import BoardOptions, FirmwareError, HostBoard, Played, play_scenario

SPEED = 8.0
"""Speed relative to real time: a drop of 0.12 s takes 15 ms before its transfer."""
STREAMING_SPEED = 2.0
"""Speed of streams: a busy computer must fetch the samples within the 2 s of the ring."""
STREAMED = {"drops": {"first": 1.0, "interval": 2.0, "quiet": 1.0, "bounces": [0, 0]}}
"""Drops without bounces, which would be too early for separate drops."""
SERIAL = 11_520.0
"""Bytes per second at 115200 baud, with 10 bits per byte."""
MAX_LATENCY_S = 1.5
"""Time from the end of a drop of 2 x 900 samples to the screen at 115200 baud, s."""
SCENARIO = {"drops": {"first": 1.0, "interval": 3.0, "quiet": 1.0, "bounces": [1, 2]}}
TWO_CHANNELS = {"device": {"sampling_rate": 7500.0, "sampling_rates": [7500.0]}}
"""0.12 s are 900 samples."""


class Recorded:
    """Played drops in a survey, by their numbers."""

    def __init__(self, folder: Path, played: Played) -> None:
        touches = [truth["touch_sample"] for truth in played.truth]
        rate = played.identity.sampling_rate
        self.intact: set[int] = set()
        self.wrong: list[int] = []
        """Drops that differ from the played ones without a mark."""
        self.marked: set[int] = set()
        counts: Counter[int] = Counter()
        for drop in read_survey(folder).drops:
            record = drop.read()
            detection = record.metadata["detection"]
            first = detection["first_sample"]
            trigger = first + detection["trigger"]
            number = int(np.searchsorted(touches, trigger + 0.05 * rate))
            assert record.counts is not None
            counts[number] += 1
            expected = played.counts[max(0, first) : first + len(record.counts)]
            if record.metadata["marks"] and record.metadata["missing"]:
                self.marked.add(number)
            elif np.array_equal(expected, record.counts):
                self.intact.add(number)
            elif record.metadata["marks"]:
                self.marked.add(number)
            else:
                self.wrong.append(number)
        self.twice = sum(count > 1 for count in counts.values())


def run(arguments: list[str]) -> int:
    """Run the requested parts; return 1 if a drop is lost, repeated or damaged without a mark."""
    options, reporter = parse_options(
        "wire",
        __doc__,
        arguments,
        short=(False, "a tenth of the drops"),
        drops=(int, "number of drops (300)"),
        part=("pulled,killed,errors,slow", "parts by comma"),
        seed=(1, "random seed"),
    )
    drops = options.drops or (30 if options.short else 300)
    parts: dict[str, Callable[[], bool]] = {
        "pulled": lambda: pulled(reporter, drops, options.seed),
        "killed": lambda: killed(reporter, drops, options.seed),
        "errors": lambda: errors(reporter, drops, options.seed),
        "slow": lambda: slow(reporter),
    }
    try:
        good = [parts[name]() for name in options.part.split(",")]
    except FirmwareError as err:
        print(err)
        return 2
    return 0 if all(good) else 1


def pulled(reporter: Reporter, drops: int, seed: int) -> bool:
    """Pull the cable at a random time in every drop."""
    reporter.title("buffered drops, the cable pulled at random moments")
    played = play_scenario(SCENARIO, drops=drops, seed=seed)
    with tempfile.TemporaryDirectory() as work:
        folder, log = Path(work), Path(work) / "log"
        options = BoardOptions(streams=False, speed=SPEED, log=log, store=folder / "store")
        with (
            HostBoard(played, options) as board,
            BadLink(lambda: board.url, rate=20 * SERIAL) as link,
        ):
            stop = threading.Event()
            pulling = threading.Thread(target=_pull, args=(link, stop, seed, drops))
            pulling.start()
            start = time.monotonic()
            _measure(link.url, folder / "survey", drops, 40 + 3 * drops * 3 / SPEED)
            seconds = time.monotonic() - start
            stop.set()
            pulling.join()
            recorded = Recorded(folder / "survey", played)
            stored = len(log.read_text().splitlines())
        lost = drops - len(recorded.intact)
        reporter.record(
            part="pulled",
            drops=drops,
            kept=stored,
            whole=len(recorded.intact),
            lost=lost,
            twice=recorded.twice,
            damaged_unmarked=len(recorded.wrong),
            cuts=link.cuts,
            seconds=seconds,
        )
        return not (lost or recorded.twice or recorded.wrong)


def _pull(link: BadLink, stop: threading.Event, seed: int, drops: int) -> None:
    generator = random.Random(seed)
    cuts = 0
    # Twice per drop: a cable cannot be pulled while the link is reconnecting.
    while not stop.wait(generator.uniform(0.02, 3 / SPEED - 0.02)) and cuts < 2 * drops:
        link.cut()
        cuts += 1


def killed(reporter: Reporter, drops: int, seed: int) -> bool:
    """Kill the instrument at random times after a drop is stored, and restart it."""
    reporter.title("buffered drops, the instrument killed and restarted with its store")
    played = play_scenario(SCENARIO, drops=drops, seed=seed)
    with tempfile.TemporaryDirectory() as work:
        folder, log = Path(work), Path(work) / "log"
        log.touch()
        options = BoardOptions(streams=False, speed=SPEED, log=log, store=folder / "store")
        boards = [HostBoard(played, options)]
        with BadLink(lambda: boards[-1].url, rate=20 * SERIAL) as link:
            stop = threading.Event()
            killing = threading.Thread(
                target=_kill, args=(boards, played, options, log, stop, seed, drops)
            )
            killing.start()
            start = time.monotonic()
            _measure(link.url, folder / "survey", drops, 60 + 5 * drops * 3 / SPEED)
            seconds = time.monotonic() - start
            stop.set()
            killing.join()
            boards[-1].close()
        stored, intact, twice = _intact_by_crc(folder / "survey", log)
        reporter.record(
            part="killed",
            drops=drops,
            kept=stored,
            whole=intact,
            lost=stored - intact,
            twice=twice,
            kills=len(boards) - 1,
            seconds=seconds,
        )
        return stored == intact and not twice and stored >= drops


def _kill(
    boards: list[HostBoard],
    played: Played,
    options: BoardOptions,
    log: Path,
    stop: threading.Event,
    seed: int,
    drops: int,
) -> None:
    """Kill the board a random time after each stored drop, and restart it before the next drop."""
    generator = random.Random(seed)
    rate = played.identity.sampling_rate
    number = 0
    while not stop.is_set() and number < drops:
        stored = {tuple(line.split()[1:3]) for line in log.read_text().splitlines()}
        if len(stored) <= number:
            stop.wait(0.005)
            continue
        number += 1
        stop.wait(generator.uniform(0.0, 0.15))
        boards[-1].kill()
        boards[-1].close()
        if number < drops:
            begin = round(played.truth[number]["touch_sample"] - 0.9 * rate)
        else:
            begin = len(played.counts) - 1
        boards.append(HostBoard(played, replace(options, begin=max(0, begin))))


def _intact_by_crc(folder: Path, log: Path) -> tuple[int, int, int]:
    """Return the numbers of drops that are stored in the instrument, recorded intact, and twice."""
    stored = {}
    for line in log.read_text().splitlines():
        _, stream, first, _, crc = line.split()
        stored[int(stream), int(first)] = int(crc)
    names = []
    intact = 0
    for drop in read_survey(folder).drops:
        record = drop.read()
        detection = record.metadata["detection"]
        name = detection["stream"], detection["first_sample"]
        assert record.counts is not None
        intact += zlib.crc32(pack_int24(np.asarray(record.counts))) == stored.get(name)
        names.append(name)
    return len(stored), intact, len(names) - len(set(names))


def errors(reporter: Reporter, drops: int, seed: int) -> bool:
    """Stream over a link that damages a byte in 10,000, with a long and a short ring."""
    reporter.title("streaming, one byte in 10,000 with a wrong bit")
    played = play_scenario(STREAMED, drops=drops, seed=seed)
    good = True
    for name, memory in (("with a ring of 2 s", 131_072), ("with a ring of 0.1 s", 6_144)):
        with tempfile.TemporaryDirectory() as work:
            folder = Path(work)
            options = BoardOptions(drop_samples=0, speed=STREAMING_SPEED, memory=memory)
            with (
                HostBoard(played, options) as board,
                BadLink(partial(getattr, board, "url"), bit_error_rate=1e-4, seed=seed) as link,
            ):
                _measure(link.url, folder / "survey", drops, 10 + drops * 2 / STREAMING_SPEED)
            recorded = Recorded(folder / "survey", played)
            reporter.record(
                part="errors",
                link=name,
                drops=drops,
                whole=len(recorded.intact),
                marked=len(recorded.marked),
                damaged_unmarked=len(recorded.wrong),
                twice=recorded.twice,
            )
            good &= not recorded.wrong and not recorded.twice
            if memory > 100_000:
                good &= len(recorded.intact) >= 295 * drops // 300
    return good


def slow(reporter: Reporter) -> bool:
    """Measure the time of a buffered drop of 2 x 900 samples to the screen at 115200 baud."""
    reporter.title("115200 baud, a drop of 2 x 900 samples")
    played = play_scenario({**SCENARIO, **TWO_CHANNELS}, drops=5, seed=1)
    rate = played.identity.sampling_rate
    ends: list[float] = []
    with tempfile.TemporaryDirectory() as work:
        folder, log = Path(work), Path(work) / "log"
        log.touch()
        options = BoardOptions(streams=False, log=log)
        with (
            HostBoard(played, options) as board,
            BadLink(lambda: board.url, rate=SERIAL) as link,
        ):
            saved: list[float] = []

            def receive(event: SessionEvent) -> None:
                if isinstance(event, DropSaved):
                    saved.append(time.monotonic())

            stop = threading.Event()
            watching = threading.Thread(target=_watch, args=(log, ends, stop))
            watching.start()
            plan = SessionPlan(drops=5, options=AnalysisOptions(seed=1))
            measure(link.url, folder / "survey", receive, plan)
            stop.set()
            watching.join()
        lengths = {len(drop.read().drop.load) for drop in read_survey(folder / "survey").drops}
    latencies = [after - end for after, end in zip(saved, ends, strict=False)]
    reporter.record(
        part="slow",
        samples=max(lengths),
        rate_hz=rate,
        drops=len(latencies),
        worst_s=max(latencies),
        mean_s=float(np.mean(latencies)),
        limit_s=MAX_LATENCY_S,
    )
    return max(latencies) <= MAX_LATENCY_S and lengths == {900}


def _watch(log: Path, ends: list[float], stop: threading.Event) -> None:
    """Append the time at which each drop was complete in the instrument."""
    while not stop.is_set():
        count = len(log.read_text().splitlines())
        while len(ends) < count:
            ends.append(time.monotonic())
        time.sleep(0.002)


def _measure(url: str, folder: Path, drops: int, timeout: float) -> None:
    """Record until a number of drops is safe, or for a time in seconds."""

    def control(session: Session) -> AbstractContextManager[object]:
        timer = threading.Timer(timeout, session.stop)
        timer.daemon = True
        timer.start()
        return nullcontext()

    measure(url, folder, lambda event: None, SessionPlan(drops=drops), control=control)
