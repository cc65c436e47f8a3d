"""A simulated instrument that says the same event without end, as fast as it is listened to."""

import secrets
import threading
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager

from pfwd_device.wire.messages import EventKind, InstrumentMessage
from simulators.instrument.device import PortlessInstrument
from simulators.instrument.run import open_endpoint
from simulators.instrument.scenario import load_scenario
from simulators.instrument.server import Server
from tests.tui.console import PLAIN

BACKLOG = 100_000
"""Bytes that lie ready to be sent: there is always more of it."""


class Flooding(PortlessInstrument):
    """Says events, and other messages, at every moment.

    `kinds` may be set meanwhile; `said` counts.
    """

    kinds: Sequence[EventKind] = ()
    messages: Sequence[InstrumentMessage] = ()
    mute = False
    """Whether no samples come any more."""
    said = 0

    def advance(self, seconds: float) -> None:
        if not self.mute:
            super().advance(seconds)
        while (self.kinds or self.messages) and self.sampling and len(self.output) < BACKLOG:
            for kind in self.kinds:
                self._event(kind)
            for message in self.messages:
                self._send(message)
            self.said += len(self.kinds) + len(self.messages)


@contextmanager
def flooding(rate: float = 1.0) -> Iterator[tuple[Flooding, str]]:
    """The instrument and its URL; it ends with the block."""
    stopped = threading.Event()
    with closing(open_endpoint("tcp://127.0.0.1:0")) as endpoint:
        instrument = Flooding(
            load_scenario(PLAIN), 1, None, overruns=False, power_on=secrets.randbits(32)
        )
        server = Server(instrument, endpoint, rate, stopped.is_set)
        thread = threading.Thread(target=server.run, daemon=True)
        thread.start()
        try:
            yield instrument, endpoint.url
        finally:
            stopped.set()
            thread.join()
