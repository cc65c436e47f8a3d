"""``pfwd job``: what a survey is measured by; shows it, or says it anew."""

import argparse

from pfwd.export.json_text import json_text
from pfwd.files.editing import add_events
from pfwd.files.folders import refuse_no_survey
from pfwd.judging import JobRequest
from pfwd.judging.job import time_zone_of
from pfwd.procedures import find_procedure
from tui.job_lines import job_lines
from tui.measuring_options import job_request, kept_job
from tui.output import clean, say


def run(args: argparse.Namespace) -> int:
    """Say what is asked to be said, then show the job."""
    refuse_no_survey(args.survey)
    chosen = None if args.procedure is None else find_procedure(args.procedure)
    request = job_request(args, args.survey, chosen)
    if chosen is not None:
        request = JobRequest(procedure=chosen).over(request)
    if args.time_zone is not None:
        request = JobRequest(time_zone=time_zone_of(args.time_zone)).over(request)
    if request:
        before = kept_job(args.survey, chosen)
        news = request.news(before)
        if news:
            add_events(args.survey, news.events())
            for text in request.differences(before):
                say(f"job: {text}")
    job = kept_job(args.survey)
    if args.json:
        print(json_text(job.as_json()), flush=True)
        return 0
    for line in job_lines(job):
        print(clean(line), flush=True)
    return 0
