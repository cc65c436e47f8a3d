"""Options of the commands that measure or replay: analysis, setup, job, output folder."""

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
    """Return the checked options of the analysis; None: nothing is inverted.

    Raises
    ------
    OptionError
    """
    layer_options = [name for name in ("layers", "thickness") if getattr(args, name) is not None]
    if args.no_invert and layer_options:
        raise OptionError(
            refusal(f"--no-invert and --{layer_options[0]}", "one of the two", "both")
        )
    if args.no_invert:
        return None
    return AnalysisOptions(
        seed=args.seed, layers=args.layers, thickness=args.thickness, diagnose=args.diagnose
    )


def measuring_setup(args: argparse.Namespace) -> MeasuringSetup:
    """Return what the setup file and ``--procedure`` declare.

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
    default: Procedure | None = None,
    on_remark: Callable[[str], None] = say,
) -> JobRequest:
    """Return the settings of the survey that the command line changes.

    Parameters
    ----------
    args : argparse.Namespace
    survey : path of a folder
        It may not exist yet.
    procedure : Procedure, optional
        Procedure of the command line; None: that of the survey counts.
    default : Procedure, optional
        Procedure of a new survey.
    on_remark : callable, optional
        Receives a line about columns of the station list that are not used.

    Raises
    ------
    OptionError, SurveyError, RecordingError
    """
    request = JobRequest(step_m=args.step, operator=args.operator)
    if args.target is None and args.stations is None:
        return request
    # Targets are given in the unit of the procedure.
    in_force = procedure or survey_job(survey).procedure or default or NO_PROCEDURE
    stations = None if args.stations is None else read_stations(args.stations, in_force, on_remark)
    target = None if args.target is None else target_si(args.target, in_force)
    return replace(request, target=target, stations=stations)


def try_output(survey: str | os.PathLike[str]) -> None:
    """Check that a survey can be written to a folder, before any other work.

    Raises
    ------
    OptionError, SurveyError
        If it cannot, with the reason.
    """
    path = Path(survey)
    if is_survey(path):
        return  # its lock and journal are checked when it is opened
    refuse_inside_survey(path, "--output")
    expected = "a folder that can be written"
    if path.exists() and not path.is_dir():
        raise SurveyError(refusal(os.fspath(path), expected, "a file"))
    parent = next(part for part in (path, *path.absolute().parents) if part.exists())
    try:
        with tempfile.TemporaryFile(dir=parent):
            pass
    except OSError as err:
        reason = err.strerror or str(err)
        raise SurveyError(refusal(os.fspath(path), expected, f"{parent}: {reason}")) from err


def agreed_on_terminal(
    survey: str | os.PathLike[str], procedure: Procedure | None, request: JobRequest
) -> bool:
    """Return whether to go on although settings differ from the survey's; a terminal asks.

    Raises
    ------
    SurveyError, RecordingError
    """
    if procedure is not None:
        request = JobRequest(procedure=procedure).over(request)
    differences = request.differences(survey_job(survey, procedure))
    if not differences or not on_terminal():
        return True
    for text in differences:
        say(text)
    say("all points of the survey will be judged so, measured ones too")
    answer = input("go on? [y/N] ")
    return answer.strip().lower() in ("y", "yes")


def survey_job(survey: str | os.PathLike[str], replacement: Procedure | None = None) -> Job:
    """Return the settings of a survey; empty if it does not exist yet.

    Parameters
    ----------
    survey : path of a folder
    replacement : Procedure, optional
        Procedure in place of the stored one, which then may be unreadable.
    """
    return job_of_folder(survey, replacement) if is_survey(survey) else Job()
