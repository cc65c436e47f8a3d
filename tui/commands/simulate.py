"""``pfwd simulate``: a mock instrument to connect to."""

import argparse

from pfwd.export.json_text import json_text
from pfwd.files.output_path import require_writable
from simulators.instrument import SimulateOptions, simulate
from simulators.mesh import SimulationError
from tui.output import say


def run(args: argparse.Namespace) -> int:
    """Serve a simulated instrument; the first line on standard output is its URL."""
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
