"""Loop that connects a simulated instrument to a port and to a clock, in real time or faster."""

from __future__ import annotations

import time
from collections.abc import Callable

from simulators.instrument.device import PortlessInstrument
from simulators.instrument.endpoint import Endpoint
from simulators.loggers import PortlessLogger

TICK_S = 0.01
"""Longest time between two readings of the clock, s."""
STATUS_INTERVAL_S = 0.4
"""Real time between two status messages, s."""
STRIDE_S = 0.25
"""Simulated time of one step when the simulation runs as fast as the host reads, s."""
FULL_OUTPUT_BYTES = 262_144
"""Number of bytes that may wait for the host. With more the simulated time stops, except at the
speed of real time."""
MAX_BACKLOG_BYTES = 16_777_216
"""Number of waiting bytes above which no more status messages are sent."""
FINAL_FLUSH_TIMEOUT_S = 300.0
"""Longest wait at the end of the simulation for a host that reads nothing, s."""
UNPLUG_FLUSH_TIMEOUT_S = 2.0
"""Longest wait for a host that reads nothing before the cable is unplugged, s."""


class Server:
    """Loop that passes bytes between a simulated instrument and a port, and advances its time.

    Parameters
    ----------
    instrument : PortlessInstrument or PortlessLogger
    endpoint : Endpoint
        Port to which a host connects.
    rate : float
        Speed relative to real time; 0: as fast as the host reads.
    stopped : callable
        Function that returns True to end the loop; it is called at least every `TICK_S`.
    clock : callable
        Function that returns the time, s.
    """

    def __init__(
        self,
        instrument: PortlessInstrument | PortlessLogger,
        endpoint: Endpoint,
        rate: float = 1.0,
        stopped: Callable[[], bool] = lambda: False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._instrument, self._endpoint = instrument, endpoint
        self._rate, self._stopped, self._clock = rate, stopped, clock
        self._visit = 0  # number of the connection; 0: no host
        self._last = self._last_status = clock()

    def run(self) -> None:
        """Run the loop until the host has the last message of the instrument, or until stopped."""
        instrument = self._instrument
        while not instrument.ended and not self._stopped():
            self._turn()
            if instrument.unplugged is not None:
                self._pull_the_cable()
        if instrument.ended:
            self._flush(FINAL_FLUSH_TIMEOUT_S)

    def _turn(self) -> None:
        """Run one cycle: receive bytes, advance the simulated time, and send bytes."""
        instrument = self._instrument
        hurrying = (
            self._rate == 0 and instrument.sampling and len(instrument.output) < FULL_OUTPUT_BYTES
        )
        idle = 0.0 if hurrying else TICK_S
        self._endpoint.wait(idle, writing=bool(instrument.output) and not instrument.stalled)
        self._exchange()
        now = self._clock()
        passed, self._last = now - self._last, now
        status_due = now - self._last_status >= STATUS_INTERVAL_S
        if self._visit and status_due and len(instrument.output) < MAX_BACKLOG_BYTES:
            self._last_status = now
            instrument.status()
        room = self._rate == 1 or len(instrument.output) < FULL_OUTPUT_BYTES or instrument.stalled
        if room and instrument.ready:
            sprint = self._rate == 0 and instrument.sampling
            instrument.advance(STRIDE_S if sprint else passed * (self._rate or 1.0))
        self._write()

    def _exchange(self) -> None:
        """Report a new or a lost host to the instrument, and pass it the received bytes."""
        endpoint, instrument = self._endpoint, self._instrument
        connected = endpoint.connected
        if self._visit and (not connected or endpoint.visits != self._visit):
            instrument.disconnect()
            self._visit = 0
        if connected and not self._visit:
            self._visit = endpoint.visits
            instrument.connect()
        data = endpoint.read()
        if data:
            instrument.receive(data)

    def _write(self) -> None:
        instrument = self._instrument
        if not self._visit:
            return
        while instrument.output and not instrument.stalled:
            # Copied, because a bytearray with a view on it cannot be shortened.
            count = self._endpoint.write(bytes(instrument.output[:65_536]))
            if count == 0:
                break
            instrument.sent(count)

    def _flush(self, patience: float) -> None:
        """Wait until the host has read all bytes, or has read nothing for `patience` seconds."""
        instrument, endpoint = self._instrument, self._endpoint
        waiting, since, finished = -1, self._clock(), False
        while endpoint.connected and not self._stopped():
            endpoint.wait(TICK_S, writing=bool(instrument.output))
            data = endpoint.read()  # a host that still sends must not block
            if data and not finished:
                instrument.receive(data)
            if not finished:
                self._write()
            if not instrument.output and not finished:
                finished = True
                endpoint.finish()
            if finished and endpoint.drained():
                return
            if len(instrument.output) != waiting:
                waiting, since = len(instrument.output), self._clock()
            elif self._clock() - since > patience:
                return

    def _pull_the_cable(self) -> None:
        """Unplug the cable when the host has all bytes, wait, and plug it in again."""
        instrument, fault = self._instrument, self._instrument.unplugged
        seconds = 0.0 if fault is None else fault.seconds
        self._flush(UNPLUG_FLUSH_TIMEOUT_S)
        self._endpoint.unplug()
        self._visit = 0
        until = self._clock() + seconds / (self._rate or 1.0)
        while self._clock() < until and not self._stopped():
            time.sleep(min(TICK_S, max(0.0, until - self._clock())))
        instrument.pass_unplugged(seconds)
        self._endpoint.plug()
        instrument.plug()
        self._last = self._clock()
