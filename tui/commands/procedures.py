"""``pfwd procedures``: list the measuring procedures, or show one with all its numbers."""

import argparse
import textwrap
from dataclasses import asdict

from pfwd.export.json_text import json_text
from pfwd.procedures import Procedure, find_procedure, shipped_procedures
from pfwd.procedures.profile import SourcedNumber, number_words
from tui.arguments import add_json
from tui.output import clean


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd procedures`` and its description to the parser."""
    parser.description = (
        "Lists the procedures that come with the program: seating + measured drops (in brackets: "
        "not verified, not enforced) and the judged quantity. With a name or a TOML file it shows "
        "every number with its source."
    )
    parser.add_argument("name", nargs="?", metavar="NAME", help="show this procedure")
    add_json(parser, "procedure")


def run(args: argparse.Namespace) -> int:
    """Print the list of procedures, or one procedure with all its numbers."""
    chosen = find_procedure(args.name) if args.name is not None else None
    for procedure in (chosen,) if chosen is not None else shipped_procedures():
        if args.json:
            print(json_text(_record(procedure)), flush=True)
            continue
        for line in _lines(procedure) if chosen is not None else [_summary(procedure)]:
            print(clean(line), flush=True)
    return 0


def _summary(procedure: Procedure) -> str:
    counts = [_count(number) for number in (procedure.seating, procedure.measured)]
    drops = f"{counts[0]:>3} + {counts[1]:3}"
    return f"{procedure.name:16} {drops} {procedure.quantity:11} {procedure.title}"


def _count(number: SourcedNumber | None) -> str:
    if number is None:
        return "-"
    return f"{number.value:g}" if number.verified else f"({number.value:g})"


def _lines(procedure: Procedure) -> list[str]:
    lines = [procedure.name, f"  {procedure.title}", f"  source: {procedure.source}"]
    lines += textwrap.wrap(
        procedure.about, 96, initial_indent="  ", subsequent_indent="  ", break_long_words=False
    )
    lines.append(f"  judged: {procedure.quantity}, of the mean {procedure.average}")
    for key, number in procedure.numbers().items():
        state = "" if number.verified else "  NOT VERIFIED, not enforced"
        lines.append(f"  {number_words(key)}: {procedure.shown_number(key)}{state}")
        lines.append(f"      {number.source}")
    return lines


def _record(procedure: Procedure) -> dict[str, object]:
    return {
        "name": procedure.name,
        "title": procedure.title,
        "source": procedure.source,
        "about": procedure.about,
        "quantity": procedure.quantity.value,
        "average": procedure.average,
        "file": procedure.file,
        "numbers": {
            key: {**asdict(number), "enforced": procedure.enforced(number) is not None}
            for key, number in procedure.numbers().items()
        },
        "targets": [
            {
                "value": target.value.value,
                "material": target.material,
                "moisture_from_percent": target.moisture_from,
                "moisture_to_percent": target.moisture_to,
            }
            for target in procedure.targets
        ],
    }
