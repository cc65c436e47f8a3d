"""``pfwd invert``: modulus of the ground for each drop."""

import argparse
import contextlib
import os
from typing import TYPE_CHECKING

from pfwd.analysis.options import AnalysisOptions
from pfwd.errors import OptionError, refusal
from tui.arguments import (
    add_archive,
    add_declared,
    add_expert_group,
    add_jobs,
    add_json,
    add_layers,
    add_plot,
    add_seed,
    add_stored,
    depth,
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
    parser.add_argument(
        "files", nargs="+", metavar="FILE", help="survey, drop or trace file, or a folder of them"
    )
    parser.add_argument(
        "--bedrock-depth",
        type=depth,
        metavar="M",
        help="depth of bedrock in m, or unknown, or none (default: as declared, else fitted)",
    )
    add_layers(parser, "default: 1")
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
    expert.add_argument(
        "--model",
        choices=["layer", "half-space"],
        help="soil on bedrock, or soil without end (default: layer, unless --bedrock-depth none)",
    )
    expert.add_argument(
        "--elastic", action="store_true", help="model of the soil without viscosity"
    )
    expert.add_argument(
        "--load", choices=["measured", "half-sine"], help="load in the model (default: measured)"
    )
    expert.add_argument(
        "--plate",
        choices=["rigid-rough", "rigid-smooth", "published", "uniform"],
        help="contact of plate and ground: a rigid plate that sticks to it or slides on it, the "
        "static pressure of the published method, or an even pressure (default: rigid-rough)",
    )
    expert.add_argument(
        "--sensors", choices=["all", "centre"], help="sensors that are fitted (default: all)"
    )
    expert.add_argument(
        "--joint", action="store_true", help="fit all drops of a point with the same soil"
    )
    expert.add_argument(
        "--method",
        choices=["mpga", "posterior", "least-squares"],
        help="search of the parameters: by a genetic algorithm and from several starting points "
        "(mpga), or from these alone (posterior; least-squares is another name) (default: mpga)",
    )
    expert.add_argument(
        "--published",
        action="store_true",
        help="the published method as a whole (doi 10.11835/j.issn.2096-6717.2022.021)",
    )
    expert.add_argument(
        "--no-priors",
        action="store_true",
        help="do not prefer usual soils where the record leaves the depth of bedrock open",
    )
    add_seed(expert)
    add_archive(expert)
    add_stored(expert)


def run(args: argparse.Namespace) -> int:
    """Invert the files and print the results; return 1 if a file was refused."""
    from pfwd.files.output_path import require_writable
    from tui.archive import has_folder_of_files, run_over_archive

    options = options_from(args)
    if args.plot:
        require_writable(args.plot, "--plot")
    if args.archive is not None or args.scheduler is not None or has_folder_of_files(args.files):
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

    with diagnosis_progress() as progress:
        return list(
            diagnose_files(
                [outcome.file],
                options,
                None,
                args.jobs,
                use_stored=not args.refit,
                progress=progress,
            )
        )


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


def options_from(args: argparse.Namespace) -> AnalysisOptions:
    """Return the options of the command line as those of an analysis.

    Raises
    ------
    OptionError
        If an option is outside its range, or options contradict each other.
    """
    if args.header is not None and not os.path.isfile(args.header):
        raise OptionError(refusal(f"--header {args.header}", "a TOML file", "no such file"))
    return AnalysisOptions(
        model=args.model,
        bedrock_depth=args.bedrock_depth,
        layers=args.layers,
        thickness=args.thickness,
        elastic=args.elastic,
        load=args.load,
        plate=args.plate,
        sensors=args.sensors,
        joint=args.joint,
        method=args.method,
        published=args.published,
        priors=not args.no_priors,
        seed=args.seed,
        header=args.header,
        plate_radius=args.plate_radius,
        poisson_ratio=args.poisson_ratio,
        density=args.density,
        plate_mass=args.plate_mass,
    )


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
    from tui.survey_lines import printed_results

    if outcome.error is not None:
        say(outcome.error)
    for line in printed_results(outcome.results, as_json=as_json, by=by):
        print(line, flush=True)
