"""What a command that measures or replays asks of the analysis of its drops."""

import argparse
import os
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from pfwd.analysis.options import AnalysisOptions
from pfwd.errors import OptionError, SurveyError, refusal
from pfwd.files.folders import is_survey
from pfwd.files.output_path import refuse_inside_survey
from pfwd.judging import Job, JobRequest, target_si
from pfwd.judging.stations import read_stations
from pfwd.judging.view import job_of_folder
from pfwd.procedures import NO_PROCEDURE, Procedure, find_procedure
from pfwd.session.setup_file import MeasuringSetup, read_setup_file, with_procedure
from tui.output import on_terminal, say


def measuring_options(args: argparse.Namespace) -> AnalysisOptions | None:
    """The options of the command line, checked; None: nothing is inverted.

    Raises
    ------
    OptionError
    """
    asked = [name for name in ("layers", "thickness") if getattr(args, name) is not None]
    if args.no_invert and asked:
        raise OptionError(refusal(f"--no-invert and --{asked[0]}", "one of the two", "both"))
    if args.no_invert:
        return None
    return AnalysisOptions(
        seed=args.seed, layers=args.layers, thickness=args.thickness, diagnose=args.diagnose
    )


def measuring_setup(args: argparse.Namespace) -> MeasuringSetup:
    """What the setup file and ``--procedure`` declare.

    Raises
    ------
    OptionError, TraceError, SetupError
    """
    setup = read_setup_file(args.setup) if args.setup else MeasuringSetup()
    if args.procedure is not None:
        setup = with_procedure(setup, find_procedure(args.procedure))
    return setup


def job_request(
    args: argparse.Namespace,
    survey: str | os.PathLike[str],
    procedure: Procedure | None,
    usual: Procedure | None = None,
    on_remark: Callable[[str], None] = say,
) -> JobRequest:
    """What the command line says of the survey's job.

    Parameters
    ----------
    args : argparse.Namespace
    survey : path of a folder
        Which may not be there yet.
    procedure : Procedure, optional
        Chosen now; None: the survey's own counts.
    usual : Procedure, optional
        Of a survey that begins now.
    on_remark : callable, optional
        Receives one line about columns of the station list that are not used.

    Raises
    ------
    OptionError, SurveyError, RecordingError
    """
    asked = JobRequest(step_m=args.step, operator=args.operator)
    if args.target is None and args.stations is None:
        return asked
    # Targets are typed in the unit of what is judged.
    judged = procedure or kept_job(survey).procedure or usual or NO_PROCEDURE
    stations = None if args.stations is None else read_stations(args.stations, judged, on_remark)
    target = None if args.target is None else target_si(args.target, judged)
    return replace(asked, target=target, stations=stations)


def try_output(survey: str | os.PathLike[str]) -> None:
    """Try whether a survey can be written there, before anything else is begun.

    Raises
    ------
    OptionError, SurveyError
        With what stands in the way.
    """
    path = Path(survey)
    if is_survey(path):
        return  # its own lock and journal tell
    refuse_inside_survey(path, "--output")
    expected = "a folder that can be written"
    if path.exists() and not path.is_dir():
        raise SurveyError(refusal(os.fspath(path), expected, "a file"))
    there = next(part for part in (path, *path.absolute().parents) if part.exists())
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as err:
        reason = err.strerror or str(err)
        raise SurveyError(refusal(os.fspath(path), expected, f"{there}: {reason}")) from err


def agreed_on_terminal(
    survey: str | os.PathLike[str], procedure: Procedure | None, request: JobRequest
) -> bool:
    """Whether to go on where the command line says otherwise than the survey; asked on a terminal.

    Raises
    ------
    SurveyError, RecordingError
    """
    asked = request if procedure is None else JobRequest(procedure=procedure).over(request)
    differences = asked.differences(kept_job(survey, procedure))
    if not differences or not on_terminal():
        return True
    for text in differences:
        say(text)
    say("all points of the survey will be judged so, those that are measured too")
    answer = input("go on? [y/N] ")
    return answer.strip().lower() in ("y", "yes")


def kept_job(survey: str | os.PathLike[str], instead: Procedure | None = None) -> Job:
    """The job of a survey; that of one that is not there yet is empty.

    Parameters
    ----------
    survey : path of a folder
    instead : Procedure, optional
        Chosen in place of the kept one, which may then be one that cannot be read.
    """
    return job_of_folder(survey, instead) if is_survey(survey) else Job()
