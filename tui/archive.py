"""``pfwd invert`` over folders: on processes or a cluster, printed or kept as tables."""

import argparse
import contextlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from pfwd.analysis.options import AnalysisOptions
from pfwd.errors import OptionError, refusal
from pfwd.export.json_text import json_text
from tui.diagnosis_lines import show_diagnosis
from tui.output import clean, say
from tui.progress import counting
from tui.survey_lines import printed_results

if TYPE_CHECKING:
    from pfwd.archive.run import Summary
    from pfwd.archive.work import Failure, Workers

FAILURES_SAID = 20
"""The first ones say what is wrong; all of them are in the tables."""


def run_over_archive(args: argparse.Namespace, options: AnalysisOptions) -> int:
    """Invert or diagnose everything that is named or lies below a folder; 1 when some was refused.

    Raises
    ------
    OptionError, SurveyError
    """
    if args.plot:
        why = "--plot with a folder, --archive or --scheduler"
        hint = "name the files to be plotted"
        raise OptionError(refusal(why, "one of them", "both", hint))
    if args.scheduler is not None and args.jobs > 1:
        raise OptionError(refusal("--scheduler and --jobs", "one of the two", "both"))
    from pfwd.archive.sources import refuse_missing

    refuse_missing(args.files)
    with contextlib.closing(_workers(args, options)) as workers:
        if args.archive is None:
            return _print_all(args, options, workers)
        return _keep_all(args, options, workers)


def _workers(args: argparse.Namespace, options: AnalysisOptions) -> "Workers":
    if args.scheduler is not None:
        from pfwd.archive.cluster import ClusterWorkers, check_address, protection_warning

        check_address(args.scheduler)
        remark = protection_warning(args.scheduler)
        if remark is not None:
            say(remark)
        return ClusterWorkers(options, args.scheduler)
    from pfwd.archive.local import LocalWorkers

    return LocalWorkers(options, args.jobs)


def _print_all(args: argparse.Namespace, options: AnalysisOptions, workers: "Workers") -> int:
    """Print results in the order in which they are done."""
    from pfwd.archive.run import invert_stream

    sources = refused = 0
    for outcome in invert_stream(args.files, options, workers):
        sources += 1
        for failure in outcome.failures:
            refused += 1
            say(failure.reason)
        for diagnosis in outcome.diagnoses:
            show_diagnosis(diagnosis, as_json=args.json)
        if not options.diagnose:
            for line in printed_results(outcome.results, as_json=args.json, by=args.by):
                print(line, flush=True)
    return 1 if refused or _found_none(args, sources) else 0


def _keep_all(args: argparse.Namespace, options: AnalysisOptions, workers: "Workers") -> int:
    """Keep results as tables and print what was done."""
    from pfwd.archive.run import invert_archive
    from pfwd.archive.sources import count_sources

    said = 0
    with counting(lambda: count_sources(args.files, args.archive)) as show:

        def tell(summary: "Summary", failures: "Sequence[Failure]") -> None:
            nonlocal said
            for failure in failures:
                said += 1
                if said <= FAILURES_SAID:
                    say(failure.reason)
                elif said == FAILURES_SAID + 1:
                    say(f"further failures are kept in {args.archive}")
            done = f"{summary.points} points" if options.diagnose else f"{summary.drops} drops"
            show(summary.sources, f"{done}, {summary.failed} failures")

        summary = invert_archive(args.files, args.archive, options, workers, tell)
    if args.json:
        print(json_text(summary.as_dict()), flush=True)
    else:
        for line in _summary_lines(summary, diagnosed=options.diagnose):
            print(clean(line), flush=True)
    return 1 if summary.failed_in_all or _found_none(args, summary.sources) else 0


def _summary_lines(summary: "Summary", *, diagnosed: bool) -> Iterator[str]:
    done = f"{summary.points} points diagnosed" if diagnosed else f"{summary.drops} drops inverted"
    yield (
        f"{summary.archive}: {summary.sources} sources, {summary.done_before} done before, "
        f"{summary.duplicates} copies, {done} in {summary.elapsed_s:.1f} s"
    )
    if summary.failed_in_all:
        yield (
            f"{summary.failed_in_all} sources with failures; the reasons are in "
            f"failures/run={summary.run} and unfinished/{summary.run}.jsonl"
        )


def _found_none(args: argparse.Namespace, sources: int) -> bool:
    if sources:
        return False
    say(refusal(", ".join(args.files), "a survey, or files with drops in the folder", "none"))
    return True
