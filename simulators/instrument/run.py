"""Start of a simulated instrument in this process or in another."""

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
from simulators.instrument.endpoint import Endpoint, EndpointError, TcpEndpoint
from simulators.instrument.scenario import ScenarioError, load_scenario
from simulators.instrument.server import Server
from simulators.mesh import SimulationError

HAS_PTY = os.name == "posix"
"""True on platforms with virtual serial ports."""
START_TIMEOUT_S = 30.0
"""Time within which a process must report its URL, s; it takes less than one second."""
STOP_TIMEOUT_S = 10.0
"""Time within which a process must end, s."""


@dataclass(frozen=True)
class SimulateOptions:
    """Options of a simulation."""

    listen: str | None = None
    """`pty` or `tcp://HOST:PORT`; None: `pty` where the platform has it."""
    scenario: str | Mapping[str, Any] = "default"
    """Name of a built-in scenario, TOML file, or parsed tables."""
    drops: int | None = None
    """Number of drops; None: no end."""
    seed: int = 0
    rate: float = 1.0
    """Speed over real time; 0: as fast as the host reads."""
    truth: str | None = None
    """JSON file of the true values, written at the end."""


def open_endpoint(listen: str | None) -> Endpoint:
    """Open the endpoint of `--listen`; by default a virtual serial port where available.

    Raises
    ------
    EndpointError
        If the endpoint cannot be opened.
    """
    if listen is None:
        listen = "pty" if HAS_PTY else "tcp://127.0.0.1:0"
    if listen == "pty":
        if sys.platform == "win32":
            raise EndpointError("pty: this platform has no virtual serial ports; try tcp://")
        else:  # noqa: RET506 - type checkers skip only an else on Windows
            from simulators.instrument.pseudo_terminal import PtyEndpoint

            return PtyEndpoint()
    host, colon, port = listen.removeprefix("tcp://").rpartition(":")
    good = listen.startswith("tcp://") and colon and host and port.isdecimal()
    if not good or int(port) > 65_535:
        raise EndpointError(f"{listen}: expected pty or tcp://HOST:PORT")
    return TcpEndpoint(host.strip("[]"), int(port))


def simulate(
    options: SimulateOptions,
    announce: Callable[[str], None],
    stopped: Callable[[], bool] = lambda: False,
) -> list[dict[str, Any]]:
    """Serve one instrument until its last message, and return the true values of its drops.

    Parameters
    ----------
    announce : called with the URL as soon as it can be opened
    stopped : returns True to end earlier

    Raises
    ------
    ScenarioError, EndpointError
        If the scenario or the port is not usable.
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
        finally:  # also after an interruption
            if options.truth is not None:
                text = json.dumps(instrument.truth(), indent=1)
                Path(options.truth).write_text(text + "\n", encoding="utf-8")
    return instrument.truth()


class SimulatedInstrument:
    """Simulated instrument in another process.

    Parameters
    ----------
    options : SimulateOptions

    Raises
    ------
    SimulationError
        If it does not start; the message has the reason.
    """

    def __init__(self, options: SimulateOptions) -> None:
        settings = asdict(options)
        self._truth_text = ""
        self._listener: threading.Thread | None = None
        # It ends with its standard input, and so with this process. Ctrl+C is handled by the
        # program that shows the drops, which stops the instrument when it is ready.
        self._process = start_text_child(
            "-m", "simulators.instrument", json.dumps(settings, default=str)
        )
        try:
            self.url = self._first_line()
            """URL for the host."""
            self._listener = threading.Thread(target=self._listen, daemon=True)
            self._listener.start()
        except BaseException:
            self.close()
            raise

    def _first_line(self) -> str:
        assert self._process.stdout is not None
        timer = threading.Timer(START_TIMEOUT_S, self._process.kill)
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
        """Read the true values at the end, so that a full pipe does not block the process."""
        assert self._process.stdout is not None
        self._truth_text = self._process.stdout.read()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait up to a number of seconds (None: no limit); return whether it has ended."""
        try:
            self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return False
        return True

    def stop(self) -> None:
        """End the process if it still runs."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        if not self.wait(STOP_TIMEOUT_S):
            self._process.kill()
            self._process.wait()

    def truth(self) -> list[dict[str, Any]]:
        """Return the true values, one mapping per drop; only after the end.

        Raises
        ------
        SimulationError
            If it still runs, or ended without them.
        """
        if self._process.poll() is None:
            raise SimulationError("truth: expected an instrument that has ended; stop it first")
        if self._listener is not None:
            self._listener.join()
        if not self._truth_text:
            raise SimulationError(f"truth: the instrument ended with {self._process.returncode}")
        return list(json.loads(self._truth_text))

    def close(self) -> None:
        """End the process and close its pipes."""
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
    """Start a simulated instrument in another process; hosts open its `url`.

    Examples
    --------
    >>> with serve("soft", drops=3) as instrument:  # doctest: +SKIP
    ...     port = serial.Serial(instrument.url)
    """
    return SimulatedInstrument(SimulateOptions(listen, scenario, drops, seed, rate))


def main(settings: str) -> int:
    """Serve the instrument of a `SimulatedInstrument` in another process."""
    options = SimulateOptions(**json.loads(settings))
    ended = threading.Event()

    def wait_for_end_of_input() -> None:
        # Without sys.stdin, whose lock this thread would still hold when the interpreter ends.
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
