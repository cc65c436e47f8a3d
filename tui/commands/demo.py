"""``pfwd demo``: the main job with nothing attached."""

import argparse
import tempfile
from pathlib import Path

from pfwd_survey.options import AnalysisOptions
from tui.commands.invert import show
from tui.output import say


def run(args: argparse.Namespace) -> int:
    """Simulate drops by finite elements, invert their trace file, show lines and write a plot.

    The simulation hands over nothing but the trace file, as an instrument would.
    """
    folder = Path(args.output) if args.output else Path(tempfile.mkdtemp(prefix="pfwd-demo-"))
    say(f"simulating {args.drops} drops by finite elements, seed {args.seed}")
    from simulators.demo import demo_drops

    traces = demo_drops(args.drops, args.seed, folder)
    say(f"trace file {traces}")
    from pfwd_survey.analysis import analyse_files
    from pfwd_survey.plots import plot_outcomes
    from tui.progress import building

    with building() as progress:
        outcomes = list(analyse_files([str(traces)], AnalysisOptions(), progress=progress))
    for outcome in outcomes:
        show(outcome, as_json=args.json)
    plot = plot_outcomes(outcomes, args.plot or folder / "demo.png")
    say(f"plot {plot}")
    return 1 if any(outcome.error for outcome in outcomes) else 0
