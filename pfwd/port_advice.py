"""Why this computer shows no port, or does not let one be opened: what can be seen without it."""

import importlib
import os
import shutil
from collections.abc import Sequence
from pathlib import Path

USB_DEVICES = Path("/sys/bus/usb/devices")

UDEV_RULES = (Path("/usr/lib/udev/rules.d"), Path("/etc/udev/rules.d"))

TAKEN_BY_BRLTTY = frozenset({"0403:6001", "10c4:ea60", "1a86:7523"})
"""Serial adapters (FTDI, CP210x, CH340) that the driver of braille displays takes for its own."""


def port_advice(urls: Sequence[str]) -> list[str]:
    """What to do about ports that are not there or may not be opened; Linux, one sentence each.

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
        if name in TAKEN_BY_BRLTTY and not any(device.glob("**/tty*")):
            return [
                f"the adapter {name} is plugged in and has no port: brltty (braille displays) "
                "takes it; sudo apt remove brltty, then plug it in again"
            ]
    return []
