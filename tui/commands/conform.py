"""``pfwd conform``: test whether an instrument fulfils the protocol."""

import argparse
import dataclasses

from pfwd.errors import OptionError, refusal
from pfwd.export.json_text import json_text
from tui.arguments import add_json, count, not_negative
from tui.output import clean, say

_SIGNS = {"passed": "passed", "failed": "FAILED", "not-offered": "not offered"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd conform`` and its description to the parser."""
    parser.description = (
        "Tests every numbered requirement of docs/protocol.md, one line each: passed, failed, or "
        "not offered. Takes two minutes; make one drop when you are asked to. Exit status 1 when "
        "a requirement failed."
    )
    parser.add_argument("url", metavar="URL", help="port of the instrument, as for log")
    parser.add_argument(
        "--baud-rate", type=count, metavar="N", default=115_200, help="default: 115200"
    )
    parser.add_argument(
        "--wait",
        type=not_negative,
        metavar="S",
        default=15.0,
        help="seconds to wait for a drop (default: 15; 0: no drop will be made)",
    )
    parser.add_argument(
        "--only", metavar="P-N,...", help="requirements to test, separated by commas (default: all)"
    )
    parser.add_argument(
        "--logger",
        metavar="SETUP.toml",
        help="try a data logger for --wait seconds instead, and write what it sent into --output",
    )
    parser.add_argument(
        "-o", "--output", metavar="TRIAL.json", help="file for --logger, to send to the project"
    )
    add_json(parser, "requirement")


def run(args: argparse.Namespace) -> int:
    """Test the requirements of the protocol and print one line for each.

    Returns
    -------
    int
        1 if the instrument fails a requirement.
    """
    if args.logger is not None:
        return _try_logger(args)
    from pfwd.ports import conform

    counts = dict.fromkeys(_SIGNS, 0)
    results = conform(
        args.url,
        baud_rate=args.baud_rate,
        drop_wait=args.wait,
        announce=say,
        only=args.only.split(",") if args.only else (),
    )
    for result in results:
        counts[result.result] += 1
        if args.json:
            print(json_text(dataclasses.asdict(result)), flush=True)
        else:
            number, sign = result.requirement, _SIGNS[result.result]
            print(f"{number:<5} {sign:<11}  {result.title}: {clean(result.detail)}", flush=True)
    say(", ".join(f"{count} {_SIGNS[name].lower()}" for name, count in counts.items()))
    return 1 if counts["failed"] else 0


def _try_logger(args: argparse.Namespace) -> int:
    """Write what a logger sends; return 1 if samples are missing or none arrived."""
    from pfwd.files.output_path import require_writable
    from pfwd.session.setup_file import read_setup_file
    from pfwd.session.trial import try_logger

    if args.output is None:
        raise OptionError(refusal("--output", "a file for the trial", "none"))
    require_writable(args.output, "--output")
    trial = try_logger(args.url, read_setup_file(args.logger), args.wait)
    with open(args.output, "w", encoding="utf-8", newline="\n") as stream:
        stream.write(json_text(trial) + "\n")
    print(f"{trial['samples']} samples in {trial['seconds']:.1f} s", end="")
    print(f", {trial['missing_samples']} missing, {trial['runs']} runs")
    for event in trial["events"]:
        print(clean(event))
    say(f"{args.output} written: send it to the project")
    return 0 if trial["samples"] and not trial["missing_samples"] and trial["runs"] == 1 else 1
