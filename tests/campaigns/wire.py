"""The wire at its worst: cables pulled, instruments killed, bytes damaged, links that are slow.

The compiled core plays finite-element drops into `measure`, the way of `pfwd log`, through a link
that is cut or damages bytes; what is recorded is compared with what was played, bit for bit.
"""

import argparse
import random
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.output import Reporter
from pfwd.analysis.options import AnalysisOptions
from pfwd.session.events import DropSaved, SessionEvent
from pfwd.session.measure import measure
from pfwd.session.session import Session, SessionPlan
from pfwd_device.recording import read_survey
from simulators.bad_link import BadLink
from simulators.firmware import BoardOptions, FirmwareError, HostBoard, Played, play_scenario

SPEED = 8.0
"""Times real time: a drop of 0.12 s takes 15 ms, then its way over the link."""
STREAMING_SPEED = 2.0
"""The same for streams: what a busy computer does not fetch within the ring's 2 s is lost."""
STREAMED = {"drops": {"first": 1.0, "interval": 2.0, "quiet": 1.0, "bounces": [0, 0]}}
"""Without bounces: a drop so soon after one would be taken for another."""
SERIAL = 11_520.0
"""Bytes a second at 115200 baud, 10 bits a byte."""
MOST_LATENCY = 1.5
"""s from the end of a drop of 2 x 900 samples to the screen at 115200 baud."""
SCENARIO = {"drops": {"first": 1.0, "interval": 3.0, "quiet": 1.0, "bounces": [1, 2]}}
TWO_CHANNELS = {"device": {"sampling_rate": 7500.0, "sampling_rates": [7500.0]}}
"""0.12 s are 900 samples."""


class Recorded:
    """What a survey holds of drops that were played."""

    def __init__(self, folder: Path, played: Played) -> None:
        touches = [truth["touch_sample"] for truth in played.truth]
        rate = played.identity.sampling_rate
        self.whole: set[int] = set()
        self.unlike: list[int] = []
        """Drops that differ from what was played and do not say so."""
        self.marked: set[int] = set()
        self.times: dict[int, int] = {}
        for drop in read_survey(folder).drops:
            record = drop.read()
            found = record.metadata["detection"]
            first = found["first_sample"] + BEGIN.get(found["stream"], 0)
            trigger = first + found["trigger"]
            number = int(np.searchsorted(touches, trigger + 0.05 * rate))
            assert record.counts is not None
            self.times[number] = self.times.get(number, 0) + 1
            there = played.counts[max(0, first) : first + len(record.counts)]
            if record.metadata["marks"] and record.metadata["missing"]:
                self.marked.add(number)
            elif np.array_equal(there, record.counts):
                self.whole.add(number)
            elif record.metadata["marks"]:
                self.marked.add(number)
            else:
                self.unlike.append(number)

    @property
    def twice(self) -> int:
        """Drops that are there more than once."""
        return sum(count > 1 for count in self.times.values())


BEGIN: dict[int, int] = {}
"""Where in what is played the run of a number began."""


def run(arguments: list[str]) -> int:
    """Run the parts asked for; 1 when a drop is lost, damaged unmarked or there twice."""
    parser = argparse.ArgumentParser(prog="pfwd bench wire")
    parser.add_argument("--short", action="store_true", help="a tenth of the drops")
    parser.add_argument("--drops", type=int, help="how many (default: 300)")
    parser.add_argument("--part", choices=["pulled", "killed", "errors", "slow"], action="append")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    reporter = Reporter(arguments)
    drops = options.drops or (30 if options.short else 300)
    parts: dict[str, Callable[[], bool]] = {
        "pulled": lambda: pulled(reporter, drops, options.seed),
        "killed": lambda: killed(reporter, drops, options.seed),
        "errors": lambda: errors(reporter, drops, options.seed),
        "slow": lambda: slow(reporter),
    }
    try:
        good = [parts[name]() for name in options.part or parts]
    except FirmwareError as err:
        print(err)
        return 2
    return 0 if all(good) else 1


def pulled(reporter: Reporter, drops: int, seed: int) -> bool:
    """The cable is pulled at a random moment of every drop."""
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
            began = time.monotonic()
            _measure(link.url, folder / "survey", drops, 40 + 3 * drops * 3 / SPEED)
            took = time.monotonic() - began
            stop.set()
            pulling.join()
            recorded = Recorded(folder / "survey", played)
            kept = len(log.read_text().splitlines())
        return _report(reporter, "pulled", drops, kept, recorded, cuts=link.cuts, seconds=took)


def _pull(link: BadLink, stop: threading.Event, seed: int, drops: int) -> None:
    generator = random.Random(seed)
    cuts = 0
    # Twice a drop: while it is connected anew there is no cable to pull.
    while not stop.wait(generator.uniform(0.02, 3 / SPEED - 0.02)) and cuts < 2 * drops:
        link.cut()
        cuts += 1


def killed(reporter: Reporter, drops: int, seed: int) -> bool:
    """The instrument is killed at random moments after a drop is kept, and restarted."""
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
            began = time.monotonic()
            _measure(link.url, folder / "survey", drops, 60 + 5 * drops * 3 / SPEED)
            took = time.monotonic() - began
            stop.set()
            killing.join()
            boards[-1].close()
        recorded = _whole_by_crc(folder / "survey", log)
        kept, whole, twice = recorded
        reporter.record(
            part="killed",
            drops=drops,
            kept=kept,
            whole=whole,
            lost=kept - whole,
            twice=twice,
            kills=len(boards) - 1,
            seconds=took,
        )
        return kept == whole and not twice and kept >= drops


def _kill(
    boards: list[HostBoard],
    played: Played,
    options: BoardOptions,
    log: Path,
    stop: threading.Event,
    seed: int,
    drops: int,
) -> None:
    """Whenever a drop is kept, wait a random moment, kill, and go on where the next one falls."""
    generator = random.Random(seed)
    rate = played.identity.sampling_rate
    number = 0
    while not stop.is_set() and number < drops:
        kept = {tuple(line.split()[1:3]) for line in log.read_text().splitlines()}
        if len(kept) <= number:
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


def _whole_by_crc(folder: Path, log: Path) -> tuple[int, int, int]:
    """Drops that the instrument kept, that are recorded as they were kept, that are there twice."""
    import zlib

    from pfwd_device.wire.fields import pack_int24

    kept = {}
    for line in log.read_text().splitlines():
        _, stream, first, _, crc = line.split()
        kept[int(stream), int(first)] = int(crc)
    names = []
    whole = 0
    for drop in read_survey(folder).drops:
        record = drop.read()
        found = record.metadata["detection"]
        name = found["stream"], found["first_sample"]
        assert record.counts is not None
        whole += zlib.crc32(pack_int24(np.asarray(record.counts))) == kept.get(name)
        names.append(name)
    return len(kept), whole, len(names) - len(set(names))


def errors(reporter: Reporter, drops: int, seed: int) -> bool:
    """Streaming over a link that damages one byte in 10,000, with and without a ring."""
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
                whole=len(recorded.whole),
                marked=len(recorded.marked),
                damaged_unmarked=len(recorded.unlike),
                twice=recorded.twice,
            )
            good &= not recorded.unlike and not recorded.twice
            if memory > 100_000:
                good &= len(recorded.whole) >= 295 * drops // 300
    return good


def slow(reporter: Reporter) -> bool:
    """A buffered drop of 2 x 900 samples over 115200 baud, from its end to the screen."""
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

            def tell(event: SessionEvent) -> None:
                if isinstance(event, DropSaved):
                    saved.append(time.monotonic())

            stop = threading.Event()
            watching = threading.Thread(target=_watch, args=(log, ends, stop))
            watching.start()
            plan = SessionPlan(drops=5, options=AnalysisOptions(seed=1))
            measure(link.url, folder / "survey", tell, plan)
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
        limit_s=MOST_LATENCY,
    )
    return max(latencies) <= MOST_LATENCY and lengths == {900}


def _watch(log: Path, ends: list[float], stop: threading.Event) -> None:
    """When each drop was whole in the instrument."""
    while not stop.is_set():
        count = len(log.read_text().splitlines())
        while len(ends) < count:
            ends.append(time.monotonic())
        time.sleep(0.002)


def _measure(url: str, folder: Path, drops: int, patience: float) -> None:
    """Record until so many drops are safe, or for so many seconds."""

    def control(session: Session) -> AbstractContextManager[object]:
        timer = threading.Timer(patience, session.stop)
        timer.daemon = True
        timer.start()
        return nullcontext()

    measure(url, folder, lambda event: None, SessionPlan(drops=drops), control=control)


def _report(
    reporter: Reporter,
    part: str,
    drops: int,
    kept: int,
    recorded: Recorded,
    **more: float,
) -> bool:
    lost = drops - len(recorded.whole)
    reporter.record(
        part=part,
        drops=drops,
        kept=kept,
        whole=len(recorded.whole),
        lost=lost,
        twice=recorded.twice,
        damaged_unmarked=len(recorded.unlike),
        **more,
    )
    return not (lost or recorded.twice or recorded.unlike)
