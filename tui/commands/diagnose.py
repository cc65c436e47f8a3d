"""``pfwd diagnose``: effects that explain the residuals, and the modulus to use."""

import argparse
import os
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from pfwd.errors import OptionError, refusal
from pfwd.message_groups import as_ranges
from tui.arguments import (
    add_archive,
    add_declared,
    add_expert_group,
    add_files,
    add_jobs,
    add_json,
    add_options,
    add_plot,
    add_stored,
    analysis_options,
)
from tui.output import clean, counted, say
from tui.progress import diagnosis_progress

if TYPE_CHECKING:
    from pfwd.analysis.diagnosis.diagnose import Diagnosed
    from pfwd.analysis.results import DiagnosisResult


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd diagnose`` and its description to the parser."""
    parser.description = (
        "Searches effects of ground and device that explain the residuals of each point. Reports "
        "which modulus to use, or that nothing explains them. Files that declare the same device "
        "are one survey."
    )
    add_files(parser, "FILE", "survey, drop or trace file")
    parser.add_argument(
        "--details",
        action="store_true",
        help="show every point in full and all warnings; a single point is always shown so",
    )
    parser.add_argument(
        "--device", metavar="D.toml", help="known device effects, as written by --write-device"
    )
    parser.add_argument(
        "--write-device", metavar="D.toml", help="write the device effects for other surveys"
    )
    parser.add_argument(
        "--leave-out",
        choices=("next", "drop", "sensor", "point"),
        help="check the prediction: of the last drop of each point (next), of each drop or of each "
        "sensor, without using it; point: with the device effects of the other points",
    )
    add_plot(parser)
    add_jobs(parser)
    add_json(parser, "point")
    add_declared(parser)
    expert = add_expert_group(parser)
    expert.add_argument(
        "--allow",
        choices=("stiffness",),
        help="with --leave-out next or drop: fit this one number to the predicted drop",
    )
    add_options(expert, "elastic", "load", elastic="base model without viscosity of the soil")
    add_archive(expert)
    add_stored(expert)


def run(args: argparse.Namespace) -> int:
    """Diagnose the points of the files and print the results; return 1 if a file was refused."""
    from pfwd.files.output_path import require_writable
    from tui.archive import is_archive, run_over_archive

    if args.allow is not None and args.leave_out not in ("next", "drop"):
        mode = args.leave_out or "none"
        raise OptionError(refusal(f"--allow {args.allow}", "--leave-out next or drop", mode))
    for option, path in (("--plot", args.plot), ("--write-device", args.write_device)):
        if path:
            require_writable(path, option)
    options = analysis_options(args)
    if is_archive(args):
        return run_over_archive(args, replace(options, diagnose=True))
    from pfwd.analysis.diagnosis.device_file import device_of, read_device, write_device_file
    from pfwd.analysis.diagnosis.diagnose import diagnose_files
    from pfwd.analysis.diagnosis.entries import DiagnosisRequest

    device, spread = read_device(args.device) if args.device else (None, None)
    try:
        with diagnosis_progress() as progress:
            request = DiagnosisRequest(
                device=device,
                spread=spread,
                leave_out=args.leave_out,
                allow=args.allow,
                # A plot and a device file need values that a survey does not store.
                use_stored=not (args.refit or args.plot or args.write_device),
                jobs=args.jobs,
                progress=progress,
            )
            points = list(diagnose_files(args.files, options, request))
    except KeyboardInterrupt:
        say("diagnose: finished points are stored; the same command continues with the others")
        raise
    name = device_of(points) if args.write_device else None
    show_all(points, as_json=args.json, details=args.details)
    if args.leave_out is not None:
        _report_not_held_out(points, args.leave_out)
    store_all(points, store=not args.no_store)
    if args.write_device:
        write_device_file(args.write_device, points, name)
        say(f"device effects written to {args.write_device}")
    if args.plot:
        from pfwd.analysis.diagnosis.plots import plot_diagnoses

        plot_diagnoses([point.result for point in points if point.result], args.plot)
        say(f"plot {args.plot}")
    return 1 if any(point.error for point in points) else 0


def _report_not_held_out(diagnosed: "Sequence[Diagnosed]", mode: str) -> None:
    """Report the points without a held-out prediction, and what `--leave-out` needs."""
    results = [
        point.result for point in diagnosed if point.result is not None and point.result.drops
    ]
    names = list(dict.fromkeys(clean(point.point or point.file) for point in results))
    without = [
        clean(point.point or point.file)
        for point in results
        if point.held_out is None or point.held_out.mode != mode
    ]
    if without:
        expected = {
            "next": "two drops or more",
            "drop": "two drops or more",
            "sensor": "two sensors or more",
            "point": "two points or more of one device that share something",
        }[mode]
        say(f"--leave-out {mode}: expected {expected}, got fewer at {as_ranges(without, names)}")


def store_all(points: "Sequence[Diagnosed]", *, store: bool) -> None:
    """Store new diagnoses in their surveys, and report how many were stored before."""
    from pfwd.analysis.result_store import store_diagnoses

    by_file: dict[str, list[tuple[int, DiagnosisResult]]] = {}
    for diagnosed in points:
        if diagnosed.number is not None and diagnosed.result is not None:
            by_file.setdefault(diagnosed.file, []).append((diagnosed.number, diagnosed.result))
    for file, results in by_file.items():
        stored = [result for _, result in results if result.stored]
        if stored:
            software = ", ".join(sorted({str(result.software) for result in stored}))
            say(
                f"{file}: {len(stored)} of {len(results)} diagnoses are stored results "
                f"({software}); --refit computes them again"
            )
        failed = store_diagnoses(file, results) if store and os.path.isdir(file) else None
        if failed is not None:
            say(failed)


def show_all(points: "Sequence[Diagnosed]", *, as_json: bool, details: bool = False) -> None:
    """Print diagnoses.

    A single point is printed in full. Several points are a table, with `details` followed by each
    point in full; advice on the device and warnings come last.

    Parameters
    ----------
    points : sequence of Diagnosed
    as_json : bool
        True: one JSON object for each point instead.
    details : bool
        True: several points are printed in full as well.
    """
    from pfwd.judging.view import with_moduli_in_force
    from tui.diagnosis_lines import (
        SCREEN_LINES,
        WIDTH,
        diagnosis_warnings,
        printed_diagnosis,
        survey_lines,
        wrapped,
    )

    for diagnosed in points:
        if diagnosed.error is not None:
            say(diagnosed.error)
    results = with_moduli_in_force([p.result for p in points if p.result is not None])
    several = len(results) > 1
    lines = survey_lines(results) if several and not as_json else []
    if as_json or details or not several:
        for result in results:
            if as_json or not several or result.drops != ():
                lines += printed_diagnosis(result, as_json=as_json, device_advice=not several)
        lines += [] if as_json else diagnosis_warnings(results)
    else:
        warnings = diagnosis_warnings(results)
        warning_lines = [part for warning in warnings for part in wrapped(warning, WIDTH)]
        if not warning_lines or len(lines) + len(warning_lines) < SCREEN_LINES:
            lines += [*warning_lines, "--details shows each point in full"]
        else:
            number = counted(len(warnings), "warning")
            lines.append(f"{number}: --details shows them, and each point in full")
    for line in lines:
        print(line, flush=True)
