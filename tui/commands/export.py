"""``pfwd export``: a survey as a file for other programs."""

import argparse

from pfwd.export.export import export_survey
from pfwd.export.json_text import json_text
from tui.output import clean, counted, say

MOST_PROCESSES = 2
"""Make rows, or read an exported file back; the disk and one that waits keep more from gaining
anything."""


def run(args: argparse.Namespace) -> int:
    """Export and say what was written and what was left out."""
    done = export_survey(
        args.survey,
        args.format,
        args.output,
        force=args.force,
        invert=args.invert,
        seed=args.seed,
        jobs=MOST_PROCESSES,
        delimiter=args.delimiter,
        decimal=args.decimal,
    )
    for note in done.notes:
        say(f"export: {note}")
    if args.json:
        print(json_text(done.as_dict()), flush=True)
    else:
        print(
            clean(
                f"{done.path}: format {done.format}, {counted(done.points, 'point')}, "
                f"{counted(done.drops, 'drop')}"
            ),
            flush=True,
        )
    return 0
