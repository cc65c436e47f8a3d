"""``pfwd conform``: does an instrument keep the protocol?"""

import argparse
import dataclasses

from pfwd.export.json_text import json_text
from pfwd.ports import conform
from tui.output import clean, say

_SIGNS = {"passed": "passed", "failed": "FAILED", "not-offered": "not offered"}


def run(args: argparse.Namespace) -> int:
    """Try every requirement of the protocol; one line each.

    Returns
    -------
    int
        1 when one failed.
    """
    counts = dict.fromkeys(_SIGNS, 0)
    found = conform(
        args.url,
        baud_rate=args.baud_rate,
        drop_wait=args.wait,
        announce=say,
        only=args.only.split(",") if args.only else (),
    )
    for result in found:
        counts[result.result] += 1
        if args.json:
            print(json_text(dataclasses.asdict(result)), flush=True)
        else:
            number, sign = result.requirement, _SIGNS[result.result]
            print(f"{number:<5} {sign:<11}  {result.title}: {clean(result.detail)}", flush=True)
    say(", ".join(f"{count} {_SIGNS[name].lower()}" for name, count in counts.items()))
    return 1 if counts["failed"] else 0
