"""``pfwd live``: measure with an instrument, on a screen."""

import argparse
import contextlib
from pathlib import Path

from tui.arguments import (
    add_analysis,
    add_changed_calibration,
    add_expert_group,
    add_instrument,
    add_json,
)
from tui.commands import log
from tui.output import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd live`` and its description to the parser."""
    parser.description = (
        "Measures with an instrument, on a screen that fills the terminal; ? shows its keys. After "
        "a lost connection it waits until the instrument is back."
    )
    add_instrument(parser)
    expert = add_expert_group(parser)
    add_analysis(parser, expert, diagnose=True)
    add_json(parser, "drop")
    add_changed_calibration(expert)
    parser.set_defaults(drops=None, capture=False, give_up=None, no_bell=True)


def run(args: argparse.Namespace) -> int:
    """Measure with the instrument on a screen until the operator closes it."""
    from pfwd.judging import JobRequest
    from pfwd.procedures import plain_procedure
    from tui.measuring_options import (
        agreed_on_terminal,
        job_request,
        measuring_setup,
        session_plan,
        try_output,
    )
    from tui.screen.session.sources import LiveSource
    from tui.screen.settings import load_settings
    from tui.screen.show import show

    try_output(args.output)
    setup = measuring_setup(args)
    seating = setup.declared.get("seating_drops")
    default = plain_procedure() if seating is None else plain_procedure(int(seating))
    if args.json:  # for programs, without a screen
        return log.run(args, default)
    remarks: list[str] = []

    def remark(text: str) -> None:
        say(text)
        remarks.append(text)  # shown again on the screen, which covers the terminal

    request = job_request(args, args.output, setup.procedure, default, remark)
    request = JobRequest(units=load_settings().units).over(request)
    if not agreed_on_terminal(args.output, setup.procedure, request):
        return 0
    plan, receiver = session_plan(args, setup, request, default, calibration="ask")
    source = LiveSource(args.url, Path(args.output), plan, args.spare)
    with receiver or contextlib.nullcontext():
        return show(source, "live", remarks=remarks)
