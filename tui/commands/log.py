"""``pfwd log``: measure with an instrument into a survey, without a screen."""

import argparse
import contextlib
import sys
from typing import TYPE_CHECKING

from tui.arguments import (
    add_analysis,
    add_changed_calibration,
    add_expert_group,
    add_instrument,
    add_json,
    count,
    not_negative,
)
from tui.output import say

if TYPE_CHECKING:
    from pfwd.procedures import Procedure
    from pfwd.session.events import SessionEvent
    from pfwd.session.position import PositionReceiver
    from pfwd.session.session import Listener


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd log`` and its description to the parser."""
    parser.description = (
        "Records the drops of an instrument into a survey. A drop is printed only when it is "
        "safe on the disk. Ends after --drops, when the instrument has no more, or on SIGINT, "
        "SIGTERM or SIGHUP. After a lost connection it waits until the instrument is back."
    )
    add_instrument(parser)
    parser.add_argument("--drops", type=count, metavar="N", help="end after N drops")
    expert = add_expert_group(parser)
    add_analysis(parser, expert, diagnose=False)
    add_json(parser, "drop")
    add_changed_calibration(expert)
    expert.add_argument(
        "--give-up",
        type=not_negative,
        metavar="S",
        help="end with status 3 when the instrument is lost for S seconds (default: wait for ever)",
    )
    expert.add_argument(
        "--capture", action="store_true", help="also store every byte that the instrument sends"
    )
    expert.add_argument("--no-bell", action="store_true", help="do not ring for a safe drop")


def _with_position_warnings(
    listener: "Listener", receiver: "PositionReceiver | None"
) -> "Listener":
    """Return a listener that also warns of drops without a valid position."""
    from pfwd.session.events import DropSaved

    if receiver is None:
        return listener

    def listen(event: "SessionEvent") -> None:
        listener(event)
        if isinstance(event, DropSaved) and (warning := receiver.warning()) is not None:
            say(f"drop {event.saved.point}/{event.saved.number}: {warning}")

    return listen


def run(args: argparse.Namespace, default_procedure: "Procedure | None" = None) -> int:
    """Measure until enough drops are recorded, a signal arrives, or the instrument has no more
    data.

    Parameters
    ----------
    args : argparse.Namespace
    default_procedure : Procedure, optional
        Procedure of a new survey if none is chosen.

    Returns
    -------
    int
        1 if a drop could not be saved, 3 if the instrument was lost for longer than ``--give-up``.
    """
    from pfwd.session.measure import measure, stopped_by_signals
    from pfwd.session.session import Ending
    from tui.log_file import survey_log
    from tui.measuring_options import job_request, measuring_setup, session_plan, try_output
    from tui.session_lines import STATUS_OF_ENDING, SessionLines

    try_output(args.output)
    setup = measuring_setup(args)
    job = job_request(args, args.output, setup.procedure, default_procedure)
    plan, receiver = session_plan(args, setup, job, default_procedure, calibration="refuse")
    bell = not args.no_bell and sys.stderr.isatty()
    lines = SessionLines(as_json=args.json, analysed=plan.options is not None, bell=bell)
    with survey_log(args.output), receiver or contextlib.nullcontext():
        ending = measure(
            args.url,
            args.output,
            _with_position_warnings(lines.print_event, receiver),
            plan,
            capture=args.capture,
            control=stopped_by_signals,
            spare=args.spare,
        )
        lines.finish()
    if ending is Ending.LOST:
        say(
            f"log: {args.url}: no instrument for {args.give_up:g} s (--give-up). End other "
            "programs that use the port, and check that the instrument is connected and on"
        )
    return STATUS_OF_ENDING[ending]
