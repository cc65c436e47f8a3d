"""``pfwd replay``: detect and invert again the drops of a survey or the bytes of a capture."""

import argparse
from pathlib import Path

from tui.arguments import add_analysis, add_expert_group, add_json, count, not_negative


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd replay`` and its description to the parser."""
    parser.description = (
        "Detects, judges and inverts again what was recorded: the drops of a survey, or the bytes "
        "of an instrument stored by pfwd log --capture."
    )
    parser.add_argument("survey", metavar="SURVEY", help="survey, or a capture (.pfwdc)")
    parser.add_argument("--live", action="store_true", help="show it on the screen; space pauses")
    parser.add_argument(
        "--speed",
        type=not_negative,
        metavar="X",
        help="multiple of real time, 0: as fast as possible (default: 0; with --live: 1)",
    )
    parser.add_argument("-o", "--output", metavar="SURVEY", help="record into this survey")
    parser.add_argument("--drops", type=count, metavar="N", help="end after N drops")
    expert = add_expert_group(parser)
    expert.add_argument("--setup", metavar="FILE.toml", help="replaces the setup of a capture")
    add_analysis(parser, expert, diagnose=False)
    add_json(parser, "drop")


def run(args: argparse.Namespace) -> int:
    """Run the recording through a session again, on the screen or as lines."""
    from pfwd.session.measure import replay, stopped_by_signals
    from pfwd.session.setup_file import read_setup_file
    from tui.measuring_options import measuring_options
    from tui.session_lines import STATUS_OF_ENDING, SessionLines

    options = measuring_options(args)
    setup = read_setup_file(args.setup) if args.setup else None
    if args.live and not args.json:
        from tui.screen.session.sources import ReplaySource
        from tui.screen.show import show

        source = ReplaySource(
            Path(args.survey),
            1.0 if args.speed is None else args.speed,
            options,
            setup=setup,
            output=Path(args.output) if args.output else None,
            drops=args.drops,
            spare=args.spare,
        )
        return show(source, "replay")
    lines = SessionLines(as_json=args.json, analysed=options is not None)
    ending = replay(
        args.survey,
        lines.print_event,
        speed=args.speed or 0.0,
        options=options,
        setup=setup,
        output=args.output,
        drops=args.drops,
        control=stopped_by_signals,
        spare=args.spare,
    )
    lines.finish()
    return STATUS_OF_ENDING[ending]
