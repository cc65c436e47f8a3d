"""``pfwd recover``: whatever a crash left."""

import argparse

from pfwd.files.upkeep import recover_survey
from tui.upkeep_lines import show


def run(args: argparse.Namespace) -> int:
    """Put right what can be put right; 1 when something acknowledged is missing."""
    record, actions = recover_survey(args.survey, args.spare)
    return show(record, actions, as_json=args.json)
