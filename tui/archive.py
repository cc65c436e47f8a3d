"""``pfwd invert`` and ``pfwd diagnose`` over folders, by processes or a cluster.

An archive is any number of surveys and files. A source is one of them. Results are printed, or
stored as tables in a folder (option ``--archive``).
"""

import argparse
import contextlib
import os
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from pfwd.analysis.options import AnalysisOptions
from pfwd.errors import OptionError, refusal
from pfwd.export.json_text import json_text
from tui.diagnosis_lines import show_diagnosis
from tui.format import printed_results
from tui.output import clean, say
from tui.progress import ProgressBars

if TYPE_CHECKING:
    from pfwd.archive.run import Summary
    from pfwd.archive.work import ArchiveWorkers, SourceFailure

MAX_PRINTED_FAILURES = 20
"""Largest number of failures that are printed; all of them are in the tables."""


def has_folder_of_files(paths: Sequence[str]) -> bool:
    """Return whether one of the paths is a folder that is not a survey."""
    if not any(map(os.path.isdir, paths)):
        return False
    from pfwd.files.folders import is_survey

    return any(os.path.isdir(path) and not is_survey(path) for path in paths)


def run_over_archive(args: argparse.Namespace, options: AnalysisOptions) -> int:
    """Invert or diagnose all named files and all files in named folders.

    Returns
    -------
    int
        1 if a file was refused, or there are none.

    Raises
    ------
    OptionError, SurveyError
        If options contradict each other, or a path does not exist.
    """
    if args.plot:
        options_in_conflict = "--plot with a folder, --archive or --scheduler"
        hint = "name the files to be plotted"
        raise OptionError(refusal(options_in_conflict, "one of them", "both", hint))
    if args.scheduler is not None and args.jobs > 1:
        raise OptionError(refusal("--scheduler and --jobs", "one of the two", "both"))
    from pfwd.archive.sources import refuse_missing

    refuse_missing(args.files)
    with contextlib.closing(_workers(args, options)) as workers:
        if args.archive is None:
            return _print_all(args, options, workers)
        return _store_all(args, options, workers)


def _workers(args: argparse.Namespace, options: AnalysisOptions) -> "ArchiveWorkers":
    if args.scheduler is not None:
        from pfwd.archive.cluster import ClusterWorkers, check_address, protection_warning

        check_address(args.scheduler)
        remark = protection_warning(args.scheduler)
        if remark is not None:
            say(remark)
        return ClusterWorkers(options, args.scheduler)
    from pfwd.archive.work import ArchiveWorkers

    return ArchiveWorkers(options, args.jobs)


def _print_all(
    args: argparse.Namespace, options: AnalysisOptions, workers: "ArchiveWorkers"
) -> int:
    """Print results in the order in which they are computed."""
    from pfwd.archive.run import invert_stream

    n_sources = n_failures = 0
    for outcome in invert_stream(args.files, options, workers):
        n_sources += 1
        for failure in outcome.failures:
            n_failures += 1
            say(failure.reason)
        for diagnosis in outcome.diagnoses:
            show_diagnosis(diagnosis, as_json=args.json)
        if not options.diagnose:
            for line in printed_results(
                [result for result, _ in outcome.results], as_json=args.json, by=args.by
            ):
                print(line, flush=True)
    return 1 if n_failures or _refuse_empty(args, n_sources) else 0


def _store_all(
    args: argparse.Namespace, options: AnalysisOptions, workers: "ArchiveWorkers"
) -> int:
    """Store results as tables and print a summary."""
    from pfwd.archive.run import invert_archive
    from pfwd.archive.sources import count_sources

    n_failures = 0
    with ProgressBars() as bars:
        n_sources = None
        if bars.is_terminal:
            bars.update("counting files")
            n_sources = count_sources(args.files, args.archive)

        def report(summary: "Summary", failures: "Sequence[SourceFailure]") -> None:
            nonlocal n_failures
            for failure in failures:
                n_failures += 1
                if n_failures <= MAX_PRINTED_FAILURES:
                    say(failure.reason)
                elif n_failures == MAX_PRINTED_FAILURES + 1:
                    say(f"further failures are stored in {args.archive}")
            results = f"{summary.points} points" if options.diagnose else f"{summary.drops} drops"
            bars.update(f"{results}, {summary.failed} failures", summary.sources, n_sources)

        summary = invert_archive(args.files, args.archive, options, workers, report)
    if args.json:
        print(json_text(summary.as_dict()), flush=True)
    else:
        for line in _summary_lines(summary, diagnosed=options.diagnose):
            print(clean(line), flush=True)
    return 1 if summary.failed_in_all or _refuse_empty(args, summary.sources) else 0


def _summary_lines(summary: "Summary", *, diagnosed: bool) -> Iterator[str]:
    results = (
        f"{summary.points} points diagnosed" if diagnosed else f"{summary.drops} drops inverted"
    )
    yield (
        f"{summary.archive}: {summary.sources} sources, {summary.done_before} done before, "
        f"{summary.duplicates} copies, {results} in {summary.elapsed_s:.1f} s"
    )
    if summary.failed_in_all:
        yield (
            f"{summary.failed_in_all} sources with failures; the reasons are in "
            f"failures/run={summary.run} and unfinished/{summary.run}.jsonl"
        )


def _refuse_empty(args: argparse.Namespace, n_sources: int) -> bool:
    """Return whether there are no sources, and report it."""
    if n_sources:
        return False
    say(refusal(", ".join(args.files), "a survey, or files with drops in the folder", "none"))
    return True
