"""``pfwd import``: import trace files and other programs' files into a survey."""

import argparse
import os
from collections import Counter
from typing import TYPE_CHECKING

from pfwd.errors import OptionError, refusal
from pfwd.export.json_text import json_text
from tui.arguments import add_expert_group, add_files, add_json
from tui.output import clean, counted, next_commands, say

if TYPE_CHECKING:
    from pfwd.files.importing import Imported

_KINDS = {"peaks": "peaks only", "stiffness": "stiffness test"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd import`` and its description to the parser."""
    parser.description = (
        "Reads trace files (.csv) and surveys in one file (.pfwdz); time histories of Rincent "
        "Minidyn, Maxidyn and Heavydyn (.dynz, .prjz, .mpvz) and JILS (.thy); peaks of JILS "
        "(.dat), Dynatest (.f25, .fwd), Sweco (.fwd) and PDDX (.pdx, .pddx); and any delimited "
        "text whose columns a TOML file describes (--map; pfwd map writes a first one). Nothing "
        "is imported twice, and a file that is refused does not stop the others."
    )
    add_files(parser, "TRACES", "file of any of these kinds")
    parser.add_argument(
        "-o", "--output", metavar="SURVEY", required=True, help="folder, new or existing"
    )
    parser.add_argument("--header", metavar="FILE.toml", help="header keys, in place of the files'")
    parser.add_argument(
        "--map", metavar="FILE.toml", help="meaning of the columns of a text (docs/files.md)"
    )
    add_json(parser, "drop")
    add_expert_group(parser).add_argument(
        "--channels",
        choices=["raw", "stored"],
        help="raw channels, or those processed by the other program (default: raw if the file has "
        "them)",
    )


def run(args: argparse.Namespace) -> int:
    """Import the files and print a line for each point; return 1 if a file was refused."""
    from pfwd.files.importing import import_files

    refused = False
    reported: set[tuple[str, str]] = set()
    for option, path in (("--header", args.header), ("--map", args.map)):
        if path is not None and not os.path.isfile(path):
            raise OptionError(refusal(f"{option} {path}", "a TOML file", "no such file"))
    imported = import_files(
        args.files, args.output, args.header, column_map=args.map, channels=args.channels
    )
    points = _PointLines(show=not args.json)
    for drop in imported:
        if drop.error is not None:
            refused = True
            points.end()
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
                if (drop.file, text) not in reported:
                    reported.add((drop.file, text))
                    say(f"import: {drop.point}: {text}")
            points.add(drop)
    points.end()
    if points.n_points and not args.json:
        drops = counted(points.n_drops, "drop")
        before = f", {points.n_before} of them already in the survey" if points.n_before else ""
        print(clean(f"{args.output}: {drops} at {counted(points.n_points, 'point')}{before}"))
        print(clean(f"next: {', or '.join(next_commands(args.output))}"), flush=True)
    return 1 if refused else 0


class _PointLines:
    """Printer of one line for each point of a file, once all its drops are imported."""

    def __init__(self, *, show: bool) -> None:
        self.n_points = self.n_drops = self.n_before = 0
        self._show = show
        self._point: tuple[str, str, str] | None = None
        self._drops: Counter[bool] = Counter()

    def add(self, drop: "Imported") -> None:
        """Count a drop; print the line of the last point if this drop is of another one."""
        point = (drop.file, drop.point, drop.kind)
        if point != self._point:
            self.end()
            self._point = point
            self.n_points += 1
        self._drops[drop.before] += 1
        self.n_drops += 1
        self.n_before += drop.before

    def end(self) -> None:
        """Print the line of the last point."""
        if self._point is not None and self._show:
            file, point, kind = self._point
            counts = [(False, "saved"), (True, "already in the survey")]
            texts = [
                f"{counted(self._drops[before], 'drop')} {word}"
                for before, word in counts
                if self._drops[before]
            ]
            note = "" if kind == "traces" else f" ({_KINDS[kind]})"
            line = f"{os.path.basename(file)}, point {point}: {', '.join(texts)}{note}"
            print(clean(line), flush=True)
        self._point = None
        self._drops.clear()
