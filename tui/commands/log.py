"""``pfwd log``: headless logging into a survey, with a modulus per drop."""

import argparse
import contextlib
import sys

from pfwd.procedures import Procedure
from pfwd.session.events import DropSaved, SessionEvent
from pfwd.session.measure import measure, stopped_by_signals
from pfwd.session.position import PositionReceiver
from pfwd.session.session import Ending, Listener, SessionPlan
from tui.log_file import close_log, open_log
from tui.measuring_options import job_request, measuring_options, measuring_setup, try_output
from tui.output import say
from tui.session_lines import SessionLines

STATUS_OF_ENDING = {Ending.DONE: 0, Ending.UNSAVED: 1, Ending.LOST: 3}


def _with_position(tell: Listener, receiver: PositionReceiver | None) -> Listener:
    """Says of every drop what is wrong with its position."""
    if receiver is None:
        return tell

    def told(event: SessionEvent) -> None:
        tell(event)
        if isinstance(event, DropSaved) and (warning := receiver.warning()) is not None:
            say(f"drop {event.saved.point}/{event.saved.number}: {warning}")

    return told


def run(args: argparse.Namespace, usual: Procedure | None = None) -> int:
    """Measure until enough drops are in, or a signal comes, or the instrument has no more.

    Parameters
    ----------
    args : argparse.Namespace
    usual : Procedure, optional
        Of a survey that begins now, where nobody chose one.
    """
    try_output(args.output)
    setup = measuring_setup(args)
    options = measuring_options(args)
    receiver = PositionReceiver(args.gps) if args.gps is not None else None
    plan = SessionPlan(
        point=args.point,
        setup=setup,
        job=job_request(args, args.output, setup.procedure, usual),
        usual_procedure=usual,
        drops=args.drops,
        options=options,
        give_up=args.give_up,
        changed_calibration="accept" if args.accept_calibration else "refuse",
        position=receiver,
    )
    bell = not args.no_bell and sys.stderr.isatty()
    lines = SessionLines(as_json=args.json, analysed=options is not None, bell=bell)
    handler = open_log(args.output)
    try:
        with receiver or contextlib.nullcontext():
            ending = measure(
                args.url,
                args.output,
                _with_position(lines.tell, receiver),
                plan,
                capture=args.capture,
                control=stopped_by_signals,
                spare=args.spare,
            )
        lines.rest()
    finally:
        close_log(handler)
    return STATUS_OF_ENDING[ending]
