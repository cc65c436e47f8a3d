"""``pfwd simulate``: run a simulated instrument to which other programs connect."""

import argparse

from pfwd.export.json_text import json_text
from tui.arguments import add_seed, count, not_negative
from tui.output import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd simulate`` and its description to the parser."""
    parser.description = (
        "Runs a simulated instrument on a virtual serial port or on TCP until ctrl+c. Its drops "
        "are computed by finite elements; scenarios add faults. Connect pfwd live or pfwd log to "
        "the printed address."
    )
    parser.add_argument(
        "--listen",
        metavar="WHERE",
        help="pty (a virtual serial port) or tcp://HOST:PORT, port 0 for a free one (default: pty "
        "where the system has it)",
    )
    parser.add_argument(
        "--scenario",
        metavar="NAME",
        default="default",
        help="built-in name, or a TOML file (default: default)",
    )
    parser.add_argument(
        "--drops", type=count, metavar="N", help="end after N drops (default: no limit)"
    )
    parser.add_argument(
        "--rate",
        type=not_negative,
        metavar="X",
        default=1.0,
        help="speed as a multiple of real time, 0: as fast as possible (default: 1)",
    )
    parser.add_argument(
        "--truth", metavar="FILE", help="at the end write what was simulated, as JSON"
    )
    add_seed(parser)
    parser.add_argument("--json", action="store_true", help='print the address as {"url": ...}')


def run(args: argparse.Namespace) -> int:
    """Run a simulated instrument until it is stopped, after printing its URL on standard output."""
    from pfwd.files.output_path import require_writable
    from simulators.instrument import SimulateOptions, simulate
    from simulators.mesh import SimulationError

    if args.truth is not None:
        require_writable(args.truth, "--truth", streams=True)
    options = SimulateOptions(
        listen=args.listen,
        scenario=args.scenario,
        drops=args.drops,
        seed=args.seed,
        rate=args.rate,
        truth=args.truth,
    )

    def announce(url: str) -> None:
        print(json_text({"url": url}) if args.json else url, flush=True)
        say(f"simulating {args.scenario}, seed {args.seed}; connect to {url}")

    try:
        simulate(options, announce)
    except SimulationError as err:
        say(f"simulate: {err}")
        return 2
    return 0
