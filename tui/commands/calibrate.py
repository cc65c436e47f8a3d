"""``pfwd calibrate``: load cell and geophone from a rig of known stiffness."""

import argparse
import os

from pfwd.errors import OptionError, refusal
from pfwd.export.json_text import json_text
from pfwd.files.output_path import require_writable
from tui.arguments import add_json, number
from tui.output import clean, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd calibrate``."""
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
    """Calibrate; 1 when the drops do not repeat, so that nothing is kept."""
    if args.header is not None and not os.path.isfile(args.header):
        raise OptionError(refusal(f"--header {args.header}", "a TOML file", "no such file"))
    if args.stiffness is not None and not args.stiffness > 0:
        raise OptionError(refusal("--stiffness", "a number > 0, in N/m", f"{args.stiffness:g}"))
    if args.output is not None:
        require_writable(args.output, "--output")
    from pfwd.analysis.calibrating import calibrate_files, write_calibration

    found = calibrate_files(
        args.files, args.stiffness, point=args.point, gain_of=args.gain_of, header=args.header
    )
    said = found.to_json()
    if args.json:
        print(json_text(said), flush=True)
    else:
        device = "" if found.device is None else f"device {found.device}, "
        rigs = ", ".join(f"{value / 1e6:.4g} MN/m" for value in found.stiffness)
        print(clean(f"{device}{found.found.drops} drops on rigs of {rigs}"))
        names = (
            (f"gain of the {found.gain_of}", said["gain"], 1.0, ""),
            ("natural frequency", said["natural_frequency_hz"], 1.0, " Hz"),
            ("damping", said["damping"], 1.0, ""),
            ("delay", said["delay_s"], 1e6, " us"),
        )
        for name, one, scale, unit in names:
            low, high = (scale * end for end in one["interval"])
            print(f"  {name} {scale * one['value']:.4g}{unit} (95 %: {low:.4g} to {high:.4g})")
        print(f"  left over: {100 * found.found.misfit:.2g} % of the peak velocity")
    for warning in found.warnings:
        say(f"calibrate: {warning}")
    for text in found.reasons:
        say(f"calibrate: does not repeat: {text}")
    if args.output is not None and not found.reasons:
        write_calibration(args.output, found)
        say(f"calibration written to {args.output}")
    elif args.output is not None:
        say(f"calibrate: nothing is written to {args.output}")
    return 1 if found.reasons else 0
