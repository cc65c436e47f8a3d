"""``pfwd live``: an instrument on the screen."""

import argparse
import contextlib
from pathlib import Path

from pfwd.judging import JobRequest
from pfwd.procedures import plain_procedure
from pfwd.session.plan import SessionPlan
from pfwd.session.position import PositionReceiver
from tui.commands import log
from tui.measuring_options import (
    agreed_on_terminal,
    job_request,
    measuring_options,
    measuring_setup,
    try_output,
)
from tui.output import say
from tui.screen.session.sources import LiveSource
from tui.screen.settings import load_settings
from tui.screen.show import show


def run(args: argparse.Namespace) -> int:
    """Measure on the screen until the operator leaves."""
    try_output(args.output)
    setup = measuring_setup(args)
    options = measuring_options(args)
    said = setup.declared.get("seating_drops")
    usual = plain_procedure() if said is None else plain_procedure(int(said))
    if args.json:  # for machines, in place of the screen
        return log.run(args, usual)
    remarks: list[str] = []

    def remark(text: str) -> None:
        say(text)
        remarks.append(text)  # what stands on the terminal now is soon behind the screen

    request = job_request(args, args.output, setup.procedure, usual, remark)
    request = JobRequest(units=load_settings().units).over(request)
    if not agreed_on_terminal(args.output, setup.procedure, request):
        return 0
    receiver = PositionReceiver(args.gps) if args.gps is not None else None
    plan = SessionPlan(
        point=args.point,
        setup=setup,
        options=options,
        changed_calibration="accept" if args.accept_calibration else "ask",
        position=receiver,
        job=request,
        usual_procedure=usual,
    )
    source = LiveSource(args.url, Path(args.output), plan, args.spare)
    with receiver or contextlib.nullcontext():
        return show(source, "live", remarks=remarks)
