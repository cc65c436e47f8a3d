"""``pfwd map``: a column map for a delimited text, inferred from the text and from the user's
answers.
"""

import argparse
import os
import sys
from dataclasses import replace
from typing import TYPE_CHECKING

from pfwd.errors import OptionError, refusal
from tui.output import clean, quoted, say
from tui.questions import ask_choice, ask_optional_number

if TYPE_CHECKING:
    from pfwd.files.foreign.map_draft import DraftColumn, MapDraft

ROLES = ("time", "load", "sensor", "drop", "none")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd map`` and its description to the parser."""
    parser.description = (
        "Reads a text (CSV, tabs, blanks), proposes what its columns hold, asks about them on a "
        "terminal, and writes a column map for pfwd import --map. Exit status 1 when something "
        "still has to be filled in."
    )
    parser.add_argument("file", metavar="FILE", help="delimited text of any program")
    parser.add_argument(
        "-o",
        "--output",
        metavar="MAP.toml",
        help="default: name of FILE with .map.toml, in the current folder",
    )
    parser.add_argument("--force", action="store_true", help="overwrite an existing file")
    parser.add_argument(
        "--no-questions", action="store_true", help="write the proposal without asking"
    )


def run(args: argparse.Namespace) -> int:
    """Write the map; return 1 if entries of it are missing."""
    from pfwd.files.foreign.map_draft import draft_map, map_text
    from pfwd.files.output_path import require_writable

    target = args.output or os.path.splitext(os.path.basename(args.file))[0] + ".map.toml"
    require_writable(target, "--output", streams=True)
    if os.path.exists(target) and not args.force:
        hint = "--force overwrites it, -o names another file"
        raise OptionError(refusal(target, "a new file", "an existing one", hint))
    draft = draft_map(args.file)
    for line in _description(draft):
        print(clean(line))
    if not args.no_questions and sys.stdin.isatty() and sys.stderr.isatty():
        draft = _ask(draft)
    with open(target, "w", encoding="utf-8", newline="\n") as stream:
        stream.write(map_text(draft))
    print(clean(f"{target} written"))
    missing = draft.missing
    if draft.plate_radius is None:
        missing = ["the plate radius (plate_radius_m, or --header)", *missing]
    if missing:
        say(f"map: add to {target}: {'; '.join(missing)}")
    say(f"map: next: pfwd import {quoted(args.file)} --map {quoted(target)} -o SURVEY")
    return 1 if draft.missing else 0


def _description(draft: "MapDraft") -> list[str]:
    delimiter = {None: "blanks", "\t": "tab"}.get(draft.delimiter, repr(draft.delimiter))
    lines = [
        f"{draft.file}: columns by {delimiter}, decimal {draft.decimal!r}, {draft.encoding}, "
        f"{draft.skip_lines} lines before the {'names' if draft.names else 'numbers'}"
        + (", a line with units" if draft.units_line else "")
        if not draft.form
        else f"{draft.file}: a {draft.form} file, {len(draft.columns)} columns with the time"
    ]
    for column in draft.columns:
        meaning = str(column.role) if column.role != "none" else "not used"
        if column.role == "sensor":
            where = "?" if column.offset is None else f"{column.offset:g} m"
            meaning += f", {column.quantity} at {where}"
        if column.role in ("time", "load", "sensor"):
            meaning += f", in {column.unit or '?'}"
        lines.append(f"  {column.position}  {column.name or '(no name)'}: {meaning}")
    return lines


def _ask(draft: "MapDraft") -> "MapDraft":
    """Return the draft with the user's answers; an empty answer keeps the value."""
    say("map: Enter accepts the value in brackets")
    radius = ask_optional_number("plate radius in m", draft.plate_radius)
    draft = replace(draft, plate_radius=radius)
    for column in draft.columns:
        draft = draft.with_column(_ask_about(column))
    return draft


def _ask_about(column: "DraftColumn") -> "DraftColumn":
    from pfwd.files.foreign.column_map import COLUMN_UNITS
    from pfwd_plugins.quantities import MOTIONS, motion

    name = clean(column.name or f"column {column.position}")
    role = ask_choice(f"{name}: {', '.join(ROLES)}", ROLES, column.role)
    answer = replace(column, role=role)  # type: ignore[arg-type]
    if role == "sensor":
        quantity = motion(ask_choice(f"{name}: {' or '.join(MOTIONS)}", MOTIONS, column.quantity))
        offset = ask_optional_number(
            f"{name}: distance from the centre of the plate in m", column.offset
        )
        answer = replace(answer, quantity=quantity, offset=offset)
    if role in ("time", "load", "sensor"):
        units = tuple(COLUMN_UNITS[answer.quantity if role == "sensor" else role])
        default = answer.unit if answer.unit in units else None
        unit = ask_choice(f"{name}: unit, {', '.join(units)}", units, default)
        answer = replace(answer, unit=unit)
    return answer
