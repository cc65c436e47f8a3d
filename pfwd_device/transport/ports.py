"""Which ports there are, and which of them was the instrument's.

A serial port's name may change when the adapter is plugged in again; what the adapter says of
itself on the USB does not.
"""

import glob
import os
from dataclasses import dataclass

from serial.tools import list_ports as _serial_ports

from pfwd_device.text import clean


@dataclass(frozen=True, slots=True)
class Adapter:
    """What tells one USB adapter from another, whatever its port is called."""

    vid: int
    pid: int
    serial_number: str | None
    """None: it has none, as many cheap adapters; then a second one of its kind is its equal."""


@dataclass(frozen=True, slots=True)
class Port:
    """A serial port of this computer."""

    url: str
    """What to open."""
    description: str
    """For people; as the adapter says it, made harmless."""
    adapter: Adapter | None = None
    """None: not on the USB."""
    by_id: str | None = None
    """A name that stays with the adapter, where the platform gives one (Linux)."""


def list_ports() -> list[Port]:
    """The serial ports of this computer, by name."""
    by_id = {os.path.realpath(link): link for link in sorted(glob.glob("/dev/serial/by-id/*"))}
    ports = []
    for found in _serial_ports.comports():
        adapter = None
        if found.vid is not None and found.pid is not None:
            number = clean(found.serial_number) if found.serial_number else None
            adapter = Adapter(found.vid, found.pid, number)
        description = found.description if found.description != "n/a" else found.device
        link = by_id.get(os.path.realpath(found.device))
        ports.append(Port(found.device, clean(description or found.device), adapter, link))
    return sorted(ports, key=lambda port: port.url)


def adapter_of(url: str) -> Adapter | None:
    """The USB adapter that a port hangs on; None when it is none or cannot be told."""
    return next((port.adapter for port in list_ports() if _same_name(port.url, url)), None)


def find_again(url: str, adapter: Adapter | None) -> list[str]:
    """Where to look for an instrument that was lost, best first.

    Parameters
    ----------
    url : str
        What it was first opened as.
    adapter : Adapter or None
        The USB adapter that it hung on then.

    Returns
    -------
    list of str
        The ports of that adapter, the old name first if it is among them. Without one the old
        name, which may be a link that points elsewhere by now or a port that is not there yet, but
        never a port of another adapter that got the old name.
    """
    if adapter is None:
        return [url]
    ports = list_ports()
    same = [port.url for port in ports if port.adapter == adapter]
    if same:
        return sorted(
            (url if _same_name(name, url) else name for name in same), key=lambda name: name != url
        )
    taken = any(port.adapter is not None and _same_name(port.url, url) for port in ports)
    return [] if taken else [url]


def _same_name(name: str, url: str) -> bool:
    return name == url or ("://" not in url and os.path.realpath(name) == os.path.realpath(url))
