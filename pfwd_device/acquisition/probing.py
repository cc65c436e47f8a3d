"""Asks ports whether an instrument answers there."""

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass

from pfwd_device.errors import DeviceError
from pfwd_device.identity import Identity
from pfwd_device.transport.base import Transport
from pfwd_device.transport.opening import BAUD_RATE, open_transport
from pfwd_device.wire.messages import Hello
from pfwd_device.wire.registry import DeclaredLink, DialectEntry

PROBE_TIMEOUT = 1.5
"""s; the instrument answers at once, one that resets when its port is opened a second later."""
_REQUEST_EVERY = 0.4
_OPENING_TIME = 3.5
"""s; some ports (Bluetooth) take for ever to open and are given up."""
_LONGEST_LOOK = 65536


@dataclass(frozen=True, slots=True)
class Probe:
    """What is at a port."""

    url: str
    answers: str | None
    """Name of the dialect that is spoken there; None: nothing that this program understands."""
    identity: Identity | None
    """What the instrument says of itself; None: nothing, as one that sends lines."""
    reason: str
    """Why it is taken for what it is, one sentence."""


def probe(
    url: str,
    dialects: Sequence[DialectEntry],
    timeout: float = PROBE_TIMEOUT,
    baud_rate: int = BAUD_RATE,
) -> Probe:
    """Who answers at a port, after at most `timeout` s and what opening it takes.

    Parameters
    ----------
    url : str
        See `pfwd_device.transport.opening.open_transport`.
    dialects : sequence of DialectEntry
        Asked for the identity, or recognised by what comes unasked.
    timeout : float, s
    baud_rate : int

    Returns
    -------
    Probe
        Never an error: a port that cannot be opened is one of the answers.
    """
    try:
        transport = open_transport(url, baud_rate)
    except DeviceError as err:
        return Probe(url, None, None, str(err))
    try:
        return _request(transport, url, dialects, timeout)
    except DeviceError as err:
        return Probe(url, None, None, str(err))
    finally:
        transport.close()


def _request(
    transport: Transport, url: str, entries: Sequence[DialectEntry], timeout: float
) -> Probe:
    # What needs a declared identity cannot be spoken before somebody declares one.
    dialects = [entry.make(DeclaredLink()) for entry in entries if not entry.needs_identity]
    seen = b""
    now = time.monotonic()
    end, next_request = now + timeout, now
    while now < end:
        if now >= next_request:
            next_request = now + _REQUEST_EVERY
            for dialect in dialects:
                if question := dialect.encode(Hello()):
                    transport.write(question)
        data = transport.read(min(end, next_request) - now)
        seen = (seen + data)[-_LONGEST_LOOK:]
        for dialect in dialects:
            for message in dialect.feed(data):
                if isinstance(message, Identity):
                    reason = f"answers as {message.model} {message.serial_number}"
                    return Probe(url, dialect.name, message, reason)
        for entry in entries:
            if entry.recognises is not None and entry.recognises(seen):
                reason = f"sends {entry.title}; a setup file has to say what they are"
                return Probe(url, entry.name, None, reason)
        now = time.monotonic()
    if seen:
        return Probe(url, None, None, "sends something, but not as a PFWD; is it another device?")
    return Probe(url, None, None, "silent; is an instrument connected and switched on?")


class _ProbeThread(threading.Thread):
    """Probes one port; left alone when the port never opens."""

    def __init__(
        self, url: str, dialects: Sequence[DialectEntry], timeout: float, rate: int
    ) -> None:
        super().__init__(name=f"pfwd-probe {url}", daemon=True)
        self._arguments = (url, dialects, timeout, rate)
        self.answer = Probe(url, None, None, "did not open in time; is it a wireless port?")

    def run(self) -> None:
        self.answer = probe(*self._arguments)


def probe_all(
    urls: Sequence[str],
    dialects: Sequence[DialectEntry],
    timeout: float = PROBE_TIMEOUT,
    baud_rate: int = BAUD_RATE,
) -> list[Probe]:
    """Who answers at each of some ports, in their order; all are asked at the same time.

    Parameters
    ----------
    urls : sequence of str
    dialects : sequence of DialectEntry
    timeout : float, s
        For one port.
    baud_rate : int
    """
    threads = [_ProbeThread(url, dialects, timeout, baud_rate) for url in urls]
    for thread in threads:
        thread.start()
    deadline = time.monotonic() + timeout + _OPENING_TIME
    for thread in threads:
        thread.join(max(0.0, deadline - time.monotonic()))
    return [thread.answer for thread in threads]
