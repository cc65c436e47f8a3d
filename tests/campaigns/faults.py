"""The fault campaign: no acknowledged drop is lost and every survey is readable after faults.

A drop counts as acknowledged when ``pfwd log`` has printed its line. The logger is the real
program, the instrument a simulated one that drops its hammer several times a second.
"""

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.output import parse_options
from pfwd_device.errors import RecordingError
from pfwd_device.recording import check, recover
from simulators.instrument import SimulatedInstrument, serve
from tests.campaigns.judge import ACKNOWLEDGED, judge
from tests.campaigns.log_process import Command, drop_names, log_command
from tests.campaigns.replaced_files import REPLACEMENTS, impossible, trial

HASTY: dict[str, Any] = {
    "base": "default",
    "drops": {"interval": 2.0, "bounces": [0, 0], "jitter": 0.1, "first": 1.0},
}
RATE = 20.0
"""Speed of the instrument relative to real time; it makes ten drops a second."""
START_S = 30.0
"""Time of a logger for its first drop on a busy machine, s."""


@dataclass
class Tally:
    """Results of a part of the campaign."""

    faults: int = 0
    acknowledged: int = 0
    lost: int = 0
    twice: int = 0
    unreadable: int = 0
    missed: int = 0
    """Damage that the check did not detect, and losses without a warning."""
    notes: list[str] = field(default_factory=list)

    @property
    def good(self) -> bool:
        """True if no drop was lost, repeated or unreadable."""
        return not (self.lost or self.twice or self.unreadable or self.missed)

    def compare(self, survey: Path, acknowledged: set[str]) -> None:
        """Recover a survey and count the acknowledged drops that are not in it."""
        try:
            recover(survey)
            names = drop_names(survey)
        except RecordingError as err:
            self.unreadable += 1
            self.notes.append(str(err))
            return
        self.twice += len(names) - len(set(names))
        lost = acknowledged - set(names)
        self.lost += len(lost)
        if lost:
            self.notes.append(f"{survey}: lost {sorted(lost)}")


@contextlib.contextmanager
def hasty_instrument(seed: int) -> Iterator[SimulatedInstrument]:
    """Serve an instrument that makes drops without end."""
    with serve(HASTY, seed=seed, rate=RATE, listen="tcp://127.0.0.1:0") as instrument:
        yield instrument


def kills(count: int, rng: np.random.Generator, folder: Path) -> Tally:
    """Kill the logger at random times, from before the first drop to some seconds after it."""
    tally = Tally()
    survey, acknowledged = folder / "killed", set[str]()
    with hasty_instrument(int(rng.integers(2**31))) as instrument:
        for number in range(count):
            if number % 20 == 0:
                shutil.rmtree(survey, ignore_errors=True)
                acknowledged = set()
            logger = Command(log_command(instrument.url, survey))
            # A fifth is killed at the start, the others between their drops.
            if rng.random() < 0.2:
                time.sleep(float(rng.uniform(0.0, 1.0)))
            else:
                logger.wait_for(1, START_S)
                time.sleep(float(rng.uniform(0.0, 1.5)))
            logger.kill()
            logger.wait()
            acknowledged |= logger.acknowledged
            tally.acknowledged += len(logger.acknowledged)
            tally.faults += 1
            if survey.exists() and (survey / "journal").exists():
                tally.compare(survey, acknowledged)
    return tally


def record_survey(folder: Path, rng: np.random.Generator, drops: int) -> tuple[Path, set[str]]:
    """Return a survey that ended regularly, and its acknowledged drops."""
    survey = folder / "complete"
    with hasty_instrument(int(rng.integers(2**31))) as instrument:
        logger = Command(log_command(instrument.url, survey))
        logger.wait_for(drops, START_S + drops)
        logger.stop()
        logger.wait()
    return survey, logger.acknowledged


def damages(count: int, rng: np.random.Generator, folder: Path, *, cut: bool) -> Tally:
    """Cut a file or change a byte: the check detects it and names what is lost, never a drop."""
    tally = Tally()
    survey, acknowledged = record_survey(folder, rng, 20)
    if not check(survey).ok:
        tally.notes.append("the survey was incomplete before")
        tally.unreadable += 1
    kinds = ("journal/*", "acknowledged.txt", "drops/*.h5")
    files = [sorted(survey.glob(kind)) for kind in kinds]
    for number in range(count):
        copy = folder / "damaged"
        shutil.copytree(survey, copy)
        choices = files[number % len(files)]
        victim = copy / choices[int(rng.integers(len(choices)))].relative_to(survey)
        data = bytearray(victim.read_bytes())
        place = int(rng.integers(len(data)))
        if cut:
            data = data[:place]
        else:
            data[place] ^= 1 << int(rng.integers(8))
        victim.write_bytes(data)
        tally.faults += 1
        tally.acknowledged += len(acknowledged)
        if check(copy).ok:
            tally.missed += 1
            tally.notes.append(
                f"undetected: {victim.name} at byte {place} of {victim.stat().st_size}"
            )
        tally.compare(copy, acknowledged)
        # A cut journal loses events and edits that no file of a drop has; the check names them.
        if left := [text for text in check(copy).damaged if not text.endswith(" is lost")]:
            tally.notes.append(f"damaged after recovery: {victim.name} at byte {place}: {left[0]}")
            tally.unreadable += 1
        shutil.rmtree(copy)
    return tally


def full_disks(count: int, rng: np.random.Generator, folder: Path) -> Tally:
    """Limit the size of files or of the file system, then free space."""
    tally = Tally()
    with hasty_instrument(int(rng.integers(2**31))) as instrument:
        for number in range(count):
            small = number % 2 == 1 and _mount(folder / "small")
            survey = (folder / "small" / "survey") if small else folder / f"limited-{number}"
            limit = None if small else int(rng.integers(2_300_000, 3_000_000))
            logger = Command(log_command(instrument.url, survey), largest_file=limit)
            logger.wait_for(1, START_S)
            time.sleep(float(rng.uniform(0.5, 3.0)))
            logger.stop()
            logger.wait()
            tally.faults += 1
            tally.acknowledged += len(logger.acknowledged)
            if small:
                (folder / "small" / "ballast").unlink(missing_ok=True)
            tally.compare(survey, logger.acknowledged)
            if small:
                subprocess.run(["umount", str(folder / "small")], check=True)
            else:
                shutil.rmtree(survey, ignore_errors=True)
    return tally


def _mount(folder: Path) -> bool:
    """Mount a file system of a few megabytes; return False if that is not permitted."""
    folder.mkdir(exist_ok=True)
    if not hasattr(os, "geteuid") or os.geteuid() != 0 or shutil.which("mount") is None:
        return False
    command = ["mount", "-t", "tmpfs", "-o", "size=9m", "pfwd", str(folder)]
    if subprocess.run(command, capture_output=True, check=False).returncode != 0:
        return False
    (folder / "ballast").write_bytes(bytes(1_000_000))
    return True


def unplugs(count: int, rng: np.random.Generator, folder: Path) -> Tally:
    """Unplug the cable repeatedly, between drops and within them."""
    tally = Tally()
    every = 6.0
    faults = [
        {
            "kind": "unplug",
            "at_s": every * (n + 1) + float(rng.uniform(0.0, every / 2)),
            "seconds": float(rng.uniform(0.5, 2.0)),
            "powered": bool(rng.random() < 0.5),
        }
        for n in range(count)
    ]
    survey = folder / "unplugged"
    scenario = HASTY | {"faults": faults}
    with serve(scenario, seed=1, rate=4.0, listen="tcp://127.0.0.1:0") as instrument:
        logger = Command(log_command(instrument.url, survey))
        lost = 0
        deadline = time.monotonic() + 60.0 + 10.0 * count
        while lost < count and time.monotonic() < deadline:
            time.sleep(0.2)
            # The log names only some of many connections in a minute, but every loss.
            lost = sum("INSTRUMENT LOST" in line for line in list(logger.lines))
            if not logger.running:
                break
        logger.stop()
        logger.wait()
    tally.faults = lost
    tally.acknowledged = len(logger.acknowledged)
    tally.compare(survey, logger.acknowledged)
    if tally.faults < count:
        tally.notes.append(f"only {lost} of {count} losses: {logger.lines[-3:]}")
        tally.unreadable += 1
    return tally


def replaced_files(count: int, rng: np.random.Generator, folder: Path) -> Tally:
    """Replace, delete, move or damage files of a survey that `pfwd log` records.

    Drops may be lost only after the program has reported it.
    """
    tally = Tally()
    skipped = impossible()
    tally.notes += [f"{name}: SKIPPED: {reason}" for name, reason in skipped.items()]
    names = [name for name in REPLACEMENTS if name not in skipped]
    order = rng.permutation(len(names))
    with contextlib.ExitStack() as stack:
        seeds = rng.integers(2**31, size=2)
        instruments = [stack.enter_context(hasty_instrument(int(seed))) for seed in seeds]
        urls = instruments[0].url, instruments[1].url
        for number in range(count):
            name = names[int(order[number % len(names)])]
            place = folder / "replaced"
            place.mkdir(exist_ok=True)
            outcome = trial(urls, place, name, rng, killed=number % 5 == 4)
            verdict = judge(outcome)
            tally.faults += 1
            tally.acknowledged += sum(e.kind == ACKNOWLEDGED for e in outcome.events)
            tally.lost += "lost" in verdict.faults
            tally.twice += "twice" in verdict.faults
            tally.unreadable += "unreadable" in verdict.faults
            tally.missed += not verdict.good
            tally.notes += [f"{name}: {text}" for text in verdict.details]
    return tally


def run(arguments: list[str]) -> int:
    """Run the whole campaign; ``--short`` for one that takes a minute or two."""
    options, report = parse_options(
        "faults",
        __doc__,
        arguments,
        short=(False, "a minute or two"),
        seed=(0, "random seed"),
        part=("", "only these parts, by comma"),
    )
    rng = np.random.default_rng(options.seed)
    parts = {
        "kill -9": (kills, 300, 10, {}),
        "truncations": (damages, 100, 12, {"cut": True}),
        "flipped bits": (damages, 100, 12, {"cut": False}),
        "full disks": (full_disks, 50, 4, {}),
        "unplugged": (unplugs, 100, 4, {}),
        "replaced files": (replaced_files, 2 * len(REPLACEMENTS), 4, {}),
    }
    chosen = options.part.split(",") if options.part else list(parts)
    if unknown := set(chosen) - parts.keys():
        print(f"pfwd bench faults: no part {', '.join(sorted(unknown))}", file=sys.stderr)
        return 2
    good = True
    for name in chosen:
        part, count, short_count, keywords = parts[name]
        with tempfile.TemporaryDirectory(prefix="pfwd-faults-") as folder:
            start = time.monotonic()
            tally = part(short_count if options.short else count, rng, Path(folder), **keywords)  # type: ignore[operator]
        report.record(
            part=name,
            faults=tally.faults,
            acknowledged=tally.acknowledged,
            lost=tally.lost,
            recorded_twice=tally.twice,
            unreadable=tally.unreadable,
            unseen=tally.missed,
            seconds=time.monotonic() - start,
        )
        for note in tally.notes[:10]:
            print(f"  {note}", file=sys.stderr)
        good &= tally.good
    return 0 if good else 1
