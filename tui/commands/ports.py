"""``pfwd ports``: list the serial ports and the instruments on them."""

import argparse
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pfwd.export.json_text import json_text
from tui.arguments import add_json
from tui.output import clean, counted, say

if TYPE_CHECKING:
    from pfwd.ports import Port, Probe


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd ports`` and its description to the parser."""
    parser.description = (
        "Lists the serial ports of this computer and tests each for an instrument. A port without "
        "an answer is listed with the reason and what to try."
    )
    parser.add_argument(
        "urls",
        nargs="*",
        metavar="URL",
        help="test only these, for example /dev/ttyUSB0, COM3, socket://HOST:PORT, dataq://HOST or "
        "labjack://HOST",
    )
    parser.add_argument("--no-probe", action="store_true", help="do not open the ports")
    add_json(parser, "port")


def run(args: argparse.Namespace) -> int:
    """List and test the ports; return 0, also if a port is in use or no instrument answers."""
    from pfwd.ports import Port, is_same_port, list_ports, port_advice, probe_ports

    listed = list_ports()
    ports = listed
    if args.urls:
        ports = [
            next(
                (port for port in listed if url == port.by_id or is_same_port(port.url, url)),
                Port(url, url),
            )
            for url in args.urls
        ]
    if ports and not args.no_probe:
        say(f"testing {counted(len(ports), 'port')} for an instrument")
    urls = [port.url for port in ports]
    probes = probe_ports(urls, None) if args.no_probe else probe_ports(urls)
    if args.json:
        for port, probe in zip(ports, probes, strict=True):
            print(json_text(record(port, probe)), flush=True)
    elif ports:
        print_table([row(port, probe) for port, probe in zip(ports, probes, strict=True)])
    if not ports:
        say("no serial ports found. Connect the adapter, and check that its driver is installed")
    for text in port_advice(urls):
        say(text)
    return 0


def record(port: "Port", probe: "Probe") -> dict[str, Any]:
    """Return a port and the result of its test as a JSON object."""
    adapter = port.adapter
    return {
        "url": clean(port.url),
        "description": clean(port.description),
        "vid": adapter and adapter.vid,
        "pid": adapter and adapter.pid,
        "port_serial_number": adapter and adapter.serial_number,
        "by_id": port.by_id,
        "answers": probe.answers,
        "identity": _identity(probe),
        "reason": clean(probe.reason),
    }


def _identity(probe: "Probe") -> Mapping[str, Any] | None:
    if probe.identity is None:
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
            {"name": clean(channel.name), "role": channel.quantity.role, "offset_m": channel.offset}
            for channel in identity.channels
        ],
    }


def row(port: "Port", probe: "Probe") -> tuple[str, str, str]:
    """Return a port as a row of the table: address, description, result of the test."""
    adapter = port.adapter
    kind = port.description
    if adapter:
        kind += f" [{adapter.vid:04x}:{adapter.pid:04x} {adapter.serial_number or ''}".rstrip()
        kind += "]"
    if probe.identity:
        identity = probe.identity
        answer = f"PFWD {identity.title}"
        radius = identity.plate_radius
        answer += f", {len(identity.channels)} channels"
        answer += f", plate radius {1000 * radius:g} mm" if radius else ", no plate radius"
    else:
        # Without the port, which is in the first column.
        answer = probe.reason.removeprefix(f"{port.url}: ")
    return clean(port.url), clean(kind), clean(answer)


def print_table(rows: Sequence[tuple[str, str, str]]) -> None:
    """Print rows as a table with aligned columns."""
    widths = [max(len(line[column]) for line in rows) for column in range(2)]
    for url, kind, answer in rows:
        print(f"{url:<{widths[0]}}  {kind:<{widths[1]}}  {answer}".rstrip(), flush=True)
