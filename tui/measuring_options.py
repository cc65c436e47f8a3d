"""Conversion of options of the commands that measure or replay: analysis, setup, job, output
folder.
"""

import argparse
import os
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

from pfwd.analysis.options import AnalysisOptions
from pfwd.errors import OptionError, SurveyError, refusal
from pfwd.files.folders import is_survey, is_survey_file
from pfwd.files.output_path import refuse_bad_place
from pfwd.judging import Job, JobRequest, target_si
from pfwd.judging.stations import read_stations
from pfwd.judging.view import job_of_folder
from pfwd.procedures import NO_PROCEDURE, Procedure, find_procedure
from pfwd.session.plan import SessionPlan
from pfwd.session.position import PositionReceiver
from pfwd.session.setup_file import MeasuringSetup, read_setup_file, with_procedure
from tui.arguments import analysis_options
from tui.output import on_terminal, say


def measuring_options(args: argparse.Namespace) -> AnalysisOptions | None:
    """Return the options of the analysis; None: drops are not inverted.

    Raises
    ------
    OptionError
        If an option is outside its range, or options contradict each other.
    """
    layer_options = [name for name in ("layers", "thickness") if getattr(args, name) is not None]
    if args.no_invert and layer_options:
        raise OptionError(
            refusal(f"--no-invert and --{layer_options[0]}", "one of the two", "both")
        )
    if args.no_invert:
        return None
    return replace(analysis_options(args), diagnose=args.diagnose)


def measuring_setup(args: argparse.Namespace) -> MeasuringSetup:
    """Return the declarations of the setup file and of ``--procedure``.

    Raises
    ------
    OptionError, TraceError, SetupError
        If the file or the procedure cannot be used.
    """
    setup = read_setup_file(args.setup) if args.setup else MeasuringSetup()
    if args.procedure is not None:
        setup = with_procedure(setup, find_procedure(args.procedure))
    return setup


def session_plan(
    args: argparse.Namespace,
    setup: MeasuringSetup,
    job: JobRequest,
    default_procedure: Procedure | None,
    *,
    calibration: Literal["refuse", "ask"],
) -> tuple[SessionPlan, PositionReceiver | None]:
    """Return the plan of a session with an instrument, and the satellite receiver in it.

    Parameters
    ----------
    args : argparse.Namespace
    setup : MeasuringSetup
    job : JobRequest
    default_procedure : Procedure or None
        Procedure of a new survey if none is chosen.
    calibration : "refuse" or "ask"
        What to do with an instrument whose calibration has changed, unless the command line
        accepts it.

    Raises
    ------
    OptionError
        If an option is outside its range, or options contradict each other.
    """
    receiver = None if args.gps is None else PositionReceiver(args.gps)
    plan = SessionPlan(
        point=args.point,
        setup=setup,
        job=job,
        default_procedure=default_procedure,
        drops=args.drops,
        options=measuring_options(args),
        give_up=args.give_up,
        changed_calibration="accept" if args.accept_calibration else calibration,
        position=receiver,
    )
    return plan, receiver


def job_request(
    args: argparse.Namespace,
    survey: str | os.PathLike[str],
    procedure: Procedure | None,
    default: Procedure | None = None,
    on_remark: Callable[[str], None] = say,
) -> JobRequest:
    """Return the changes of a survey's settings (its job) by the command line.

    Parameters
    ----------
    args : argparse.Namespace
    survey : path of a folder, which may not exist yet
    procedure : Procedure or None
        Procedure of the command line; None: the survey's procedure stays.
    default : Procedure, optional
        Procedure of a new survey if none is chosen.
    on_remark : callable, optional
        Receives a line about columns of the station list that are not used.

    Raises
    ------
    OptionError, SurveyError, RecordingError
        If target, stations or survey cannot be used.
    """
    request = JobRequest(step_m=args.step, operator=args.operator)
    if args.target is None and args.stations is None:
        return request
    # The unit of a target depends on the procedure.
    in_force = procedure or survey_job(survey).procedure or default or NO_PROCEDURE
    stations = None if args.stations is None else read_stations(args.stations, in_force, on_remark)
    target = None if args.target is None else target_si(args.target, in_force)
    return replace(request, target=target, stations=stations)


def try_output(survey: str | os.PathLike[str]) -> None:
    """Check that a survey can be written to a folder, before work begins.

    Raises
    ------
    OptionError, SurveyError
        If it cannot be written; the message has the reason.
    """
    path = Path(survey)
    if is_survey(path):
        return  # an existing survey is checked when it is opened
    refuse_bad_place(path, "--output")
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
    """Ask the user whether to change the settings of an existing survey.

    Returns
    -------
    bool
        True: the user agrees, nothing changes, or there is no terminal to ask on.

    Raises
    ------
    SurveyError, RecordingError
        If the survey cannot be read.
    """
    if procedure is not None:
        request = JobRequest(procedure=procedure).over(request)
    differences = request.differences(survey_job(survey, procedure))
    if not differences or not on_terminal():
        return True
    for text in differences:
        say(text)
    say("the change applies to all points of the survey, also to those measured before")
    answer = input("Continue? [y/N] ")
    return answer.strip().lower() in ("y", "yes")


def survey_job(survey: str | os.PathLike[str], replacement: Procedure | None = None) -> Job:
    """Return the settings of a survey; empty ones if it does not exist yet.

    Parameters
    ----------
    survey : path of a folder, or of a survey in one file
    replacement : Procedure, optional
        Procedure to use in place of the stored one, which may then be unreadable.
    """
    known = is_survey(survey) or is_survey_file(survey)
    return job_of_folder(survey, replacement) if known else Job()
