"""The loop that lets an instrument live at an endpoint, in real time or faster."""

from __future__ import annotations

import time
from collections.abc import Callable

from simulators.instrument.device import PortlessInstrument
from simulators.instrument.endpoint import Endpoint

TICK = 0.01
"""s; the loop looks at the clock at least so often."""
STATUS_INTERVAL = 0.4
"""s of real time between two messages of status."""
STRIDE = 0.25
"""s of simulated time that are made at a time when there is no clock to follow."""
FULL = 262_144
"""Bytes that may wait for the reader; then, except in real time, the clock stands still."""
MOST_BACKLOG = 16_777_216
"""Bytes; whoever reads nothing of them is told nothing more."""
PATIENCE = 300.0
"""s for which the end waits for a reader who reads nothing."""
DRAIN_PATIENCE = 2.0
"""s for which the cable stays in for a reader who does not read."""


class Server:
    """Serves one instrument at one endpoint.

    Parameters
    ----------
    instrument, endpoint
    rate : float
        Times real time; 0: as fast as the host reads.
    stopped : callable
        Whether to end now; asked every `TICK`.
    clock : seconds, for tests
    """

    def __init__(
        self,
        instrument: PortlessInstrument,
        endpoint: Endpoint,
        rate: float = 1.0,
        stopped: Callable[[], bool] = lambda: False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._instrument, self._endpoint = instrument, endpoint
        self._rate, self._stopped, self._clock = rate, stopped, clock
        self._visit = 0  # number of the host that is there; 0: none
        self._last = self._told = clock()

    def run(self) -> None:
        """Until the instrument has said everything and the host has it, or until stopped."""
        instrument = self._instrument
        while not instrument.ended and not self._stopped():
            self._turn()
            if instrument.unplugged is not None:
                self._pull_the_cable()
        if instrument.ended:
            self._flush(PATIENCE)

    def _turn(self) -> None:
        """Listen, let time pass, speak."""
        instrument = self._instrument
        hurrying = self._rate == 0 and instrument.sampling and len(instrument.output) < FULL
        idle = 0.0 if hurrying else TICK
        self._endpoint.wait(idle, writing=bool(instrument.output) and not instrument.stalled)
        self._exchange()
        now = self._clock()
        passed, self._last = now - self._last, now
        told = now - self._told >= STATUS_INTERVAL
        if self._visit and told and len(instrument.output) < MOST_BACKLOG:
            self._told = now
            instrument.status()
        room = self._rate == 1 or len(instrument.output) < FULL or instrument.stalled
        if room and instrument.ready:
            sprint = self._rate == 0 and instrument.sampling
            instrument.advance(STRIDE if sprint else passed * (self._rate or 1.0))
        self._write()

    def _exchange(self) -> None:
        """Notice who comes and goes, and hear what is said."""
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
            # Copied, not viewed: a bytearray cannot be shortened while somebody looks at it.
            count = self._endpoint.write(bytes(instrument.output[:65_536]))
            if count == 0:
                break
            instrument.sent(count)

    def _flush(self, patience: float) -> None:
        """Wait until the host has read what there is, or has not moved for a while; then no more
        is said."""
        instrument, endpoint = self._instrument, self._endpoint
        waiting, since, finished = -1, self._clock(), False
        while endpoint.connected and not self._stopped():
            endpoint.wait(TICK, writing=bool(instrument.output))
            data = endpoint.read()  # a host may still say something, and must not block
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
        """Unplug when the host has everything, wait, and plug in again."""
        instrument, fault = self._instrument, self._instrument.unplugged
        seconds = 0.0 if fault is None else fault.seconds
        self._flush(DRAIN_PATIENCE)
        self._endpoint.unplug()
        self._visit = 0
        until = self._clock() + seconds / (self._rate or 1.0)
        while self._clock() < until and not self._stopped():
            time.sleep(min(TICK, max(0.0, until - self._clock())))
        instrument.pass_unplugged(seconds)
        self._endpoint.plug()
        instrument.plug()
        self._last = self._clock()
