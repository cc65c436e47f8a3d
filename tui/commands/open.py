"""``pfwd open``: stored results on the screen, or as pages for a browser; nothing is computed."""

import argparse
import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

from pfwd.errors import OptionError, refusal
from tui.arguments import add_json
from tui.output import on_terminal, say

if TYPE_CHECKING:
    from tui.screen.opened.rows import OpenedSurvey

USAGE = 2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd open`` and its description to the parser."""
    parser.description = (
        "Shows stored results: points (sorted, filtered), profile, map, drops over each other, two "
        "points compared, the settings of the survey. Keys write a report or an export. Nothing is "
        "computed again, and nothing in the survey is changed."
    )
    parser.add_argument("survey", metavar="SURVEY", help="folder, or a survey in one file")
    parser.add_argument(
        "--serve",
        nargs="?",
        const="",
        metavar="HOST:PORT",
        help="serve read-only pages for a browser instead of the screen (default: 127.0.0.1:8765; "
        "on another host a code gives one browser access)",
    )
    parser.add_argument(
        "--photos",
        nargs="?",
        const="strip",
        choices=("strip", "keep"),
        help="with --serve: accept photos of points from the browser; strip (default) removes the "
        "position that the camera wrote into them",
    )
    add_json(parser, "point")


def run(args: argparse.Namespace) -> int:
    """Show the survey until the user closes it."""
    from pfwd.files.folders import is_survey_file, refuse_no_survey
    from pfwd.files.survey_file import survey_folder
    from tui.screen.opened.rows import OpenedSurvey

    if args.photos is not None and args.serve is None:
        raise OptionError(refusal("--photos", "--serve as well", "no --serve"))
    if args.photos is not None:
        refuse_no_survey(args.survey)  # photos are stored in a folder only
    with survey_folder(args.survey) as folder:
        # Rows of a temporary folder are not kept in the cache of the platform.
        cache = Path(f"{folder}.rows.json") if is_survey_file(args.survey) else None
        return _show(args, OpenedSurvey(folder, cache))


def _show(args: argparse.Namespace, survey: "OpenedSurvey") -> int:
    if args.serve is not None:
        return _serve(args, survey)
    if args.json:
        return _lines(survey)
    if not on_terminal():
        say("open: expected a terminal, got a pipe or a file; print the points with --json")
        return USAGE
    from tui.screen.opened.app import show_survey
    from tui.screen.settings import load_settings

    return show_survey(survey, load_settings())


def _lines(opened: "OpenedSurvey") -> int:
    from pfwd.export.json_text import json_text
    from pfwd.judging import point_views

    opened.read()
    for point in point_views(opened.survey, opened.job):
        print(json_text(point.as_json()), flush=True)
    for text in opened.survey.damage:
        say(text)
    return 0


def _serve(args: argparse.Namespace, survey: "OpenedSurvey") -> int:
    from tui.page.server import SurveyServer, parse_place

    host, port = parse_place(args.serve)
    with SurveyServer(survey, host, port, say, args.photos) as server:
        access = "read only" if args.photos is None else "read only, photos can be added"
        say(f"{args.survey} at {server.url}, {access}; ctrl+c ends it")
        if server.needs_code:
            say(f"code, for one browser: {server.code}")
        with contextlib.suppress(KeyboardInterrupt):
            server.serve_forever(poll_interval=0.2)
    return 0
