"""``pfwd calibrate``: calibrate load cell and geophone by drops on a rig of known stiffness."""

import argparse
import os

from pfwd.errors import OptionError, refusal
from pfwd.export.json_text import json_text
from tui.arguments import add_json, number
from tui.output import clean, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd calibrate`` and its description to the parser."""
    parser.description = (
        "Fits gain, natural frequency, damping and delay to drops on a rig of springs, with their "
        "intervals, or says why the drops do not repeat. A spring determines only the ratio of the "
        "gains of load cell and geophone, so the gain of one of them is assumed to be correct."
    )
    parser.add_argument("files", nargs="+", metavar="FILE", help="survey, drop or trace file")
    parser.add_argument(
        "--stiffness",
        type=number,
        metavar="N/m",
        help="stiffness of the rig; replaces stiffness_n_per_m of the files",
    )
    parser.add_argument(
        "--point", metavar="NAME", help="use only points whose names begin with NAME: one rig"
    )
    parser.add_argument(
        "--gain-of",
        choices=("sensor", "load"),
        default="sensor",
        help="channel whose gain is fitted; that of the other is assumed to be correct (default: "
        "sensor)",
    )
    parser.add_argument(
        "-o", "--output", metavar="D.toml", help="write the calibration, for diagnose --device"
    )
    parser.add_argument("--header", metavar="FILE.toml", help="replaces what the files declare")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Fit the calibration, print it, and write it to a file.

    Returns
    -------
    int
        1 if the drops contradict each other; then no file is written.
    """
    if args.header is not None and not os.path.isfile(args.header):
        raise OptionError(refusal(f"--header {args.header}", "a TOML file", "no such file"))
    if args.stiffness is not None and not args.stiffness > 0:
        raise OptionError(refusal("--stiffness", "a number > 0, in N/m", f"{args.stiffness:g}"))
    from pfwd.analysis.calibrating import calibrate_files, write_calibration
    from pfwd.files.output_path import require_writable

    if args.output is not None:
        require_writable(args.output, "--output")

    calibration = calibrate_files(
        args.files, args.stiffness, point=args.point, gain_of=args.gain_of, header=args.header
    )
    record = calibration.to_json()
    if args.json:
        print(json_text(record), flush=True)
    else:
        device = "" if calibration.device is None else f"device {calibration.device}, "
        rigs = ", ".join(f"{value / 1e6:.4g} MN/m" for value in calibration.stiffness)
        print(clean(f"{device}{calibration.fit.drops} drops on rigs of {rigs}"))
        parameters = (
            (f"gain of the {calibration.gain_of}", record["gain"], 1.0, ""),
            ("natural frequency", record["natural_frequency_hz"], 1.0, " Hz"),
            ("damping", record["damping"], 1.0, ""),
            ("delay", record["delay_s"], 1e6, " us"),
        )
        for name, parameter, scale, unit in parameters:
            low, high = (scale * end for end in parameter["interval"])
            print(
                f"  {name} {scale * parameter['value']:.4g}{unit} (95 %: {low:.4g} to {high:.4g})"
            )
        print(f"  misfit: {100 * calibration.fit.misfit:.2g} % of the peak velocity")
    for warning in calibration.warnings:
        say(f"calibrate: {warning}")
    for text in calibration.reasons:
        say(f"calibrate: the drops do not repeat: {text}")
    if args.output is not None and not calibration.reasons:
        write_calibration(args.output, calibration)
        say(f"calibration written to {args.output}")
    elif args.output is not None:
        say(f"calibrate: {args.output} was not written, because the drops do not repeat")
    return 1 if calibration.reasons else 0
