"""``pfwd open``: stored results on the screen, or as pages for a browser; nothing is computed."""

import argparse
import contextlib

from pfwd.errors import OptionError, refusal
from tui.arguments import add_json
from tui.output import on_terminal, say

USAGE = 2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd open`` and its description to the parser."""
    parser.description = (
        "Shows stored results: points (sorted, filtered), profile, map, drops over each other, two "
        "points compared, the settings of the survey. Keys write a report or an export. Nothing is "
        "computed again, and nothing in the survey is changed."
    )
    parser.add_argument("survey", metavar="SURVEY", help="folder")
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
    from pfwd.files.folders import refuse_no_survey

    refuse_no_survey(args.survey)
    if args.photos is not None and args.serve is None:
        raise OptionError(refusal("--photos", "--serve as well", "no --serve"))
    if args.serve is not None:
        return _serve(args)
    if args.json:
        return _lines(args)
    if not on_terminal():
        say("open: expected a terminal, got a pipe or a file; print the points with --json")
        return USAGE
    from tui.screen.opened.app import show_survey
    from tui.screen.settings import load_settings

    return show_survey(args.survey, load_settings())


def _lines(args: argparse.Namespace) -> int:
    from pfwd.export.json_text import json_text
    from pfwd.judging import point_views
    from tui.screen.opened.rows import OpenedSurvey

    opened = OpenedSurvey(args.survey)
    opened.read()
    for point in point_views(opened.survey, opened.job):
        print(json_text(point.as_json()), flush=True)
    for text in opened.survey.damage:
        say(text)
    return 0


def _serve(args: argparse.Namespace) -> int:
    from tui.page.server import SurveyServer, parse_place
    from tui.screen.opened.rows import OpenedSurvey

    host, port = parse_place(args.serve)
    with SurveyServer(OpenedSurvey(args.survey), host, port, say, args.photos) as server:
        access = "read only" if args.photos is None else "read only, photos can be added"
        say(f"{args.survey} at {server.url}, {access}; ctrl+c ends it")
        if server.needs_code:
            say(f"code, for one browser: {server.code}")
        with contextlib.suppress(KeyboardInterrupt):
            server.serve_forever(poll_interval=0.2)
    return 0
