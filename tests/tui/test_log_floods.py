"""``pfwd log`` with an instrument that repeats its messages without end."""

import secrets
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from pfwd_device.wire.messages import Event, EventKind, InstrumentMessage
from simulators.instrument.device import PortlessInstrument
from simulators.instrument.run import open_endpoint
from simulators.instrument.scenario import load_scenario
from simulators.instrument.server import Server
from tests.tui.console import PATIENCE, PLAIN, checked, running

BACKLOG = 100_000
"""Bytes that are ready to be sent at any time."""


class Flooding(PortlessInstrument):
    """Instrument that sends events and other messages at every moment; `n_sent` counts them."""

    kinds: Sequence[EventKind] = ()
    messages: Sequence[InstrumentMessage] = ()
    n_sent = 0

    def advance(self, seconds: float) -> None:
        super().advance(seconds)
        while (self.kinds or self.messages) and self.sampling and len(self.output) < BACKLOG:
            for kind in self.kinds:
                self._event(kind)
            for message in self.messages:
                self._send(message)
            self.n_sent += len(self.kinds) + len(self.messages)


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


LONGEST_END = 5.0
"""s from the signal; a service that is stopped waits for it."""


def wait(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.05)


def flooded(
    flood: tuple[Flooding, str], survey: Path, *options: str, count: int = 50_000, **messages: Any
) -> tuple[float, str]:
    """Return the time of the end after a number of messages, and the printed text."""
    instrument, url = flood
    with running("log", url, "-o", survey, *options) as process:
        wait(lambda: instrument.sampling)
        for name, value in messages.items():
            setattr(instrument, name, value)
        wait(lambda: instrument.n_sent > count)
        start = time.monotonic()
        process.send_signal(signal.SIGTERM)
        printed = process.communicate(timeout=PATIENCE)
        duration = time.monotonic() - start
        assert process.returncode == 0, printed[1]
    assert checked(survey)["ok"]
    return duration, "".join(printed)


@pytest.mark.posix
@pytest.mark.parametrize("rate", [0.0, pytest.param(1.0, marks=pytest.mark.slow)])
def test_a_flood_of_triggers_does_not_hold_up_the_end(rate: float, tmp_path: Path) -> None:
    with flooding(rate) as flood:
        duration, text = flooded(flood, tmp_path / "s", kinds=[EventKind.TRIGGER])
    assert duration < LONGEST_END
    assert len(text) < 100_000


@pytest.mark.slow
@pytest.mark.posix
@pytest.mark.parametrize(
    ("kind", "word"),
    [(EventKind.LOW_BATTERY, "battery"), (EventKind.BOOT, "the instrument restarted")],
)
def test_a_flood_of_events_is_a_limited_number_of_lines(
    kind: EventKind, word: str, tmp_path: Path
) -> None:
    with flooding() as flood:
        duration, text = flooded(flood, tmp_path / "s", "--no-invert", kinds=[kind])
    assert duration < LONGEST_END
    assert word in text
    assert "more messages of the instrument about" in text
    assert len(text.splitlines()) < 60


@pytest.mark.slow
@pytest.mark.posix
def test_a_flood_of_connections_is_a_limited_number_of_lines_and_records(tmp_path: Path) -> None:
    with flooding() as flood:
        identity = flood[0].scenario.device.identity(10_000.0)
        messages = [Event(EventKind.BOOT, 0), identity]
        duration, text = flooded(
            flood, tmp_path / "s", "--no-invert", count=2_000, messages=messages
        )
    assert duration < LONGEST_END
    assert len(text.splitlines()) < 120
    assert sum(path.stat().st_size for path in (tmp_path / "s" / "journal").iterdir()) < 200_000
