"""Cost of the live screen: first paint, updates, processor time, lost samples.

The screen runs in a pseudo-terminal, and the simulated instrument in another process in real time.
POSIX only: Windows has no pseudo-terminals of this kind.
"""

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

from benchmarks.output import parse_options
from simulators.instrument import serve

SIZE = (120, 40)
"""Columns and rows of the terminal."""
CASES = {"8 x 50 kHz": "eight-channels", "4 x 10 kHz": "typical"}
MIN_UPDATES_PER_S = 10.0
"""Smallest accepted number of screen updates per second."""
MAX_CORES = 0.25
"""Largest accepted processor time over elapsed time, with 4 channels at 10 kHz."""
MAX_PAINT_S, MAX_MODULUS_DELAY_S = 1.0, 0.3
"""Largest accepted times of the first paint, and from a drop to its modulus, s."""
BUILD_TIMEOUT_S = 240.0
"""Time within which the response table of a new sensor layout is built, s."""
WARM_UP_S = 5.0
"""Time before the measurement, s, in which libraries and the response table are loaded."""


def run(arguments: list[str]) -> int:
    """Measure ``--seconds S`` of each case (20) on ``--columns`` and ``--rows``.

    Return the exit status.
    """
    options, report = parse_options("screen", __doc__, arguments, seconds=(20.0, "of each case, s"))
    if os.name != "posix":
        print("pfwd bench screen: expected a POSIX system with pseudo-terminals", file=sys.stderr)
        return 2
    good = True
    report.title(f"first paint of pfwd replay --live, {SIZE[0]} x {SIZE[1]}")
    with tempfile.TemporaryDirectory(prefix="pfwd-bench-") as folder:
        # The program checks for a recording only after the first paint.
        paints = [first_paint(["replay", folder, "--live"]) for _ in range(3)]
    report.record(part="first paint", seconds=min(paints), largest=max(paints))
    good &= min(paints) <= MAX_PAINT_S
    for name, scenario in CASES.items():
        report.title(f"{name}, {options.seconds:g} s of real time")
        figures = measure_case(scenario, options.seconds)
        report.record(part=name, **figures)
        good &= figures["lost"] == 0 and figures["updates_per_s"] >= MIN_UPDATES_PER_S
        good &= figures["first_modulus_s"] <= MAX_MODULUS_DELAY_S
        if name == "4 x 10 kHz":
            good &= figures["core"] <= MAX_CORES
    return 0 if good else 1


def open_terminal(size: tuple[int, int]) -> tuple[int, int]:
    """Return both ends of a new pseudo-terminal, the program's last; its size: columns, lines."""
    if sys.platform == "win32":
        raise OSError("expected a system with pseudo-terminals, which Windows has not")
    else:  # noqa: RET506  mypy leaves out what stands here on Windows
        import fcntl
        import termios

        ends = os.openpty()
        fcntl.ioctl(ends[1], termios.TIOCSWINSZ, struct.pack("HHHH", size[1], size[0], 0, 0))
        return ends


class Terminal:
    """Pseudo-terminal in which a program runs; its output is read and counted."""

    def __init__(self, command: list[str], size: tuple[int, int] = SIZE) -> None:
        self.master, slave = open_terminal(size)
        # These variables would override the size of this terminal.
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
        """Read output for up to ``timeout`` seconds; return whether there was any."""
        if not select.select([self.master], [], [], timeout)[0]:
            return False
        try:
            data = os.read(self.master, 1 << 16)
        except OSError:  # the program has ended
            return False
        self.bytes += len(data)
        self.writes += 1
        self.text = (self.text + data)[-(1 << 18) :]
        return bool(data)

    def press(self, keys: str) -> None:
        """Send keys to the program."""
        os.write(self.master, keys.encode())

    def close(self) -> None:
        """End the program if it is still running."""
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


def first_paint(arguments: list[str]) -> float:
    """Return the time from the start of ``pfwd`` with these arguments to a readable page, s."""
    terminal = Terminal([*PFWD, *arguments])
    try:
        while not PAINTED.search(terminal.text):
            if time.monotonic() - terminal.started > 60:
                raise RuntimeError(f"pfwd {' '.join(arguments)}: not painted within 60 s")
            terminal.read(0.01)
        return time.monotonic() - terminal.started
    finally:
        terminal.close()


def measure_case(scenario: str, seconds: float) -> dict[str, Any]:
    """Return the figures of one scenario, measured by the program in the terminal."""
    with (
        tempfile.TemporaryDirectory(prefix="pfwd-bench-") as folder,
        serve({"base": scenario}, rate=1.0) as instrument,
    ):
        figures_file = Path(folder) / "figures.json"
        command = [sys.executable, "-m", "benchmarks.screen", instrument.url, folder]
        terminal = Terminal([*command, str(figures_file), str(seconds)])
        try:
            until = time.monotonic() + seconds + BUILD_TIMEOUT_S + 30
            while terminal.process.poll() is None and time.monotonic() < until:
                terminal.read(0.1)
        finally:
            terminal.close()
        if not figures_file.is_file():
            end = terminal.text[-400:].decode(errors="replace")
            raise RuntimeError(f"the screen ended with {terminal.process.returncode}: {end}")
        figures = json.loads(figures_file.read_text(encoding="utf-8"))
        return {**figures, "terminal_kb_per_s": terminal.bytes / 1e3 / (seconds + WARM_UP_S)}


def measure_in_this_process(url: str, folder: str, figures_file: str, seconds: float) -> None:
    """Run the screen in this process for a number of seconds and write its figures to a file."""
    import asyncio

    from pfwd.session.plan import SessionPlan
    from tui.screen.app import PfwdApp
    from tui.screen.session.sources import LiveSource
    from tui.screen.settings import ScreenSettings

    class Measured(PfwdApp):
        """Application that measures its own cost."""

        def on_ready(self) -> None:
            """Start the measurement."""
            self.run_worker(self._measure(), exit_on_error=True)

        async def _measure(self) -> None:
            while not self.state.device.connected:
                await asyncio.sleep(0.1)
            await asyncio.sleep(WARM_UP_S)
            until = time.monotonic() + BUILD_TIMEOUT_S
            while time.monotonic() < until and not self._moduli():
                await asyncio.sleep(0.2)
            before = self._lost()
            earlier = {(drop.point, drop.number) for drop in self.state.drops_in_order()}
            wall, cpu, drawn = time.monotonic(), time.process_time(), self.drawn
            samples = self.runner.trace.samples
            await asyncio.sleep(seconds)
            wall, cpu = time.monotonic() - wall, time.process_time() - cpu
            drops = [
                drop.memory
                for drop in self.state.drops_in_order()
                if (drop.point, drop.number) not in earlier
            ]
            delays = [drop.delay for drop in drops if drop.delay is not None]
            figures = {
                "updates_per_s": (self.drawn - drawn) / wall,
                "core": cpu / wall,
                "samples_per_s": (self.runner.trace.samples - samples) / wall,
                "lost": self._lost() - before,
                "lost_at_start": before,
                "drops": len(drops),
                "first_modulus_s": sorted(delays)[len(delays) // 2] if delays else 99.0,
                "slowest_modulus_s": max(delays, default=99.0),
            }
            Path(figures_file).write_text(json.dumps(figures), encoding="utf-8")
            self.exit(0)

        def _moduli(self) -> bool:
            return any(drop.modulus is not None for drop in self.state.drops_in_order())

        def _lost(self) -> float:
            counters = self.state.session.counters()
            names = ("samples_lost", "queue_overflow_bytes", "instrument_overruns")
            return float(sum(counters[name] or 0 for name in names))

    source = LiveSource(url, Path(folder) / "survey", SessionPlan())
    Measured(source, ScreenSettings(bell=False), save=lambda _: True).run()


if __name__ == "__main__":
    measure_in_this_process(sys.argv[1], sys.argv[2], sys.argv[3], float(sys.argv[4]))
