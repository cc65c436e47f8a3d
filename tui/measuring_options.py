"""What a command that measures or replays asks of the analysis of its drops."""

import argparse

from pfwd_survey.errors import OptionError, refusal
from pfwd_survey.inverting.options import AnalysisOptions


def measuring_options(args: argparse.Namespace) -> AnalysisOptions | None:
    """The options of the command line, checked; None: nothing is inverted.

    Raises
    ------
    OptionError
    """
    asked = [name for name in ("layers", "thickness") if getattr(args, name) is not None]
    if args.no_invert and asked:
        raise OptionError(refusal(f"--no-invert and --{asked[0]}", "one of the two", "both"))
    if args.no_invert:
        return None
    return AnalysisOptions(seed=args.seed, layers=args.layers, thickness=args.thickness)
