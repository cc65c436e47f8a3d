"""``pfwd import``: trace files and other programs' files into a survey."""

import argparse
import os

from pfwd_survey.errors import OptionError, refusal
from pfwd_survey.exporting.json_text import json_text
from pfwd_survey.files.importing import import_files
from tui.output import clean, say


def run(args: argparse.Namespace) -> int:
    """Import what can be imported; 1 when a file was refused."""
    refused = False
    for option, path in (("--header", args.header), ("--map", args.map)):
        if path is not None and not os.path.isfile(path):
            raise OptionError(refusal(f"{option} {path}", "a TOML file", "no such file"))
    imported = import_files(
        args.files, args.output, args.header, column_map=args.map, channels=args.channels
    )
    for drop in imported:
        if drop.error is not None:
            refused = True
            say(f"import: {drop.error}")
        elif drop.remark is not None:
            say(f"import: {drop.remark}")
        elif args.json:
            line = {
                "file": drop.file,
                "point": drop.point,
                "drop": drop.number,
                "record": drop.record,
                "saved": True,
                "before": drop.before,
            }
            print(json_text(line), flush=True)
        else:
            how = "was there before" if drop.before else "saved"
            print(clean(f"{drop.file}: {drop.point}/{drop.number} {how}"), flush=True)
    return 1 if refused else 0
