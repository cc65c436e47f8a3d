"""``pfwd check``: is this recording whole?"""

import argparse

from pfwd.files.upkeep import check_survey
from tui.upkeep_lines import show


def run(args: argparse.Namespace) -> int:
    """Look at every byte and change none; 1 when something is damaged or missing."""
    record, notes = check_survey(args.survey, args.spare)
    return show(record, notes, as_json=args.json)
