"""Command line of the benchmarks: runs one part, or those in `QUICK`."""

import sys
from importlib import import_module

PARTS = {
    "speed": "analysis times, and those of the forward model (a minute)",
    "coverage": "intervals against the truth of finite-element drops (some minutes)",
    "calibration": "ranks of true values in the posterior, by simulation (ten minutes; --cases)",
    "acquisition": "8 channels at 50 kHz in real time (half a minute); 24 hours with --day",
    "pictures": "draw the pictures of the documentation from a replay (some minutes)",
    "screen": "the live screen: first paint, updates, processor time, lost samples (a minute)",
    "opened": "pfwd open on 5,000 points: first paint, response to every key (two minutes)",
    "scale": "commands on surveys of 2,500 and 10,000 drops (ten minutes; --short)",
    "faults": "kills, damaged or replaced files, full disks, cables (half an hour; --short)",
    "power_loss": "recording under kills at every call and power loss (some minutes)",
    "wire": "cables pulled, instruments killed, bytes damaged, 115200 baud (half an hour; --short)",
    "firmware": "sizes of the instrument's core on a Cortex-M3; fuzzing with --fuzz SECONDS",
    "loop": "the diagnosis on a blind campaign of undeclared effects (an hour; --short)",
    "measured": "fit and held-out prediction of measured drops in FILES (some minutes)",
    "layers": "layered ground inverted from finite-element drops (some minutes)",
    "tables": "build the response tables of the package that are missing",
    "example_files": "make the files of pfwd.example from finite elements (a minute)",
    "validation": "the 48 cases of the published study (some minutes)",
}
QUICK = ("speed",)
"""Names of the parts that run if the command has no arguments."""
CAMPAIGNS = ("faults", "power_loss", "wire")
"""Names of the parts that inject faults; their code is in tests/campaigns, because the tests use
it."""


def main(arguments: list[str]) -> int:
    """Run the part that the first argument names, or the quick parts; return the exit status."""
    if arguments and not arguments[0].startswith("-"):
        name, *rest = arguments
        if name not in PARTS:
            print(f"pfwd bench: expected one of {', '.join(PARTS)}, got {name}", file=sys.stderr)
            return 2
        return _run(name, rest)
    if "--help" in arguments or "-h" in arguments:
        print("pfwd bench [PART] [--json]; without PART:", ", ".join(QUICK))
        for name, description in PARTS.items():
            print(f"  {name:13} {description}")
        return 0
    return max(_run(name, arguments) for name in QUICK)


def _run(name: str, arguments: list[str]) -> int:
    folder = "tests.campaigns" if name in CAMPAIGNS else "benchmarks"
    try:
        return int(import_module(f"{folder}.{name}").run(arguments))
    except SystemExit as exit_request:  # the parser of the part has printed the error
        return int(exit_request.code or 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
