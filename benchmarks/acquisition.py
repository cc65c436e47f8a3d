"""Cost of acquisition: the fastest simulated instrument in real time, and 24 hours of recording.

The driver runs in another process, records as ``pfwd log --no-invert`` does, and measures its own
time and memory. The simulated instrument runs on the same machine.
"""

import json
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import psutil

from benchmarks.output import parse_options
from simulators.instrument import serve

DAY_S = 86_400.0


def run(arguments: list[str]) -> int:
    """Measure ``--seconds S`` of real time (30; documented for 600), and a day with ``--day``.

    Returns
    -------
    int
        Exit status: 1 if samples were lost, drops are missing, or more than 30 % of a core were
        used.
    """
    options, report = parse_options(
        "acquisition",
        __doc__,
        arguments,
        seconds=(30.0, "of 8 channels at 50 kHz, s"),
        day=(False, "record a day of 4 channels at 10 kHz, too"),
    )
    good = True
    if options.seconds > 0:
        report.title(f"8 channels at 50 kHz for {options.seconds:g} s of real time")
        drops = max(1, int((options.seconds - 3.0) / 5.0))
        figures = _measure({"base": "eight-channels"}, drops, 1.0)
        report.record(part="8 x 50 kHz", **figures)
        good &= figures["lost"] == 0 and figures["drops"] == drops and figures["core"] <= 0.30
    if options.day:
        report.title(f"{DAY_S / 3600:g} hours of 4 channels at 10 kHz, as fast as possible")
        # A drop per minute. The first one falls after five minutes: at this speed a command such as
        # the check of the span takes effect minutes later in the instrument's time.
        drops_of_day = {"interval": 60.0, "first": 300.0, "knock_probability": 0.0}
        scenario = {"base": "typical", "drops": drops_of_day}
        drops = max(1, int((DAY_S - 300.0) / 60.0))
        figures = _measure(scenario, drops, 0.0)
        report.record(part="day", times_real_time=60.0 * drops / figures["elapsed_s"], **figures)
        good &= figures["lost"] == 0 and figures["drops"] == drops
    return 0 if good else 1


def _measure(scenario: dict[str, Any], drops: int, rate: float) -> dict[str, Any]:
    with (
        tempfile.TemporaryDirectory(prefix="pfwd-bench-") as folder,
        serve(scenario, drops=drops, rate=rate) as instrument,
    ):
        command = [sys.executable, "-m", "benchmarks.acquisition", instrument.url, folder]
        completed = subprocess.run(
            [*command, str(drops)], capture_output=True, text=True, check=False
        )
        if completed.returncode != 0:
            raise RuntimeError(f"the measuring process failed: {completed.stderr[-2000:]}")
        return dict(json.loads(completed.stdout))


class _MemoryMeter(threading.Thread):
    """Thread that records the memory of this process every second."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.memory: list[float] = []
        self._ended = threading.Event()

    def run(self) -> None:
        process = psutil.Process()
        while not self._ended.wait(1.0):
            self.memory.append(process.memory_info().rss / 1e6)

    def stop(self) -> None:
        self._ended.set()
        self.join()


def measure_in_this_process(url: str, folder: str, drops: int) -> dict[str, Any]:
    """Record in this process; return processor time, memory and lost samples."""
    from pfwd.session.events import DropSaved, SessionEvent
    from pfwd.session.live import LiveFeed
    from pfwd.session.session import Session, SessionPlan
    from pfwd.session.setup_file import MeasuringSetup
    from pfwd_device.recording import SurveyWriter

    saved = 0

    def listen(event: SessionEvent) -> None:
        nonlocal saved
        saved += isinstance(event, DropSaved)

    meter = _MemoryMeter()
    with SurveyWriter.open(Path(folder) / "survey") as writer:
        feed = LiveFeed(url, MeasuringSetup())
        session = Session(feed, listen, SessionPlan(drops=drops, options=None), writer)
        meter.start()
        wall, cpu = time.monotonic(), time.process_time()
        session.run()
        wall, cpu = time.monotonic() - wall, time.process_time() - cpu
        counters = feed.counters()
    meter.stop()
    # Memory grows once, until the libraries are loaded and the buffers have their size.
    settled = meter.memory[len(meter.memory) // 4 :] or [0.0]
    third = max(1, len(settled) // 3)
    lost = ("samples_lost", "queue_overflow_bytes", "instrument_overruns", "frames_damaged")
    return {
        "elapsed_s": wall,
        "samples": counters["samples"],
        "megabytes": (counters["bytes_received"] or 0) / 1e6,
        "lost": sum(counters[name] or 0 for name in lost),
        "drops": saved,
        "core": cpu / wall,
        "memory_mb": max(settled),
        "memory_growth_mb": sum(settled[-third:]) / third - sum(settled[:third]) / third,
    }


if __name__ == "__main__":
    print(json.dumps(measure_in_this_process(sys.argv[1], sys.argv[2], int(sys.argv[3]))))
