"""``pfwd edit``: notes, targets and other edits of points and drops."""

import argparse
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pfwd.errors import OptionError, quote, refusal
from pfwd.export.json_text import json_text
from pfwd.message_groups import Notice, text_of
from tui.arguments import add_json, count, number
from tui.output import clean, counted, on_terminal, say

if TYPE_CHECKING:
    from pfwd.files.editing import Edit

MAX_LISTED_POINTS = 8
"""Largest number of points that a message lists."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd edit`` and its description to the parser."""
    parser.description = (
        "Adds notes and other edits to a point or a drop, and shows the points. Recorded data are "
        "never changed or deleted; the last edit of a property counts."
    )
    parser.add_argument("survey", metavar="SURVEY", help="folder")
    parser.add_argument("--point", metavar="NAME", help="required if there are several points")
    parser.add_argument("--drop", type=count, metavar="N", help="edit this drop of the point")
    parser.add_argument("--note", action="append", metavar="TEXT", help="add a note")
    parser.add_argument(
        "--discard",
        nargs="?",
        const="",
        metavar="REASON",
        help="do not use the point or drop; --restore undoes it",
    )
    parser.add_argument("--restore", action="store_true", help="undo --discard or --move")
    parser.add_argument(
        "--move", metavar="POINT", help="with --drop: assign the drop to this point"
    )
    parser.add_argument(
        "--new-point", action="store_true", help="with --move: begin the point if it is new"
    )
    parser.add_argument("--position", metavar="LAT,LON", help="degrees")
    parser.add_argument(
        "--target",
        type=number,
        metavar="V",
        help="target of the point in the unit of the survey's procedure: MPa, or mm for a "
        "deflection",
    )
    parser.add_argument("--name", metavar="NAME", help="another name for the point")
    parser.add_argument("--operator", metavar="NAME", help="name of the person who measured")
    parser.add_argument(
        "--set",
        action="append",
        metavar="KEY=VALUE",
        help="declare a key of the header, for example plate_mass_kg=12.5",
    )
    add_json(parser, "point")


def run(args: argparse.Namespace) -> int:
    """Store the edits, then print the points of the survey."""
    from pfwd.files.editing import no_collections

    with no_collections():  # nothing that is read becomes garbage
        return _run(args)


def _run(args: argparse.Namespace) -> int:
    from pfwd.files.editing import edit_survey, move_drop, moved_drops, overview_of, survey_overview

    edits = _edits(args)
    if args.move is not None:
        if edits:
            hint = "make the other edits by another call"
            raise OptionError(refusal("--move", "no other edit", "other edits", hint))
        if not _is_agreed(args):
            return 0
        points = overview_of(move_drop(args.survey, args.point, args.drop, args.move))
    elif edits or args.point is not None or args.drop is not None:
        points = overview_of(edit_survey(args.survey, edits, args.point, args.drop))
    else:
        points = survey_overview(args.survey)
    moved = {} if args.json else moved_drops(args.survey)
    for point in points:
        if args.json:
            print(json_text(point), flush=True)
        else:
            for line in _lines(point, moved):
                print(clean(line), flush=True)
    return 0


def _is_agreed(args: argparse.Namespace) -> bool:
    """Return whether to move a drop to a point: it is known, or the user wants a new one.

    Raises
    ------
    OptionError
        If the point is new, and there is no terminal to ask on.
    """
    from pfwd.files.editing import survey_overview
    from tui.measuring_options import survey_job

    known = [station.name for station in survey_job(args.survey).stations]
    for point in survey_overview(args.survey):
        known += [point["point"], point["name"]]
    if args.new_point or not args.move or args.move in known:
        return True
    names = list(dict.fromkeys(known))
    listed = ", ".join(map(clean, names[:MAX_LISTED_POINTS]))
    listed += ", ..." if len(names) > MAX_LISTED_POINTS else ""
    if not on_terminal():
        hint = "give --new-point to begin a new one"
        raise OptionError(refusal("--move", f"a point ({listed})", quote(args.move), hint))
    say(f"point {clean(args.move)} is new; the survey has {listed}")
    return input("Begin a new point? [y/N] ").strip().lower() in ("y", "yes")


def _edits(args: argparse.Namespace) -> "list[Edit]":
    from pfwd.files.editing import Edit, parse_declaration_option, parse_position

    edits = [Edit("note", text) for text in args.note or ()]
    if args.discard is not None:
        edits.append(Edit("discard", args.discard or None))
    if args.restore:
        edits.append(Edit("restore"))
    if args.position is not None:
        edits.append(Edit("position", parse_position(args.position)))
    if args.target is not None:
        # Imported here, because other edits do not need it.
        from pfwd.judging.job import target_si
        from tui.measuring_options import survey_job

        judged = survey_job(args.survey).procedure_in_force
        edits.append(Edit("target", target_si(args.target, judged)))
    if args.name is not None:
        edits.append(Edit("name", args.name))
    if args.operator is not None:
        edits.append(Edit("operator", args.operator))
    edits += [Edit("declared", parse_declaration_option(text)) for text in args.set or ()]
    return edits


def _lines(point: Mapping[str, Any], moved: "Mapping[int, Notice]") -> list[str]:
    name = point["point"]
    title = "" if point["name"] == name else f" ({point['name']})"
    state = "  DISCARDED" if point["discarded"] else ""
    lines = [f"point {name}{title}: {counted(len(point['drops']), 'drop')}{state}"]
    if point["target_pa"] is not None:
        from pfwd.judging.job import target_text

        lines.append(f"  target {target_text(point['target_pa'])}")
    if point["position"] is not None:
        lines.append(f"  position {_position(point['position'])}")
    lines += [f"  note: {note}" for note in point["notes"]]
    for drop in point["drops"]:
        place = moved.get(drop["record"])
        remarks = (
            [f"MOVED: {text_of(place)}"] if place else ["DISCARDED"] if drop["discarded"] else []
        )
        remarks += [f"note: {note}" for note in drop["notes"]]
        if drop["position"] is not None:
            remarks.append(f"position {_position(drop['position'])}")
        if remarks:
            lines.append(f"  drop {drop['drop']}: {'; '.join(remarks)}")
    return lines


def _position(position: object) -> str:
    if isinstance(position, Mapping):
        return f"{position.get('latitude')}, {position.get('longitude')}"
    return str(position)
