"""Runs one part, or the quick ones."""

import sys
from importlib import import_module

PARTS = {
    "speed": "analysis times, and the paper's literal method against the surrogate",
    "search": "the genetic search on Rastrigin, Ackley and harder functions",
    "surrogate": "the surrogate against the converged rule over the whole parameter range",
    "coverage": "intervals against the truth of finite-element drops (some minutes)",
    "noise": "the random part of the uncertainty against 200 noisy copies",
    "acquisition": "8 channels at 50 kHz beside the simulator; a day with --day",
    "pictures": "draw the pictures of the documentation anew, from a replay (some minutes)",
    "screen": "the live screen: first paint, updates, processor time, lost samples (a minute)",
    "opened": "pfwd open on 5,000 points: first paint, the answer to every key (two minutes)",
    "scale": "every command on 2,500 and on 10,000 drops (ten minutes; --short)",
    "faults": "kills, truncations, full disks, unplugged cables (half an hour; --short; --below)",
    "power_loss": "recording under kills at every call and power loss (some minutes)",
    "wire": "cables pulled, instruments killed, bytes damaged, 115200 baud (half an hour; --short)",
    "firmware": "sizes of the instrument's core on a Cortex-M3",
    "archive": "an archive inverted anew, its cost and its safety (six minutes; --short)",
    "devices": "ten grounds under ten unlike devices (some minutes; --short)",
    "loop": "the diagnosis on a blind campaign of undeclared effects (an hour; --short)",
    "closing": "all figures of docs/closing-the-loop.md (half an hour)",
    "measured": "the loop closed on measured drops in a FOLDER (some minutes)",
    "structures": "evidence of structures on measured drops, and of causes in place of rock",
    "layers": "layered ground: accuracy and speed of the forward model (some minutes; --short)",
    "tables": "build the response tables that ship with the package",
    "example_files": "make the files of pfwd.example anew, from finite elements (a minute)",
    "validation": "the paper's 48 cases by finite elements (some minutes)",
}
QUICK = ("speed", "search")
CAMPAIGNS = ("faults", "power_loss", "wire")
"""Parts that inject faults; their code is in tests/campaigns, as the tests use it."""


def main(arguments: list[str]) -> int:
    """Run the part named first, or the quick parts."""
    if arguments and not arguments[0].startswith("-"):
        name, *rest = arguments
        if name not in PARTS:
            print(f"pfwd bench: expected one of {', '.join(PARTS)}, got {name}", file=sys.stderr)
            return 2
        return _run(name, rest)
    if "--help" in arguments or "-h" in arguments:
        print("pfwd bench [PART] [--json]; without PART:", ", ".join(QUICK))
        for name, what in PARTS.items():
            print(f"  {name:11} {what}")
        return 0
    return max(_run(name, arguments) for name in QUICK)


def _run(name: str, arguments: list[str]) -> int:
    folder = "tests.campaigns" if name in CAMPAIGNS else "benchmarks"
    try:
        return int(import_module(f"{folder}.{name}").run(arguments))
    except SystemExit as wrong:  # of the part's parser, which has said what is wrong
        return int(wrong.code or 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
