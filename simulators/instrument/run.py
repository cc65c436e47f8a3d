"""Start of a simulated instrument, in this process or in another one."""

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
from typing import Any

from pfwd_device.child_python import start_text_child
from simulators.instrument.device import PortlessInstrument
from simulators.instrument.endpoint import Endpoint, EndpointError, TcpEndpoint
from simulators.instrument.scenario import ScenarioError, load_scenario
from simulators.instrument.server import Server
from simulators.loggers import LOGGERS, PortlessLogger
from simulators.mesh import SimulationError

HAS_PTY = os.name == "posix"
"""True on platforms with virtual serial ports."""
START_TIMEOUT_S = 30.0
"""Longest wait for the URL that a started process reports, s; it takes less than one second."""
STOP_TIMEOUT_S = 10.0
"""Longest wait for the end of a process, s."""


@dataclass(frozen=True)
class SimulateOptions:
    """Options of a simulated instrument."""

    listen: str | None = None
    """Port: `pty` for a virtual serial port, or `tcp://HOST:PORT`. None: `pty` where the platform
    has it."""
    scenario: str | Mapping[str, Any] = "default"
    """Name of a built-in scenario, path of a TOML file, or its content."""
    drops: int | None = None
    """Number of drops; None: no end."""
    seed: int = 0
    """Seed of the random numbers."""
    rate: float = 1.0
    """Speed relative to real time; 0: as fast as the host reads."""
    logger: str | None = None
    """Name of a data logger that measures the drops; None: an instrument with its own protocol."""
    truth: str | None = None
    """JSON file to which the true values are written at the end; None: no file."""


def open_endpoint(listen: str | None) -> Endpoint:
    """Open the port of a simulated instrument.

    Parameters
    ----------
    listen : str or None
        `pty` for a virtual serial port, or `tcp://HOST:PORT`. None: a virtual serial port where the
        platform has them, else any free TCP port of this computer.

    Raises
    ------
    EndpointError
        If the port cannot be opened.
    """
    if listen is None:
        listen = "pty" if HAS_PTY else "tcp://127.0.0.1:0"
    if listen == "pty":
        if sys.platform == "win32":
            raise EndpointError(
                "pty: expected a platform with virtual serial ports, got Windows; try "
                "tcp://127.0.0.1:0"
            )
        else:  # noqa: RET506 - type checkers skip only an else on Windows
            from simulators.instrument.pseudo_terminal import PtyEndpoint

            return PtyEndpoint()
    host, colon, port = listen.removeprefix("tcp://").rpartition(":")
    good = listen.startswith("tcp://") and colon and host and port.isdecimal()
    if not good or int(port) > 65_535:
        raise EndpointError(f"listen: expected pty or tcp://HOST:PORT, got {listen}")
    return TcpEndpoint(host.strip("[]"), int(port))


def simulate(
    options: SimulateOptions,
    announce: Callable[[str], None],
    stopped: Callable[[], bool] = lambda: False,
) -> list[dict[str, Any]]:
    """Run a simulated instrument until its last message, and return the true values of its drops.

    Parameters
    ----------
    options : SimulateOptions
    announce : callable
        Function that receives the URL of the port as soon as a host can open it.
    stopped : callable
        Function that returns True to end earlier.

    Returns
    -------
    list of dict
        True values of each drop, in SI units, with the units in the keys.

    Raises
    ------
    ScenarioError, EndpointError
        If the scenario is invalid or the port cannot be opened.
    """
    if not 0 <= options.rate < float("inf"):
        raise ScenarioError(f"rate: expected a number >= 0, got {options.rate}")
    if options.drops is not None and options.drops < 1:
        raise ScenarioError(f"drops: expected a whole number >= 1, got {options.drops}")
    scenario = load_scenario(options.scenario)
    endpoint: Endpoint
    instrument: PortlessInstrument | PortlessLogger
    kind, make_endpoint = LOGGERS[options.logger] if options.logger else (None, None)
    endpoint = make_endpoint() if make_endpoint is not None else open_endpoint(options.listen)
    with closing(endpoint):
        if kind is not None:
            instrument = kind(scenario, options.seed, options.drops)
        else:
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
    """Simulated instrument that runs in another process.

    Parameters
    ----------
    options : SimulateOptions

    Raises
    ------
    SimulationError
        If the instrument does not start; the message has the reason.
    """

    def __init__(self, options: SimulateOptions) -> None:
        settings = asdict(options)
        self._truth_text = ""
        self._listener: threading.Thread | None = None
        # The process ends with its standard input, and so with this process. Ctrl+C does not reach
        # it: the program that shows the drops stops the instrument in its own time.
        self._process = start_text_child(
            "-m", "simulators.instrument", json.dumps(settings, default=str)
        )
        try:
            self.url = self._first_line()
            """URL that the host opens."""
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
            raise SimulationError(
                reason[-1] if reason else "the simulated instrument ended without a message"
            )
        return str(json.loads(line)["url"])

    def _listen(self) -> None:
        """Read the true values, which the process writes at its end.

        They are read in a thread, so that a full pipe does not block the process.
        """
        assert self._process.stdout is not None
        self._truth_text = self._process.stdout.read()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait for the end of the instrument; return True if it has ended.

        Parameters
        ----------
        timeout : float or None, s
            Longest wait; None: no limit.
        """
        try:
            self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return False
        return True

    def stop(self) -> None:
        """End the instrument if it still runs."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        if not self.wait(STOP_TIMEOUT_S):
            self._process.kill()
            self._process.wait()

    def truth(self) -> list[dict[str, Any]]:
        """Return the true values of each drop, in SI units, after the end of the instrument.

        Raises
        ------
        SimulationError
            If the instrument still runs, or ended after an error.
        """
        if self._process.poll() is None:
            raise SimulationError(
                "truth: expected an instrument that has ended, got a running one; stop it first"
            )
        if self._listener is not None:
            self._listener.join()
        if not self._truth_text:
            raise SimulationError(
                "truth: expected true values, got none: the instrument ended with exit status "
                f"{self._process.returncode}"
            )
        return list(json.loads(self._truth_text))

    def close(self) -> None:
        """End the instrument and release its resources."""
        self.stop()
        if self._listener is not None:
            self._listener.join()
        for pipe in (self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()

    def __enter__(self) -> SimulatedInstrument:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def serve(
    scenario: str | Mapping[str, Any] = "default",
    *,
    listen: str | None = None,
    drops: int | None = None,
    seed: int = 0,
    rate: float = 1.0,
    logger: str | None = None,
) -> SimulatedInstrument:
    """Start a simulated instrument in another process; a host opens its `url`.

    Parameters
    ----------
    scenario : str or mapping
        Name of a built-in scenario, path of a TOML file, or its content.
    listen : str, optional
        Port: `pty` for a virtual serial port, or `tcp://HOST:PORT`. By default `pty` where the
        platform has it.
    drops : int, optional
        Number of drops; by default no end.
    seed : int
        Seed of the random numbers.
    rate : float
        Speed relative to real time; 0: as fast as the host reads.
    logger : "dataq", "dataq-ethernet" or "labjack", optional
        Data logger that measures the drops.

    Examples
    --------
    >>> with serve("soft", drops=3) as instrument:  # doctest: +SKIP
    ...     port = serial.Serial(instrument.url)
    """
    return SimulatedInstrument(SimulateOptions(listen, scenario, drops, seed, rate, logger))


def main(settings: str) -> int:
    """Run the instrument in the process that `SimulatedInstrument` started; return its exit status.

    Parameters
    ----------
    settings : str
        `SimulateOptions` as JSON.
    """
    options = SimulateOptions(**json.loads(settings))
    ended = threading.Event()

    def wait_for_end_of_input() -> None:
        # sys.stdin is not used: this thread would still have its lock when the interpreter ends.
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
    with suppress(OSError):  # the calling process may have ended
        sys.stdout.buffer.write(json.dumps(truth).encode())
        sys.stdout.buffer.flush()
    return 0
