"""``pfwd calibrate``: calibrate load cell and geophone on springs, by momentum, by a release."""

import argparse
import dataclasses
import os

from pfwd.errors import OptionError, refusal
from pfwd.export.json_text import json_text
from pfwd.message_groups import text_of
from tui.arguments import add_files, add_json, number
from tui.output import clean, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd calibrate`` and its description to the parser."""
    parser.description = (
        "Fits gain, natural frequency, damping and delay to drops on a rig of springs, with their "
        "intervals, or says why the drops do not repeat. A spring determines only the ratio of the "
        "gains of load cell and geophone, so the gain of one of them is assumed to be correct. "
        "--momentum finds the gain of the load cell from a hammer of known mass, --ring natural "
        "frequency and damping of a geophone from its decay after a release."
    )
    way = parser.add_mutually_exclusive_group()
    way.add_argument(
        "--momentum",
        action="store_true",
        help="gain of the load cell from --mass and --height; up to the second contact",
    )
    way.add_argument(
        "--ring",
        action="store_true",
        help="natural frequency and damping from a decay: records of a drop file, or a text file "
        "with columns of numbers and --column",
    )
    parser.add_argument("--mass", type=number, metavar="kg", help="mass of the hammer (--momentum)")
    parser.add_argument("--height", type=number, metavar="m", help="height of fall (--momentum)")
    parser.add_argument(
        "--friction",
        type=number,
        default=0.0,
        metavar="SHARE",
        help="largest friction of the guide over the weight, such as 0.03 (--momentum; default: 0)",
    )
    parser.add_argument("--column", metavar="NAME", help="column of the text file (--ring)")
    parser.add_argument(
        "--time-column",
        metavar="NAME",
        help="column of the times in s (--ring; default: the first)",
    )
    add_files(parser, "FILE", "survey, drop or trace file")
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
    if args.momentum or args.ring:
        return _without_rig(args)
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
        say(f"calibrate: {text_of(warning)}")
    for text in calibration.reasons:
        say(f"calibrate: the drops do not repeat: {text}")
    if args.output is not None and not calibration.reasons:
        write_calibration(args.output, calibration)
        say(f"calibration written to {args.output}")
    elif args.output is not None:
        say(f"calibrate: {args.output} was not written, because the drops do not repeat")
    return 1 if calibration.reasons else 0


def _without_rig(args: argparse.Namespace) -> int:
    """Calibrate by momentum or by a decay, and print the result."""
    from pfwd.analysis.sensor_calibration import decays_of_file, gain_of_files

    if args.output is not None:
        hint = "write the printed values into the setup file or into the instrument"
        raise OptionError(refusal("--output", "springs with --stiffness", "another way", hint))
    if args.momentum:
        for name in ("mass", "height"):
            value = getattr(args, name)
            if value is None or not value > 0:
                got = "none" if value is None else f"{value:g}"
                raise OptionError(refusal(f"--{name}", "a number > 0", got))
        if not 0 <= args.friction < 0.5:
            raise OptionError(refusal("--friction", "from 0 to 0.5", f"{args.friction:g}"))
        gain, warnings = gain_of_files(
            args.files, args.mass, args.height, args.friction, point=args.point, header=args.header
        )
        for warning in warnings:
            say(f"calibrate: {warning}")
        if args.json:
            print(json_text({"files": args.files} | dataclasses.asdict(gain)), flush=True)
            return 0
        low, high = gain.interval
        print(f"gain of the load cell {gain.value:.4g} (95 %: {low:.4g} to {high:.4g}), ", end="")
        print(f"{gain.drops} drops: multiply its sensitivity by this")
        return 0
    for file in args.files:
        for name, parts in decays_of_file(file, args.column, args.time_column, args.header):
            if args.json:
                windows = [dataclasses.asdict(part) for part in parts]
                print(json_text({"file": file, "record": name, "windows": windows}), flush=True)
                continue
            print(clean(f"{file}, {name}"))
            for part in parts:
                frequency, damping = part.natural_frequency_interval, part.damping_interval
                print(
                    f"  {part.start:.2f} to {part.end:.2f} s, amplitude {part.amplitude:.3g}: "
                    f"natural frequency {part.natural_frequency:.4g} Hz "
                    f"(95 %: {frequency[0]:.4g} to {frequency[1]:.4g}), "
                    f"damping {part.damping:.3g} ({damping[0]:.3g} to {damping[1]:.3g})"
                )
    return 0
