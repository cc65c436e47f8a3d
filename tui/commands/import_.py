"""``pfwd import``: trace files and other programs' files into a survey."""

import argparse

from pfwd_survey.files.importing import import_files
from tui.output import clean, json_line, say


def run(args: argparse.Namespace) -> int:
    """Import what can be imported; 1 when a file was refused."""
    refused = False
    for one in import_files(args.files, args.output, args.header):
        if one.error is not None:
            refused = True
            say(f"import: {one.error}")
        elif args.json:
            line = {
                "file": one.file,
                "point": one.point,
                "drop": one.number,
                "record": one.record,
                "saved": True,
                "before": one.before,
            }
            print(json_line(line), flush=True)
        else:
            how = "was there before" if one.before else "saved"
            print(clean(f"{one.file}: {one.point}/{one.number} {how}"), flush=True)
    return 1 if refused else 0
