"""``pfwd ports``: serial ports, with what answers as a PFWD."""

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

from pfwd.export.json_text import json_text
from pfwd.ports import Port, Probe, list_ports, port_advice, probe_ports
from tui.arguments import add_json
from tui.output import clean, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd ports``."""
    parser.description = (
        "Lists the serial ports of this computer and tests each for an instrument. A port without "
        "an answer is listed with the reason and what to try."
    )
    parser.add_argument(
        "urls",
        nargs="*",
        metavar="URL",
        help="test only these, for example /dev/ttyUSB0, COM3 or socket://HOST:PORT",
    )
    parser.add_argument("--no-probe", action="store_true", help="do not open the ports")
    add_json(parser, "port")


def run(args: argparse.Namespace) -> int:
    """List the ports, or look at those named; neither a port in use nor a silent one is an error.

    Returns
    -------
    int
        0.
    """
    listed = list_ports()
    ports = listed
    if args.urls:
        known = {name: port for port in listed for name in (port.url, port.by_id)}
        ports = [known.get(url) or Port(url, url) for url in args.urls]
    probes: list[Probe | None] = [None] * len(ports)
    if ports and not args.no_probe:
        say(f"asking {len(ports)} port{'s' if len(ports) > 1 else ''} for an instrument")
        probes = [*probe_ports([port.url for port in ports])]
    if args.json:
        for port, probe in zip(ports, probes, strict=True):
            print(json_text(record(port, probe)), flush=True)
    elif ports:
        print_table([row(port, probe) for port, probe in zip(ports, probes, strict=True)])
    if not ports:
        say("no serial ports; is the adapter plugged in, and does it have a driver?")
    for text in port_advice([port.url for port in ports]):
        say(text)
    return 0


def record(port: Port, probe: Probe | None) -> dict[str, Any]:
    """A port as an object for machines."""
    adapter = port.adapter
    return {
        "url": clean(port.url),
        "description": clean(port.description),
        "vid": adapter and adapter.vid,
        "pid": adapter and adapter.pid,
        "port_serial_number": adapter and adapter.serial_number,
        "by_id": port.by_id,
        "answers": probe and probe.answers,
        "identity": _identity(probe),
        "reason": clean(probe.reason) if probe else "not asked",
    }


def _identity(probe: Probe | None) -> Mapping[str, Any] | None:
    if probe is None or probe.identity is None:
        return None
    identity = probe.identity
    return {
        "serial_number": clean(identity.serial_number),
        "model": clean(identity.model),
        "firmware": clean(identity.firmware),
        "plate_radius_m": identity.plate_radius,
        "plate_mass_kg": identity.plate_mass,
        "sampling_rate_hz": identity.sampling_rate,
        "channels": [
            {"name": clean(channel.name), "role": str(channel.role), "offset_m": channel.offset}
            for channel in identity.channels
        ],
    }


def row(port: Port, probe: Probe | None) -> tuple[str, str, str]:
    """A port as a row of the table for people."""
    adapter = port.adapter
    kind = port.description
    if adapter:
        kind += f" [{adapter.vid:04x}:{adapter.pid:04x} {adapter.serial_number or ''}".rstrip()
        kind += "]"
    if probe is None:
        found = ""
    elif probe.identity:
        identity = probe.identity
        found = f"PFWD {identity.model} {identity.serial_number}, firmware {identity.firmware}"
        radius = identity.plate_radius
        found += f", {len(identity.channels)} channels"
        found += f", plate radius {1000 * radius:g} mm" if radius else ", plate radius not said"
    else:
        # The port is named in the first column already.
        found = probe.reason.removeprefix(f"{port.url}: ")
    return clean(port.url), clean(kind), clean(found)


def print_table(rows: Sequence[tuple[str, str, str]]) -> None:
    """Columns of equal width, the last one as it is."""
    widths = [max(len(line[column]) for line in rows) for column in range(2)]
    for url, kind, found in rows:
        print(f"{url:<{widths[0]}}  {kind:<{widths[1]}}  {found}".rstrip(), flush=True)
