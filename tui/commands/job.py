"""``pfwd job``: show or change procedure, targets, stations and other settings of a survey."""

import argparse

from pfwd.export.json_text import json_text
from tui.arguments import add_job, add_json
from tui.output import clean, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd job`` and its description to the parser."""
    parser.description = (
        "Shows procedure, targets, stations and other settings of a survey, with the date of "
        "every change, or changes them. All points are judged by the last settings. live and log "
        "take the same options and store the same settings."
    )
    parser.add_argument("survey", metavar="SURVEY", help="folder, or a survey in one file")
    parser.add_argument(
        "--procedure", metavar="NAME", help="a name listed by pfwd procedures, or a TOML file"
    )
    add_job(parser)
    parser.add_argument(
        "--time-zone",
        metavar="+HH:MM",
        help="zone of local times without one, as in imported files; exports then have UTC (west "
        "of Greenwich: --time-zone=-05:00)",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Store the settings of the options, then print all settings."""
    from pfwd.files.editing import add_events
    from pfwd.files.folders import is_survey_file, refuse_no_survey
    from pfwd.judging import JobRequest
    from pfwd.judging.job import time_zone_of
    from pfwd.procedures import find_procedure
    from tui.job_lines import job_lines
    from tui.measuring_options import job_request, survey_job

    if not is_survey_file(args.survey):
        refuse_no_survey(args.survey)
    chosen = None if args.procedure is None else find_procedure(args.procedure)
    request = job_request(args, args.survey, chosen)
    if chosen is not None:
        request = JobRequest(procedure=chosen).over(request)
    if args.time_zone is not None:
        request = JobRequest(time_zone=time_zone_of(args.time_zone)).over(request)
    if request:
        before = survey_job(args.survey, chosen)
        news = request.news(before)
        if news:
            add_events(args.survey, news.events())
            for text in request.differences(before):
                say(f"job: {text}")
    job = survey_job(args.survey)
    if args.json:
        print(json_text(job.as_json()), flush=True)
        return 0
    for line in job_lines(job):
        print(clean(line), flush=True)
    return 0
