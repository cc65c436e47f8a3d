"""``pfwd live``: an instrument on the screen."""

import argparse
import contextlib
from pathlib import Path

from pfwd_survey.files.editing import target_pa
from pfwd_survey.measuring.plan import SessionPlan
from pfwd_survey.measuring.position import PositionReceiver
from pfwd_survey.measuring.setup_file import MeasuringSetup, read_setup_file, with_procedure
from pfwd_survey.procedures import find_procedure
from tui.measuring_options import measuring_options
from tui.screen.session.procedure import SEATING
from tui.screen.session.sources import LiveSource, with_seating
from tui.screen.show import show


def run(args: argparse.Namespace) -> int:
    """Measure on the screen until the operator leaves."""
    setup = read_setup_file(args.setup) if args.setup else MeasuringSetup()
    options = measuring_options(args)
    if args.procedure is not None:
        setup = with_procedure(setup, find_procedure(args.procedure))
    receiver = PositionReceiver(args.gps) if args.gps is not None else None
    plan = SessionPlan(point=args.point, setup=setup, options=options, position=receiver)
    target = None if args.target is None else target_pa(args.target)
    source = LiveSource(args.url, Path(args.output), with_seating(plan, SEATING), args.spare)
    with receiver or contextlib.nullcontext():
        return show(source, "live", target)
