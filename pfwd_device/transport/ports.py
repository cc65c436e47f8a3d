"""List of the serial ports, and search for the port of a known USB adapter.

The name of a serial port may change when the adapter is plugged in again; the USB identity of the
adapter does not.
"""

import glob
import os
import sys
from dataclasses import dataclass

from serial.tools import list_ports as _serial_ports

from pfwd_device.text import clean


@dataclass(frozen=True, slots=True)
class Adapter:
    """USB identity of a serial adapter, which does not change with the name of its port."""

    vid: int
    """USB number of the maker."""
    pid: int
    """USB number of the product."""
    serial_number: str | None
    """Serial number; None for many cheap adapters, so that two of one model are equal."""


@dataclass(frozen=True, slots=True)
class Port:
    """A serial port of this computer."""

    url: str
    """Name with which it is opened, such as COM3 or /dev/ttyUSB0."""
    description: str
    """Description that the adapter reports, without control characters."""
    adapter: Adapter | None = None
    """USB adapter; None for a port without USB."""
    by_id: str | None = None
    """Path below /dev/serial/by-id that does not change when the adapter is plugged in again; None
    on other systems than Linux."""


def list_ports() -> list[Port]:
    """Return the serial ports of this computer, sorted by name."""
    by_id = {_port_key(link): link for link in sorted(glob.glob("/dev/serial/by-id/*"))}
    ports = []
    for info in _serial_ports.comports():
        adapter = None
        if info.vid is not None and info.pid is not None:
            number = clean(info.serial_number) if info.serial_number else None
            adapter = Adapter(info.vid, info.pid, number)
        description = info.description if info.description != "n/a" else info.device
        link = by_id.get(_port_key(info.device))
        ports.append(Port(info.device, clean(description or info.device), adapter, link))
    return sorted(ports, key=lambda port: port.url)


def adapter_of(url: str) -> Adapter | None:
    """Return the USB adapter of a port; None if the port has none or is not in the list."""
    return next((port.adapter for port in list_ports() if is_same_port(port.url, url)), None)


def candidate_urls(url: str, adapter: Adapter | None) -> list[str]:
    """Return the ports at which a lost instrument may be connected again, the most likely first.

    Parameters
    ----------
    url : str
        Port at which it was first opened.
    adapter : Adapter or None
        USB adapter of that port.

    Returns
    -------
    list of str
        The ports that have this adapter now, the old name first if it is among them. If no port
        has it, the old name: the port may appear later. Empty if another adapter has the old name.
    """
    if adapter is None:
        return [url]
    ports = list_ports()
    same = [port.url for port in ports if port.adapter == adapter]
    if same:
        return sorted(
            (url if is_same_port(name, url) else name for name in same),
            key=lambda name: name != url,
        )
    is_reused = any(port.adapter is not None and is_same_port(port.url, url) for port in ports)
    return [] if is_reused else [url]


def is_same_port(name: str, url: str) -> bool:
    """Return True if two names are names of one port."""
    return name == url or ("://" not in url and _port_key(name) == _port_key(url))


def _port_key(name: str) -> str:
    """Return a text that is the same for all names of a port."""
    if os.name == "nt":
        # No realpath: it opens the port, which may be in use or broken.
        return name.replace("/", "\\").removeprefix("\\\\.\\").rstrip(":").lower()
    path = os.path.realpath(name)
    if sys.platform == "darwin":  # two names of one port; only cu.* is listed
        path = path.replace("/dev/tty.", "/dev/cu.", 1)
    return path
