"""A simulated instrument from its options: in this process, or in one of its own."""

from __future__ import annotations

import json
import os
import secrets
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from pfwd_device.child_python import start_text_child
from simulators.instrument.device import PortlessInstrument
from simulators.instrument.endpoint import EndpointError
from simulators.instrument.opening import open_endpoint
from simulators.instrument.scenario import ScenarioError, load_scenario
from simulators.instrument.server import Server
from simulators.mesh import SimulationError

LONGEST_START = 30.0
"""s until a process that does not tell its URL is given up; it takes less than one."""
LONGEST_STOP = 10.0
"""s."""


@dataclass(frozen=True)
class SimulateOptions:
    """What to simulate and where."""

    listen: str | None = None
    """`pty` or `tcp://HOST:PORT`; None: what the platform has."""
    scenario: str | Mapping[str, Any] = "default"
    """Built-in name, TOML file, or tables as TOML would give them."""
    drops: int | None = None
    """None: for ever."""
    seed: int = 0
    rate: float = 1.0
    """Times real time; 0: as fast as the host reads."""
    truth: str | None = None
    """File that is written at the end."""


def simulate(
    options: SimulateOptions,
    announce: Callable[[str], None],
    stopped: Callable[[], bool] = lambda: False,
) -> list[dict[str, Any]]:
    """Serve one instrument until it has said everything, and return the truth of its drops.

    Parameters
    ----------
    announce : is told the URL as soon as it can be opened
    stopped : whether to end before

    Raises
    ------
    ScenarioError, EndpointError
        If the scenario or the port is not as it has to be.
    """
    if not 0 <= options.rate < float("inf"):
        raise ScenarioError(f"rate: expected a number >= 0, got {options.rate}")
    if options.drops is not None and options.drops < 1:
        raise ScenarioError(f"drops: expected a whole number >= 1, got {options.drops}")
    scenario = load_scenario(options.scenario)
    with closing(open_endpoint(options.listen)) as endpoint:
        instrument = PortlessInstrument(
            scenario,
            options.seed,
            options.drops,
            overruns=options.rate == 1,
            power_on=secrets.randbits(32),
        )
        try:
            announce(endpoint.url)
            Server(instrument, endpoint, options.rate, stopped).run()
        finally:  # also when interrupted: it is then that somebody wants to know
            if options.truth is not None:
                text = json.dumps(instrument.truth(), indent=1)
                Path(options.truth).write_text(text + "\n", encoding="utf-8")
    return instrument.truth()


class SimulatedInstrument:
    """A simulated instrument in a process of its own.

    Parameters
    ----------
    options : SimulateOptions

    Raises
    ------
    SimulationError
        If it does not start; the message says why.
    """

    def __init__(self, options: SimulateOptions) -> None:
        settings = asdict(options)
        self._told = ""
        self._listener: threading.Thread | None = None
        # Its standard input is its lifeline: it ends when this process does, however that ends.
        # Ctrl+C is for the program that shows the drops; it stops this one when it is ready.
        self._process = start_text_child(
            "-m", "simulators.instrument", json.dumps(settings, default=str)
        )
        try:
            self.url = self._first_line()
            """What to open."""
            self._listener = threading.Thread(target=self._listen, daemon=True)
            self._listener.start()
        except BaseException:
            self.close()
            raise

    def _first_line(self) -> str:
        assert self._process.stdout is not None
        timer = threading.Timer(LONGEST_START, self._process.kill)
        timer.start()
        try:
            line = self._process.stdout.readline()
        finally:
            timer.cancel()
        if not line:
            self._process.wait()
            assert self._process.stderr is not None
            reason = self._process.stderr.read().strip().splitlines()
            raise SimulationError(reason[-1] if reason else "the simulated instrument ended")
        return str(json.loads(line)["url"])

    def _listen(self) -> None:
        """Take what it says at its end: nobody may wait for the other."""
        assert self._process.stdout is not None
        self._told = self._process.stdout.read()

    def wait(self, timeout: float | None = None) -> bool:
        """Whether it has ended, after waiting so many seconds (None: for ever)."""
        try:
            self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return False
        return True

    def stop(self) -> None:
        """End it if it still runs."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        if not self.wait(LONGEST_STOP):
            self._process.kill()
            self._process.wait()

    def truth(self) -> list[dict[str, Any]]:
        """What was simulated, one mapping per drop; only after the end.

        Raises
        ------
        SimulationError
            If it still runs, or ended without telling.
        """
        if self._process.poll() is None:
            raise SimulationError("truth: expected an instrument that has ended; stop it first")
        if self._listener is not None:
            self._listener.join()
        if not self._told:
            raise SimulationError(f"truth: the instrument ended with {self._process.returncode}")
        return list(json.loads(self._told))

    def close(self) -> None:
        """End it and leave nothing behind."""
        self.stop()
        if self._listener is not None:
            self._listener.join()
        for pipe in (self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()

    def __enter__(self) -> SimulatedInstrument:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def serve(
    scenario: str | Mapping[str, Any] = "default",
    *,
    listen: str | None = None,
    drops: int | None = None,
    seed: int = 0,
    rate: float = 1.0,
) -> SimulatedInstrument:
    """A simulated instrument that runs in a process of its own; open its `url`.

    Examples
    --------
    >>> with serve("soft", drops=3) as instrument:  # doctest: +SKIP
    ...     port = serial.Serial(instrument.url)
    """
    return SimulatedInstrument(SimulateOptions(listen, scenario, drops, seed, rate))


def main(settings: str) -> int:
    """Serve in this process what `SimulatedInstrument` of another one asks for."""
    options = SimulateOptions(**json.loads(settings))
    ended = threading.Event()

    def wait_for_end_of_input() -> None:
        # Not by sys.stdin, whose lock this thread would still hold when the interpreter ends.
        while os.read(0, 4096):
            pass
        ended.set()

    threading.Thread(target=wait_for_end_of_input, daemon=True).start()
    try:
        truth = simulate(
            options, lambda url: print(json.dumps({"url": url}), flush=True), ended.is_set
        )
    except (SimulationError, EndpointError) as err:
        print(err, file=sys.stderr, flush=True)
        return 1
    except KeyboardInterrupt:
        return 0
    with suppress(OSError):  # the caller may be gone
        sys.stdout.buffer.write(json.dumps(truth).encode())
        sys.stdout.buffer.flush()
    return 0
