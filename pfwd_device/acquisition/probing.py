"""Search of the ports of this computer for instruments."""

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from pfwd_device.errors import DeviceError
from pfwd_device.identity import Identity
from pfwd_device.transport.base import Transport
from pfwd_device.transport.opening import open_transport
from pfwd_device.transport.ports import adapter_of
from pfwd_device.wire.messages import Hello
from pfwd_device.wire.registry import DeclaredLink, DialectEntry

PROBE_TIMEOUT_S = 1.5
"""Longest wait for a response at a port, s: an instrument responds at once, or after a second if it
resets when its port is opened."""
_PROBE_INTERVAL_S = 0.4
_OPENING_TIMEOUT_S = 3.5
"""Longest time to open a port, s: some Bluetooth ports never open."""
_MAX_PROBED_BYTES = 65536


@dataclass(frozen=True, slots=True)
class Probe:
    """Result of the search for an instrument at one port."""

    url: str
    """Port."""
    answers: str | None
    """Name of the detected dialect; None if no dialect was detected."""
    identity: Identity | None
    """Identity of the instrument; None if it reports none, for example one that prints lines."""
    reason: str
    """Result and its reason as a sentence for the user."""


def probe(
    url: str,
    dialects: Sequence[DialectEntry],
    timeout: float = PROBE_TIMEOUT_S,
) -> Probe:
    """Search for an instrument at one port.

    Parameters
    ----------
    url : str
        Port; see `pfwd_device.transport.opening.open_transport`.
    dialects : sequence of DialectEntry
        Dialects to try. Each requests the identity or recognises bytes that arrive without a
        request.
    timeout : float, s
        Longest wait for a response after the port was opened.

    Returns
    -------
    Probe
        The result for a port that cannot be opened has the error as its `reason`.
    """
    try:
        transport = open_transport(url)
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
    # What other dialects send could confuse an instrument whose link belongs to one of them.
    own = [entry for entry in entries if url.startswith(f"{entry.scheme or entry.name}://")]
    entries = own or [entry for entry in entries if not entry.scheme]
    # A dialect that needs a declared identity cannot decode before a setup file declares it.
    dialects = [entry.make(DeclaredLink()) for entry in entries if not entry.needs_identity]
    received = b""
    now = time.monotonic()
    end, next_request = now + timeout, now
    while now < end:
        if now >= next_request:
            next_request = now + _PROBE_INTERVAL_S
            for entry in entries:
                if entry.question:
                    transport.write(entry.question)
            for dialect in dialects:
                if request := dialect.encode(Hello()):
                    transport.write(request)
        data = transport.read(min(end, next_request) - now)
        received = (received + data)[-_MAX_PROBED_BYTES:]
        for dialect in dialects:
            for message in dialect.feed(data):
                if isinstance(message, Identity):
                    reason = f"answers as {message.model} {message.serial_number}"
                    return Probe(url, dialect.name, message, reason)
        for entry in entries:
            if entry.recognises is not None and entry.recognises(received):
                verb = "is a" if entry.question else "sends"
                reason = f"{verb} {entry.title}; declare the instrument in a setup file"
                return Probe(url, entry.name, None, reason)
        now = time.monotonic()
    if received:
        return Probe(url, None, None, "sends data, but is no known PFWD; maybe another device")
    return Probe(url, None, None, "silent; check that an instrument is connected and switched on")


class _ProbeThread(threading.Thread):
    """Thread that probes one port; it is abandoned if the port never opens."""

    def __init__(self, url: str, dialects: Sequence[DialectEntry], timeout: float) -> None:
        super().__init__(name=f"pfwd-probe {url}", daemon=True)
        self._arguments = (url, dialects, timeout)
        self.result = Probe(url, None, None, "did not open in time; maybe a wireless port")

    def run(self) -> None:
        self.result = probe(*self._arguments)


def probe_all(
    urls: Sequence[str], dialects: Sequence[DialectEntry], timeout: float | None = PROBE_TIMEOUT_S
) -> list[Probe]:
    """Search several ports for instruments at the same time; return the results in their order.

    A port whose USB numbers belong to a dialect is asked in this dialect only. Its reason begins
    with the model, also if it is in use or does not answer.

    Parameters
    ----------
    urls : sequence of str
        Ports.
    dialects : sequence of DialectEntry
        Dialects to try.
    timeout : float or None, s
        Longest wait for a response at one port; None: do not open the ports.
    """
    models = [_usb_model(url, dialects) for url in urls]
    probes = [Probe(url, None, None, "not tested") for url in urls]
    if timeout is not None:
        threads = [
            _ProbeThread(url, dialects if model is None else [model[0]], timeout)
            for url, model in zip(urls, models, strict=True)
        ]
        for thread in threads:
            thread.start()
        deadline = time.monotonic() + timeout + _OPENING_TIMEOUT_S
        for thread in threads:
            thread.join(max(0.0, deadline - time.monotonic()))
        probes = [thread.result for thread in threads]
    return [
        replace(probe, reason=f"{model[1]} by its USB numbers: {probe.reason}") if model else probe
        for probe, model in zip(probes, models, strict=True)
    ]


def _usb_model(url: str, dialects: Sequence[DialectEntry]) -> tuple[DialectEntry, str] | None:
    """Return the dialect and the model to which the USB numbers of a port belong."""
    adapter = adapter_of(url)
    if adapter is None:
        return None
    names = [(entry, entry.usb_model(adapter.vid, adapter.pid)) for entry in dialects]
    return next(((entry, model) for entry, model in names if model is not None), None)
