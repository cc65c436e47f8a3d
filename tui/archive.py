"""``pfwd invert`` and ``pfwd diagnose`` over folders, by processes or a cluster.

An archive is any number of surveys and files. A source is one of them. Results are printed, or
stored as tables in a folder (option ``--archive``).
"""

import argparse
import contextlib
import os
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from pfwd.analysis.options import AnalysisOptions
from pfwd.errors import OptionError, refusal
from pfwd.export.json_text import json_text
from tui.diagnosis_lines import printed_diagnosis
from tui.format import printed_results
from tui.output import clean, counted, say
from tui.progress import ProgressBars

if TYPE_CHECKING:
    from pfwd.archive.run import Summary
    from pfwd.archive.work import ArchiveWorkers, SourceFailure

MAX_PRINTED_FAILURES = 20
"""Largest number of failures that are printed; all of them are in the tables."""


def is_archive(args: argparse.Namespace) -> bool:
    """Return whether a command works on an archive, because of an option or a folder of files."""
    if args.archive is not None or args.scheduler is not None:
        return True
    folders = [path for path in args.files if os.path.isdir(path)]
    if not folders:
        return False
    from pfwd.files.folders import is_survey

    return not all(map(is_survey, folders))


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
    for name in ("plot", "device", "write_device", "leave_out", "allow"):
        if getattr(args, name, None) is not None:
            option = "--" + name.replace("_", "-")
            conflict = f"{option} with a folder, --archive or --scheduler"
            raise OptionError(refusal(conflict, "one of them", "both", "name the files"))
    if args.scheduler is not None and args.jobs > 1:
        raise OptionError(refusal("--scheduler and --jobs", "one of the two", "both"))
    from pfwd.archive.run import invert_stream, refuse_missing
    from pfwd.archive.work import ArchiveWorkers

    refuse_missing(args.files)
    if args.scheduler is not None:
        from pfwd.archive.cluster import ClusterWorkers, protection_warning

        if (remark := protection_warning(args.scheduler)) is not None:
            say(remark)
        workers: ArchiveWorkers = ClusterWorkers(options, args.scheduler)
    else:
        workers = ArchiveWorkers(options, args.jobs)
    n_sources = n_failures = 0
    with contextlib.closing(workers):
        if args.archive is not None:
            n_sources, n_failures = _store_all(args, workers)
        else:  # results are printed in the order in which they are computed
            for outcome in invert_stream(args.files, workers):
                n_sources += 1
                n_failures += len(outcome.failures)
                for failure in outcome.failures:
                    say(failure.reason)
                results = [result for result, _ in outcome.results]
                lines = printed_results(results, as_json=args.json, by=args.by) if results else []
                for diagnosis in outcome.diagnoses:
                    lines += printed_diagnosis(diagnosis, as_json=args.json)
                for line in lines:
                    print(line, flush=True)
    if not n_sources:
        say(refusal(", ".join(args.files), "a survey, or files with drops in the folder", "none"))
    return 1 if n_failures or not n_sources else 0


def _store_all(args: argparse.Namespace, workers: "ArchiveWorkers") -> tuple[int, int]:
    """Store results as tables and print a summary; return the counts of sources and failures."""
    from pfwd.archive.run import find_sources, invert_archive

    n_failures = 0
    with ProgressBars() as bars:
        n_sources = None
        if bars.is_terminal:
            bars.update("counting files")
            n_sources = sum(1 for _ in find_sources(args.files, args.archive))

        def report(summary: "Summary", failures: "Sequence[SourceFailure]") -> None:
            nonlocal n_failures
            for failure in failures:
                n_failures += 1
                if n_failures <= MAX_PRINTED_FAILURES:
                    say(failure.reason)
                elif n_failures == MAX_PRINTED_FAILURES + 1:
                    say(f"further failures are stored in {args.archive}")
            results = (
                counted(summary.points, "point") if diagnosed else counted(summary.drops, "drop")
            )
            bars.update(f"{results}, {summary.failed} failures", summary.sources, n_sources)

        diagnosed = workers.options.diagnose
        summary = invert_archive(args.files, args.archive, workers, report)
    if args.json:
        print(json_text(asdict(summary)), flush=True)
        return summary.sources, summary.failed_in_all
    results = (
        f"{summary.points} points diagnosed" if diagnosed else f"{summary.drops} drops inverted"
    )
    lines = [
        f"{summary.archive}: {summary.sources} sources, {summary.done_before} done before, "
        f"{summary.duplicates} copies, {results} in {summary.elapsed_s:.1f} s"
    ]
    if summary.failed_in_all:
        lines.append(
            f"{summary.failed_in_all} sources with failures; the reasons are in "
            f"failures/run={summary.run} and unfinished/{summary.run}.jsonl"
        )
    print(*map(clean, lines), sep="\n", flush=True)
    return summary.sources, summary.failed_in_all
