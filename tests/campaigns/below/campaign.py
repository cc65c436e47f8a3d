"""The campaign: trials side by side, judged, counted and told."""

import argparse
import atexit
import multiprocessing
import os
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.output import Reporter
from simulators.instrument import SimulatedInstrument
from tests.campaigns.below import command, limits, quick, replacements
from tests.campaigns.below.judge import ACKNOWLEDGED, Outcome, Verdict, judge
from tests.campaigns.below.planted import PLANTED, VARIABLE
from tests.campaigns.below.shim import Fault, compile_shim, why_not
from tests.campaigns.below.sweep import Counts, faults
from tests.campaigns.hasty_instrument import hasty_instrument

MOST_TOLD = 30
"""Unlike faults of the program that are told in full; all are counted."""


NEWS = 60.0
"""s between two lines that say how far it is."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One run to be judged."""

    part: str
    number: int
    seed: int
    fault: Fault
    plan: str


@dataclass(slots=True)
class Told:
    """What came of a trial."""

    trial: Trial
    verdict: Verdict
    fired: int
    """Calls that failed; of a replacement one."""
    acknowledged: int
    output: str
    seconds: float


@dataclass
class Tally:
    """What a part of the campaign found."""

    trials: int = 0
    fired: int = 0
    """Trials whose fault came."""
    calls: int = 0
    """Calls that failed."""
    acknowledged: int = 0
    lost: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    red: list[Told] = field(default_factory=list)

    def add(self, told: Told) -> None:
        """Count a trial; one whose fault never came is judged like the others."""
        self.trials += 1
        self.fired += told.fired > 0
        self.calls += told.fired
        self.acknowledged += told.acknowledged
        self.lost += len(told.verdict.lost)
        self.faults.update(told.verdict.faults)
        if not told.verdict.good:
            self.red.append(told)


_library = Path()
_planted = ""


def _begin(library: Path, planted: str) -> None:
    global _library, _planted
    _library, _planted = library, planted
    os.environ[VARIABLE] = planted


def _told(trial: Trial, outcome: Outcome, fired: int, began: float) -> Told:
    acknowledged = sum(said.what == ACKNOWLEDGED for said in outcome.said)
    seconds = time.monotonic() - began
    return Told(trial, judge(outcome), fired, acknowledged, outcome.output, seconds)


_driver: quick.Driver | None = None


def _run_quick(trial: Trial) -> Told:
    global _driver
    began = time.monotonic()
    _driver = _driver or quick.Driver(_library, _planted)
    with _scratch() as folder:
        outcome, counted = quick.trial(_driver, folder, trial.fault, trial.plan, trial.number)
    return _told(trial, outcome, counted.fired, began)


_instruments: list[SimulatedInstrument] = []


def _urls() -> tuple[str, str]:
    """Of an instrument that drops its hammer ten times a second while this process lives."""
    while len(_instruments) < 2:
        context = hasty_instrument(os.getpid() + len(_instruments))
        _instruments.append(context.__enter__())
        atexit.register(context.__exit__, None, None, None)
    return _instruments[0].url, _instruments[1].url


def _run_command(trial: Trial) -> Told:
    began = time.monotonic()
    with _scratch() as folder:
        outcome, counted = command.trial(_library, _urls()[0], folder, trial.fault, trial.plan)
    return _told(trial, outcome, counted.fired, began)


_killed: command.Killed | None = None
_killed_folder: tempfile.TemporaryDirectory[str] | None = None


def _killed_once() -> command.Killed:
    """The survey that every recovery of this process begins with."""
    global _killed, _killed_folder
    if _killed is None:
        _killed_folder = tempfile.TemporaryDirectory(prefix="pfwd-below-")
        _killed = command.killed_session(_urls()[0], Path(_killed_folder.name))
    return _killed


def _run_recovery(trial: Trial) -> Told:
    began = time.monotonic()
    killed = _killed_once()
    with _scratch() as folder:
        outcome, counted = command.recovery_trial(_library, folder, killed, trial.fault)
    return _told(trial, outcome, counted.fired, began)


def _run_replacement(trial: Trial) -> Told:
    began = time.monotonic()
    killed = trial.number % 5 == 4
    with _scratch() as folder:
        seed = trial.seed * 100_000 + trial.number
        outcome, done = replacements.trial(_urls(), folder, trial.plan, seed, killed=killed)
    return _told(trial, outcome, done, began)


@contextmanager
def _scratch() -> Iterator[Path]:
    memory = Path("/dev/shm")
    where = memory if os.access(memory, os.W_OK) else None
    with tempfile.TemporaryDirectory(prefix="pfwd-below-", dir=where) as folder:
        yield Path(folder).resolve()


def quick_counts(library: Path, plan: str) -> Counts:
    """Calls of a run without a fault."""
    with quick.driver(library) as process, _scratch() as folder:
        outcome, counted = quick.trial(process, folder, Fault(), plan, 0)
    if not judge(outcome).good or not outcome.said:
        raise RuntimeError(f"expected a run without a fault to be good, got {judge(outcome)}")
    return counted.counts


def quick_trials(library: Path, number: int, seed: int) -> list[Trial]:
    """Trials of every plan, each with the calls that it makes."""
    rng = np.random.default_rng(seed)
    trials: list[Trial] = []
    share = -(-number // len(quick.PLANS))
    for plan in quick.PLANS:
        found = faults(quick_counts(library, plan), share, rng)
        begun = len(trials)
        trials += [Trial("quick", begun + n, seed, fault, plan) for n, fault in enumerate(found)]
    return trials


COMMAND_PLANS = ("end", "kill", "end with capture")


def _command_plan(number: int, fault: Fault) -> str:
    if fault.kinds == ("captures",):
        return COMMAND_PLANS[-1]
    return COMMAND_PLANS[number % len(COMMAND_PLANS)]


def command_trials(library: Path, number: int, seed: int) -> list[Trial]:
    """Trials of the command, each with the calls that it makes."""
    rng = np.random.default_rng([seed, 1])
    with hasty_instrument(seed) as instrument, _scratch() as folder:
        plan = COMMAND_PLANS[-1]
        outcome, counted = command.trial(library, instrument.url, folder, Fault(), plan)
    if not judge(outcome).good or not outcome.said:
        raise RuntimeError(f"expected a run without a fault to be good, got {judge(outcome)}")
    return [
        Trial("command", n, seed, fault, _command_plan(n, fault))
        for n, fault in enumerate(faults(counted.counts, number, rng))
    ]


def recovery_trials(library: Path, number: int, seed: int) -> list[Trial]:
    """Trials of `pfwd recover`, each with the calls that it makes."""
    rng = np.random.default_rng([seed, 2])
    with hasty_instrument(seed) as instrument, _scratch() as before, _scratch() as folder:
        killed = command.killed_session(instrument.url, before)
        outcome, counted = command.recovery_trial(library, folder, killed, Fault())
    if not judge(outcome).good or not outcome.said:
        raise RuntimeError(f"expected a run without a fault to be good, got {judge(outcome)}")
    found = faults(counted.counts, number, rng)
    return [Trial("recover", n, seed, fault, "recovered") for n, fault in enumerate(found)]


def replacement_trials(_library: Path, number: int, seed: int) -> list[Trial]:
    """Each replacement in turn, as often as there are trials."""
    cannot = replacements.impossible()
    for name, reason in cannot.items():
        print(f"  {name}: SKIPPED: {reason}", file=sys.stderr)
    names = [name for name in replacements.REPLACEMENTS if name not in cannot]
    # In another order for every seed, so that short runs come to meet them all.
    order = np.random.default_rng([seed, 3]).permutation(len(names))
    return [
        Trial("replace", n, seed, Fault(), names[int(order[n % len(names)])]) for n in range(number)
    ]


PARTS: dict[str, tuple[Callable[[Path, int, int], list[Trial]], Callable[[Trial], Told], int, int]]
PARTS = {
    "quick": (quick_trials, _run_quick, 3000, 300),
    "command": (command_trials, _run_command, 400, 12),
    "recover": (recovery_trials, _run_recovery, 150, 10),
    "replace": (replacement_trials, _run_replacement, 222, 12),
}
"""By name: what makes the trials, what runs one, how many of them, how many with ``--short``."""


def run(arguments: list[str]) -> int:
    """The campaign below all code; 0 when nothing was lost and nothing wrong was said."""
    parser = argparse.ArgumentParser(prog="pfwd bench faults --below")
    parser.add_argument("--short", action="store_true", help="a minute")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--part", choices=PARTS, action="append", help="only this one")
    parser.add_argument("--limits", action="store_true", help="what cannot be promised instead")
    parser.add_argument("--trials", type=int, help="so many in every part")
    parser.add_argument("--trial", type=int, help="only this one of a part, with all it said")
    parser.add_argument("--plant", choices=PLANTED, help="a bug, to see that it is noticed")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    report = Reporter(arguments)
    reason = why_not()
    if reason is not None:
        report.record(skipped=reason)
        return 0
    good = True
    with tempfile.TemporaryDirectory(prefix="pfwd-below-") as folder:
        library = compile_shim(Path(folder))
        for name in args.part or (() if args.limits else PARTS):
            make, run_trial, number, short = PARTS[name]
            count = args.trials or (short if args.short else number)
            began = time.monotonic()
            news = began + NEWS
            tally = Tally()
            trials = make(library, count, args.seed)
            if args.trial is not None:
                trials = [trial for trial in trials if trial.number == args.trial]
            for told in _side_by_side(run_trial, trials, library, args):
                tally.add(told)
                if time.monotonic() > news:
                    news = time.monotonic() + NEWS
                    so_far = f"{tally.trials} of {len(trials)}, {len(tally.red)} red"
                    print(f"  {name}: {so_far}", file=sys.stderr, flush=True)
                if args.trial is not None:
                    print(told.output, file=sys.stderr)
            _report(report, name, tally, time.monotonic() - began)
            good &= not tally.red and tally.fired > 0
        if args.limits:
            _limits(report, args.trials or 5, args.seed)
    return 0 if good else 1


def _limits(report: Reporter, number: int, seed: int) -> None:
    """What the promise cannot cover; told, and no fault of the program."""
    for name in limits.LIMITS:
        found = []
        for n in range(number):
            with _scratch() as folder:
                found.append(limits.trial(_urls()[0], folder, name, seed * 1000 + n)[0])
        report.record(
            limit=name,
            trials=number,
            acknowledged=sum(met.acknowledged for met in found),
            lost=sum(met.lost for met in found),
            trials_with_loss=sum(met.lost > 0 for met in found),
            said_not_safe=sum(met.said for met in found),
            noticed_by_check=sum(met.noticed for met in found),
        )


def _side_by_side(
    run_trial: Callable[[Trial], Told], trials: list[Trial], library: Path, args: argparse.Namespace
) -> Iterator[Told]:
    with ProcessPoolExecutor(
        args.jobs,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_begin,
        initargs=(library, args.plant or ""),
    ) as pool:
        yield from pool.map(run_trial, trials, chunksize=4)


def _report(report: Reporter, part: str, tally: Tally, seconds: float) -> None:
    report.record(
        part=part,
        trials=tally.trials,
        fired=tally.fired,
        calls_failed=tally.calls,
        acknowledged=tally.acknowledged,
        records_lost=tally.lost,
        red=len(tally.red),
        **{word.replace(" ", "_"): count for word, count in sorted(tally.faults.items())},
        seconds=seconds,
    )
    for alike in _groups(tally.red)[:MOST_TOLD]:
        trial = alike[0].trial
        what = trial.plan if part == "replace" else f"{trial.plan}: {trial.fault}"
        more = f" (and {len(alike) - 1} alike)" if len(alike) > 1 else ""
        print(f"  --part {part} --trial {trial.number}, {what}{more}", file=sys.stderr)
        for text in alike[0].verdict.details:
            print(f"    {text}", file=sys.stderr)


def _groups(red: list[Told]) -> list[list[Told]]:
    """Trials that failed alike, the most frequent first: names and numbers make no difference."""
    groups: dict[tuple[str, ...], list[Told]] = {}
    for told in red:
        plan = told.trial.plan if told.trial.part == "replace" else ""
        plain = (
            re.sub(r"\S*/pfwd-below\S+|\d+|: (note|rebound|drop).*", "", text)
            for text in told.verdict.details
        )
        groups.setdefault((plan, *plain), []).append(told)
    return sorted(groups.values(), key=len, reverse=True)
