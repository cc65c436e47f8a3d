"""Ports of this computer: instruments that answer, missing rights, and the conformance test.

The terminal uses this module, so that it need not import the protocol of the instrument.
"""

import importlib
import os
import shutil
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path

from pfwd.errors import SurveyError, refusal
from pfwd_device.acquisition.probing import PROBE_TIMEOUT_S, probe_all
from pfwd_device.acquisition.probing import Probe as Probe
from pfwd_device.conformance import Result as Result
from pfwd_device.conformance import conform as _conform
from pfwd_device.conformance.requirements import DROP_TIMEOUT_S, TITLES
from pfwd_device.transport.opening import BAUD_RATE, open_transport
from pfwd_device.transport.ports import Adapter as Adapter
from pfwd_device.transport.ports import Port as Port
from pfwd_device.transport.ports import list_ports as list_ports
from pfwd_device.wire.registry import all_dialects


def probe_ports(urls: Sequence[str], timeout: float = PROBE_TIMEOUT_S) -> list[Probe]:
    """Return what answers at each of some ports, in their order; a few seconds for all together."""
    return probe_all(urls, all_dialects(), timeout)


USB_DEVICES = Path("/sys/bus/usb/devices")

UDEV_RULES = (Path("/usr/lib/udev/rules.d"), Path("/etc/udev/rules.d"))

BRLTTY_ADAPTERS = frozenset({"0403:6001", "10c4:ea60", "1a86:7523"})
"""Serial adapters (FTDI, CP210x, CH340) that the driver of braille displays takes for its own."""


def port_advice(urls: Sequence[str]) -> list[str]:
    """Return advice on ports that are missing or may not be opened; Linux, one sentence each.

    Parameters
    ----------
    urls : sequence of str
        Of the ports that are listed.
    """
    return [*_rights(urls), *_brltty(USB_DEVICES)]


def _rights(urls: Sequence[str]) -> list[str]:
    closed = [url for url in urls if os.path.exists(url) and not os.access(url, os.R_OK | os.W_OK)]
    if not closed:
        return []
    group = _group_of(closed[0])
    return [
        f"no right to open {', '.join(closed)}: sudo usermod -aG {group} $USER, then log out and in"
    ]


def _group_of(path: str) -> str:
    try:
        return str(importlib.import_module("grp").getgrgid(os.stat(path).st_gid).gr_name)
    except (ImportError, KeyError, OSError):  # not on Windows; a group without a name
        return "dialout"


def _brltty(devices: Path) -> list[str]:
    """An adapter that is plugged in and has no port, while brltty is installed."""
    rules = (rule for folder in UDEV_RULES for rule in folder.glob("*brltty*.rules"))
    if shutil.which("brltty") is None and not any(rules):
        return []
    for device in sorted(devices.glob("*")) if devices.is_dir() else ():
        try:
            parts = [(device / part).read_text().strip() for part in ("idVendor", "idProduct")]
        except OSError:  # a hub's interface
            continue
        name = ":".join(parts)
        if name in BRLTTY_ADAPTERS and not any(device.glob("**/tty*")):
            return [
                f"the adapter {name} is plugged in and has no port: brltty (braille displays) "
                "takes it; sudo apt remove brltty, then plug it in again"
            ]
    return []


def conform(
    url: str,
    *,
    baud_rate: int = BAUD_RATE,
    drop_wait: float = DROP_TIMEOUT_S,
    announce: Callable[[str], None] = lambda text: None,
    only: Collection[str] = (),
) -> Iterator[Result]:
    """Try the instrument at a port, requirement by requirement.

    Parameters
    ----------
    url : str
        As for `pfwd log`.
    baud_rate : int
        Of a serial port.
    drop_wait : float, s
        How long to wait for a drop.
    announce : callable
        Receives what the operator should do.
    only : collection of str
        Numbers of those to try; empty: all.

    Raises
    ------
    PortError, DeviceRefused
        If the port cannot be opened, or drops wait in the instrument.
    SurveyError
        If there is no requirement of a number.
    """
    wrong = [number for number in only if number not in TITLES]
    if wrong:
        last = list(TITLES)[-1]
        raise SurveyError(refusal("--only", f"numbers from P-1 to {last}", ", ".join(wrong)))
    return _conform(
        lambda: open_transport(url, baud_rate), drop_wait=drop_wait, announce=announce, only=only
    )
