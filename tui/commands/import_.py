"""``pfwd import``: trace files and other programs' files into a survey."""

import argparse
import os

from pfwd.errors import OptionError, refusal
from pfwd.export.json_text import json_text
from pfwd.files.importing import import_files
from tui.output import clean, say

_KINDS = {"peaks": "peaks only", "stiffness": "stiffness test"}


def run(args: argparse.Namespace) -> int:
    """Import what can be imported; 1 when a file was refused."""
    refused = False
    told: set[tuple[str, str]] = set()
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
                "kind": drop.kind,
                "remarks": list(drop.remarks),
            }
            print(json_text(line), flush=True)
        else:
            for text in drop.remarks:
                if (drop.file, text) not in told:
                    told.add((drop.file, text))
                    say(f"import: {drop.point}: {text}")
            how = "was there before" if drop.before else "saved"
            kind = "" if drop.kind == "traces" else f" ({_KINDS[drop.kind]})"
            print(clean(f"{drop.file}: {drop.point}/{drop.number} {how}{kind}"), flush=True)
    return 1 if refused else 0
