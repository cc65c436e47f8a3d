"""``pfwd log``: headless logging into a survey, with a modulus per drop."""

import argparse
import sys

from pfwd_survey.inverting.options import AnalysisOptions
from pfwd_survey.measuring.measure import measure, stopped_by_signals
from pfwd_survey.measuring.session import Ending, SessionPlan
from pfwd_survey.measuring.setup_file import MeasuringSetup, read_setup_file
from tui.log_file import close_log, open_log
from tui.session_lines import SessionLines

STATUS_OF_ENDING = {Ending.DONE: 0, Ending.UNSAVED: 1, Ending.LOST: 3}


def run(args: argparse.Namespace) -> int:
    """Measure until enough drops are in, or a signal comes, or the instrument has no more."""
    setup = read_setup_file(args.setup) if args.setup else MeasuringSetup()
    options = None if args.no_invert else AnalysisOptions(seed=args.seed)
    plan = SessionPlan(
        point=args.point, setup=setup, drops=args.drops, options=options, give_up=args.give_up
    )
    bell = not args.no_bell and sys.stderr.isatty()
    lines = SessionLines(as_json=args.json, analysed=options is not None, bell=bell)
    handler = open_log(args.output)
    try:
        ending = measure(
            args.url,
            args.output,
            lines.tell,
            plan,
            capture=args.capture,
            control=stopped_by_signals,
        )
    finally:
        close_log(handler)
    return STATUS_OF_ENDING[ending]
