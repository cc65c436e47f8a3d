"""Serial ports of this computer: which instruments answer, advice on rights, conformance test.

The terminal uses this module instead of importing the protocol of the instrument.
"""

import importlib
import os
import shutil
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path

from pfwd.errors import OptionError, refusal
from pfwd_device.acquisition.probing import PROBE_TIMEOUT_S, probe_all
from pfwd_device.acquisition.probing import Probe as Probe
from pfwd_device.conformance import Result as Result
from pfwd_device.conformance import conform as _conform
from pfwd_device.conformance.instrument_link import DROP_TIMEOUT_S
from pfwd_device.conformance.requirements import REQUIREMENTS
from pfwd_device.transport.opening import BAUD_RATE, open_transport
from pfwd_device.transport.ports import Adapter as Adapter
from pfwd_device.transport.ports import Port as Port
from pfwd_device.transport.ports import is_same_port as is_same_port
from pfwd_device.transport.ports import list_ports as list_ports
from pfwd_device.wire.registry import all_dialects


def probe_ports(urls: Sequence[str], timeout: float | None = PROBE_TIMEOUT_S) -> list[Probe]:
    """Find out which instrument answers at each of several ports; takes a few seconds in all.

    Parameters
    ----------
    urls : sequence of str
        Ports, as for `pfwd log`.
    timeout : float or None, s
        Longest wait for an answer; None: do not open the ports.

    Returns
    -------
    list of Probe
        In the order of the ports.
    """
    return probe_all(urls, all_dialects(), timeout)


USB_DEVICES = Path("/sys/bus/usb/devices")

UDEV_RULES = (Path("/usr/lib/udev/rules.d"), Path("/etc/udev/rules.d"))

BRLTTY_ADAPTERS = frozenset({"0403:6001", "10c4:ea60", "1a86:7523"})
"""USB adapters (FTDI, CP210x, CH340) that brltty, a driver of braille displays, takes over."""


def port_advice(urls: Sequence[str]) -> list[str]:
    """Return advice on ports that are missing or cannot be opened, one sentence each; Linux only.

    Parameters
    ----------
    urls : sequence of str
        Ports that the operating system lists.
    """
    # Windows would open each port to find out whether it exists.
    return [*_rights(urls), *_brltty(USB_DEVICES)] if sys.platform == "linux" else []


def _rights(urls: Sequence[str]) -> list[str]:
    closed = [url for url in urls if os.path.exists(url) and not os.access(url, os.R_OK | os.W_OK)]
    if not closed:
        return []
    group = _group_of(closed[0])
    return [
        f"no permission to open {', '.join(closed)}. Run: sudo usermod -aG {group} $USER, then log "
        "out and in"
    ]


def _group_of(path: str) -> str:
    try:
        return str(importlib.import_module("grp").getgrgid(os.stat(path).st_gid).gr_name)
    except (ImportError, KeyError, OSError):  # not on Windows; a group without a name
        return "dialout"


def _brltty(devices: Path) -> list[str]:
    """Return advice if brltty is installed and an adapter has no port because of it."""
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
                f"the adapter {name} is connected, but has no port: brltty (braille displays) has "
                "taken it over. Run: sudo apt remove brltty, then connect the adapter again"
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
    """Test whether the instrument at a port fulfils the requirements of the protocol.

    The requirements P-1, P-2, ... are those of docs/protocol.md.

    Parameters
    ----------
    url : str
        Port, as for `pfwd log`.
    baud_rate : int
        Baud rate of a serial port.
    drop_wait : float, s
        Longest wait for a drop.
    announce : callable
        Receives sentences that ask the operator to act, for instance to make a drop.
    only : collection of str
        Numbers of the requirements to test, such as "P-7"; empty: all.

    Yields
    ------
    Result
        One for each tested requirement.

    Raises
    ------
    PortError, DeviceRefused
        If the port cannot be opened, or the instrument has buffered drops, which the test could
        lose.
    OptionError
        If `only` has an unknown number.
    """
    wrong = [number for number in only if number not in REQUIREMENTS]
    if wrong:
        last = list(REQUIREMENTS)[-1]
        raise OptionError(refusal("--only", f"numbers from P-1 to {last}", ", ".join(wrong)))
    return _conform(
        lambda: open_transport(url, baud_rate), drop_wait=drop_wait, announce=announce, only=only
    )
