"""``pfwd invert``: modulus of the ground for each drop."""

import argparse
import contextlib
import os
from typing import TYPE_CHECKING

from pfwd.analysis.options import AnalysisOptions
from tui.arguments import (
    add_archive,
    add_declared,
    add_expert_group,
    add_files,
    add_jobs,
    add_json,
    add_options,
    add_plot,
    add_seed,
    add_stored,
    analysis_options,
)
from tui.output import say
from tui.progress import ProgressBars, diagnosis_progress

if TYPE_CHECKING:
    from pfwd.analysis.diagnosis.diagnose import Diagnosed
    from pfwd.analysis.results import FileOutcome
    from tui.format import By


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd invert`` and its description to the parser."""
    parser.description = (
        "Computes modulus, viscosity, density and depth of bedrock for each drop of surveys and "
        "trace files. An option replaces what a file declares; an undeclared depth is fitted. A "
        "folder that is no survey stands for all surveys and files below it."
    )
    add_files(parser, "FILE", "survey, drop or trace file, or a folder of them")
    add_options(parser, "bedrock_depth", "layers", "thickness")
    parser.add_argument(
        "--diagnose",
        action="store_true",
        help="diagnose the points too, and print the modulus to use beside that of the fit",
    )
    parser.add_argument(
        "--by",
        choices=["point", "drop"],
        default="drop",
        help="print a line for each point or for each drop (default: drop)",
    )
    add_plot(parser)
    add_jobs(parser)
    add_json(parser, "drop")
    add_declared(parser)
    expert = add_expert_group(parser)
    add_options(expert, "model", "elastic", "load", "plate", "sensors", "joint", "method")
    add_options(expert, "published", "priors")
    add_seed(expert)
    add_archive(expert)
    add_stored(expert)


def run(args: argparse.Namespace) -> int:
    """Invert the files and print the results; return 1 if a file was refused."""
    from pfwd.files.output_path import require_writable
    from tui.archive import is_archive, run_over_archive

    options = analysis_options(args)
    if args.plot:
        require_writable(args.plot, "--plot")
    if is_archive(args):
        return run_over_archive(args, options)
    from pfwd.analysis.analyse import analyse_files

    refused = False
    to_plot: list[FileOutcome] = []
    with ProgressBars() as bars:

        def report_table(table: str, fraction: float) -> None:
            text = f"computing the response table of {table}, once"
            bars.update(text, round(100 * fraction), 100, work="table", line=True)

        n_files = len(args.files)
        bars.update("inverting", 0, n_files)
        # A plot shows fitted traces, which a survey does not store.
        use_stored = not args.refit and not args.plot
        outcomes = analyse_files(
            args.files, options, args.jobs, report_table, use_stored=use_stored
        )
        # Closed in any case, so that its processes end if printing fails.
        with contextlib.closing(outcomes):
            for number, outcome in enumerate(outcomes, 1):
                bars.clear()
                refused |= outcome.error is not None
                diagnosed = _diagnose(outcome, options, args) if args.diagnose else []
                if diagnosed:
                    from pfwd.analysis.diagnosis.diagnose import with_diagnoses

                    outcome = with_diagnoses(outcome, diagnosed)
                show(outcome, as_json=args.json, by=args.by)
                _store(outcome, store=not args.no_store)
                if diagnosed:
                    _report_diagnoses(diagnosed, as_json=args.json, store=not args.no_store)
                if args.plot:
                    to_plot.append(outcome)
                if number < n_files:
                    bars.update("inverting", number, n_files)
    if args.plot:
        from pfwd.analysis.plots import plot_outcomes

        for picture in plot_outcomes(to_plot, args.plot):
            say(f"plot {picture}")
    return 1 if refused else 0


def _store(outcome: "FileOutcome", *, store: bool) -> None:
    """Store new results in their survey, and report how many were stored before."""
    from pfwd.analysis.result_store import store_drop_results, stored_results_text

    if outcome.of_survey:
        text = stored_results_text(outcome.file, [result for _, result in outcome.of_survey])
        if store and os.path.isdir(outcome.file):
            text = store_drop_results(outcome.file, outcome.of_survey) or text
        if text is not None:
            say(text)


def _diagnose(
    outcome: "FileOutcome", options: AnalysisOptions, args: argparse.Namespace
) -> "list[Diagnosed]":
    """Return the diagnoses of the points of an inverted file; empty: the file was refused."""
    if outcome.error is not None:
        return []
    from pfwd.analysis.diagnosis.diagnose import diagnose_files
    from pfwd.analysis.diagnosis.entries import DiagnosisRequest

    with diagnosis_progress() as progress:
        request = DiagnosisRequest(use_stored=not args.refit, jobs=args.jobs, progress=progress)
        return list(diagnose_files([outcome.file], options, request))


def _report_diagnoses(diagnosed: "list[Diagnosed]", *, as_json: bool, store: bool) -> None:
    """Store diagnoses and print them; as JSON, the results of the drops contain them already."""
    from tui.commands.diagnose import show_all, store_all

    if as_json:
        for point in diagnosed:
            if point.error is not None:
                say(point.error)
    else:
        show_all(diagnosed, as_json=False)
    store_all(diagnosed, store=store)


def show(outcome: "FileOutcome", *, as_json: bool, by: "By" = "drop") -> None:
    """Print the results of a file to standard output, or the reason of its refusal to standard
    error.

    Parameters
    ----------
    outcome : FileOutcome
    as_json : bool
        True: one JSON object for each drop.
    by : "point" or "drop"
        A line of text for each point, or for each drop.
    """
    from tui.format import printed_results

    if outcome.error is not None:
        say(outcome.error)
    for line in printed_results(outcome.results, as_json=as_json, by=by):
        print(line, flush=True)
