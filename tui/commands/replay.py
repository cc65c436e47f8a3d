"""``pfwd replay``: recorded drops, or the recorded bytes of a link, through the same pipeline."""

import argparse
from pathlib import Path

from pfwd.session.measure import replay, stopped_by_signals
from pfwd.session.setup_file import read_setup_file
from tui.commands.log import STATUS_OF_ENDING
from tui.measuring_options import measuring_options
from tui.session_lines import SessionLines


def run(args: argparse.Namespace) -> int:
    """Detect, judge and invert what was recorded, again."""
    if args.live and not args.json:
        return _on_screen(args)
    options = measuring_options(args)
    lines = SessionLines(as_json=args.json, analysed=options is not None)
    ending = replay(
        args.survey,
        lines.tell,
        speed=args.speed or 0.0,
        options=options,
        setup=read_setup_file(args.setup) if args.setup else None,
        output=args.output,
        drops=args.drops,
        control=stopped_by_signals,
        spare=args.spare,
    )
    lines.rest()
    return STATUS_OF_ENDING[ending]


def _on_screen(args: argparse.Namespace) -> int:
    from tui.screen.session.sources import ReplaySource
    from tui.screen.show import show

    source = ReplaySource(
        Path(args.survey),
        1.0 if args.speed is None else args.speed,
        measuring_options(args),
        setup=read_setup_file(args.setup) if args.setup else None,
        output=Path(args.output) if args.output else None,
        drops=args.drops,
        spare=args.spare,
    )
    return show(source, "replay")
