"""What the live screen costs: first paint, updates, processor time, and that nothing is lost by it.

The screen runs in a pseudo-terminal as it does for a person, the simulated instrument beside it in
real time. POSIX only: Windows has no such terminal that a program could stand behind.
"""

import argparse
import json
import os
import re
import select
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.output import Reporter
from simulators.instrument import serve

CASES = {"8 x 50 kHz": "eight-channels", "4 x 10 kHz": "typical"}
FEWEST_UPDATES = 10.0
"""Per second."""
LARGEST_SHARE = 0.25
"""Of a core, at 4 x 10 kHz."""
LATEST_PAINT, LATEST_MODULUS = 1.0, 0.3
"""s."""
LONGEST_BUILD = 240.0
"""s until the model's table of a sensor layout that nobody measured with before is there."""
WARM_UP = 5.0
"""s that are not measured: libraries load, the model's table is read."""


def run(arguments: list[str]) -> int:
    """``--seconds S`` of each case (default 20), ``--columns`` and ``--rows`` of the terminal."""
    parser = argparse.ArgumentParser(prog="pfwd bench screen")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each case")
    parser.add_argument("--columns", type=int, default=120)
    parser.add_argument("--rows", type=int, default=40)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    if os.name != "posix":
        print("pfwd bench screen: expected a POSIX system with pseudo-terminals", file=sys.stderr)
        return 2
    report = Reporter(arguments)
    good = True
    size = args.columns, args.rows
    report.title(f"first paint of pfwd replay --live, {size[0]} x {size[1]}")
    paints = [first_paint(size) for _ in range(3)]
    report.record(part="first paint", seconds=min(paints), largest=max(paints))
    good &= min(paints) <= LATEST_PAINT
    for name, scenario in CASES.items():
        report.title(f"{name}, {args.seconds:g} s of real time")
        found = measure_case(scenario, args.seconds, size)
        report.record(part=name, **found)
        good &= found["lost"] == 0 and found["updates_per_s"] >= FEWEST_UPDATES
        good &= found["first_modulus_s"] <= LATEST_MODULUS
        if name == "4 x 10 kHz":
            good &= found["core"] <= LARGEST_SHARE
    return 0 if good else 1


class Terminal:
    """A pseudo-terminal with a program in it; what that writes is read and counted."""

    def __init__(self, command: list[str], size: tuple[int, int]) -> None:
        import fcntl
        import termios

        self.master, slave = os.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", size[1], size[0], 0, 0))
        # A parent's size, as a runner of tests sets it, would win over that of this terminal.
        inherited = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")}
        environment = {
            **inherited,
            "TERM": "xterm-256color",
            "COLORTERM": "truecolor",
            "PFWD_SETTINGS": os.path.join(tempfile.gettempdir(), "pfwd-bench-settings.json"),
        }
        self.started = time.monotonic()
        self.process = subprocess.Popen(
            command, stdin=slave, stdout=slave, stderr=slave, env=environment, close_fds=True
        )
        os.close(slave)
        self.text = b""
        self.bytes = 0
        self.writes = 0

    def read(self, timeout: float) -> bool:
        """Whether something came within so many seconds."""
        if not select.select([self.master], [], [], timeout)[0]:
            return False
        try:
            data = os.read(self.master, 1 << 16)
        except OSError:  # the other side has gone
            return False
        self.bytes += len(data)
        self.writes += 1
        self.text = (self.text + data)[-(1 << 18) :]
        return bool(data)

    def press(self, keys: str) -> None:
        """Type something."""
        os.write(self.master, keys.encode())

    def close(self) -> None:
        """End the program if it still runs."""
        self.process.terminate()
        until = time.monotonic() + 30
        while self.process.poll() is None and time.monotonic() < until:
            self.read(0.1)
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        os.close(self.master)


PFWD = [sys.executable, "-P", "-c", "from tui.cli import main; raise SystemExit(main())"]
PAINTED = re.compile(rb"PFWD.*measured", re.DOTALL)


def first_paint(size: tuple[int, int]) -> float:
    """Seconds from the command to a page that can be read."""
    with tempfile.TemporaryDirectory(prefix="pfwd-bench-") as folder:
        # Whether there is a recording is found out after the first paint.
        terminal = Terminal([*PFWD, "replay", folder, "--live"], size)
        try:
            while not PAINTED.search(terminal.text):
                if time.monotonic() - terminal.started > 30:
                    raise RuntimeError("the screen was not painted within 30 s")
                terminal.read(0.01)
            return time.monotonic() - terminal.started
        finally:
            terminal.close()


def measure_case(scenario: str, seconds: float, size: tuple[int, int]) -> dict[str, Any]:
    """Figures of one flood, as the program in the terminal measured itself."""
    with (
        tempfile.TemporaryDirectory(prefix="pfwd-bench-") as folder,
        serve({"base": scenario}, rate=1.0) as instrument,
    ):
        told = Path(folder) / "figures.json"
        command = [sys.executable, "-m", "benchmarks.screen", instrument.url, folder]
        terminal = Terminal([*command, str(told), str(seconds)], size)
        try:
            until = time.monotonic() + seconds + LONGEST_BUILD + 30
            while terminal.process.poll() is None and time.monotonic() < until:
                terminal.read(0.1)
        finally:
            terminal.close()
        if not told.is_file():
            end = terminal.text[-400:].decode(errors="replace")
            raise RuntimeError(f"the screen ended with {terminal.process.returncode}: {end}")
        found = json.loads(told.read_text(encoding="utf-8"))
        return {**found, "terminal_kb_per_s": terminal.bytes / 1e3 / (seconds + WARM_UP)}


def child(url: str, folder: str, told: str, seconds: float) -> None:
    """The screen in this process; it ends by itself and writes what it cost."""
    import asyncio

    from pfwd.session.plan import SessionPlan
    from tui.screen.app import PfwdApp
    from tui.screen.session.sources import LiveSource
    from tui.screen.settings import ScreenSettings

    class Measured(PfwdApp):
        """Looks at itself."""

        def on_ready(self) -> None:
            """Wait until it is warm, measure, leave."""
            self.run_worker(self._measure(), exit_on_error=True)

        async def _measure(self) -> None:
            while not self.state.device.connected:
                await asyncio.sleep(0.1)
            await asyncio.sleep(WARM_UP)
            until = time.monotonic() + LONGEST_BUILD
            while time.monotonic() < until and not self._moduli():
                await asyncio.sleep(0.2)
            before = self._lost()
            seen = {id(one) for one in self.state.drops_in_order()}
            wall, cpu, drawn = time.monotonic(), time.process_time(), self.drawn
            samples = self.runner.trace.samples
            await asyncio.sleep(seconds)
            wall, cpu = time.monotonic() - wall, time.process_time() - cpu
            drops = [one for one in self.state.drops_in_order() if id(one) not in seen]
            delays = [one.delay for one in drops if one.delay is not None]
            found = {
                "updates_per_s": (self.drawn - drawn) / wall,
                "core": cpu / wall,
                "samples_per_s": (self.runner.trace.samples - samples) / wall,
                "lost": self._lost() - before,
                "lost_at_start": before,
                "drops": len(drops),
                "first_modulus_s": sorted(delays)[len(delays) // 2] if delays else 99.0,
                "slowest_modulus_s": max(delays, default=99.0),
            }
            Path(told).write_text(json.dumps(found), encoding="utf-8")
            self.exit(0)

        def _moduli(self) -> bool:
            return any(one.modulus is not None for one in self.state.drops_in_order())

        def _lost(self) -> float:
            counters = self.state.session.counters()
            names = ("samples_lost", "queue_overflow_bytes", "instrument_overruns")
            return float(sum(counters[name] or 0 for name in names))

    source = LiveSource(url, Path(folder) / "survey", SessionPlan())
    Measured(source, ScreenSettings(bell=False), save=lambda _: True).run()


if __name__ == "__main__":
    child(sys.argv[1], sys.argv[2], sys.argv[3], float(sys.argv[4]))
