"""The fault campaign: whatever happens, no acknowledged drop is lost and every survey can be read.

A drop counts as acknowledged when ``pfwd log`` has printed its line. The logger is the real
program, the instrument a simulated one that drops its hammer several times a second.
"""

import argparse
import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.output import Reporter
from pfwd_device.errors import RecordingError
from pfwd_device.recording import check, read_survey, recover
from simulators.instrument import serve
from tests.campaigns.hasty_instrument import HASTY, RATE, hasty_instrument
from tests.campaigns.judge import ACKNOWLEDGED, judge
from tests.campaigns.replaced_files import REPLACEMENTS, impossible, trial

# Ten drops a second: every 2 s, twenty times real time, without bounces.
START = 30.0  # s that a logger may take for its first drop on a busy machine

Name = tuple[str, int]


@dataclass
class Tally:
    """What a part of the campaign found."""

    faults: int = 0
    acknowledged: int = 0
    lost: int = 0
    twice: int = 0
    unreadable: int = 0
    missed: int = 0
    """Damage that the check did not see, or a loss that was not told."""
    notes: list[str] = field(default_factory=list)

    @property
    def good(self) -> bool:
        """Nothing was lost."""
        return not (self.lost or self.twice or self.unreadable or self.missed)

    def compare(self, survey: Path, acknowledged: set[Name]) -> None:
        """Recover a survey and look for what was acknowledged."""
        try:
            recover(survey)
            names = [(drop.point, drop.drop) for drop in _read_all(survey)]
        except RecordingError as err:
            self.unreadable += 1
            self.notes.append(str(err))
            return
        self.twice += len(names) - len(set(names))
        gone = acknowledged - set(names)
        self.lost += len(gone)
        if gone:
            self.notes.append(f"{survey}: lost {sorted(gone)}")


def _read_all(survey: Path) -> list[Any]:
    drops = [*read_survey(survey).drops]
    for drop in drops:
        drop.read()
    return drops


class Logger:
    """``pfwd log`` as a process, and the drops that it acknowledges.

    Parameters
    ----------
    url : str
    survey : Path
    largest_file : int, optional
        Bytes after which the system refuses to let a file grow.
    """

    def __init__(self, url: str, survey: Path, largest_file: int | None = None) -> None:
        self.acknowledged: set[Name] = set()
        self.first = threading.Event()
        command = [
            sys.executable,
            "-m",
            "tests.campaigns.faults",
            "--logger",
            str(largest_file or 0),
        ]
        command += ["log", url, "-o", str(survey), "--no-invert", "--json"]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.errors: list[str] = []
        self._readers = [
            threading.Thread(target=self._read_lines, daemon=True),
            threading.Thread(target=self._read_errors, daemon=True),
        ]
        for reader in self._readers:
            reader.start()

    def _read_lines(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with contextlib.suppress(ValueError):  # the line that the kill cut in two
                drop = json.loads(line)
                self.acknowledged.add((drop["point"], drop["drop"]))
                self.first.set()

    def _read_errors(self) -> None:
        assert self.process.stderr is not None
        self.errors += self.process.stderr

    def kill(self) -> None:
        """SIGKILL (on Windows: the same by another name)."""
        self.process.kill()
        self.wait()

    def wait(self, timeout: float = 60.0) -> None:
        """Wait for its end and for its last words."""
        self.process.wait(timeout)
        for reader in self._readers:
            reader.join()
        for pipe in (self.process.stdout, self.process.stderr):
            if pipe is not None:
                pipe.close()


def kills(count: int, rng: np.random.Generator, folder: Path) -> Tally:
    """kill -9 at random instants, from before the first drop to some seconds after it."""
    tally = Tally()
    survey, acknowledged = folder / "killed", set[Name]()
    with hasty_instrument(int(rng.integers(2**31))) as instrument:
        for number in range(count):
            if number % 20 == 0:
                shutil.rmtree(survey, ignore_errors=True)
                acknowledged = set()
            logger = Logger(instrument.url, survey)
            # One in five dies while it starts; the others in the midst of their drops.
            if rng.random() < 0.2:
                time.sleep(float(rng.uniform(0.0, 1.0)))
            else:
                logger.first.wait(START)
                time.sleep(float(rng.uniform(0.0, 1.5)))
            logger.kill()
            acknowledged |= logger.acknowledged
            tally.acknowledged += len(logger.acknowledged)
            tally.faults += 1
            if survey.exists() and (survey / "journal").exists():
                tally.compare(survey, acknowledged)
    return tally


def record_some(folder: Path, rng: np.random.Generator, drops: int) -> tuple[Path, set[Name]]:
    """A survey that ended in order."""
    survey = folder / "whole"
    with hasty_instrument(int(rng.integers(2**31))) as instrument:
        logger = Logger(instrument.url, survey)
        while len(logger.acknowledged) < drops and logger.process.poll() is None:
            time.sleep(0.05)
        logger.process.terminate()
        logger.wait()
    return survey, logger.acknowledged


def damages(count: int, rng: np.random.Generator, folder: Path, *, cut: bool) -> Tally:
    """One file cut off, or one byte changed: seen by the check, and no drop lost."""
    tally = Tally()
    survey, acknowledged = record_some(folder, rng, 20)
    if not check(survey).ok:
        tally.notes.append("the survey was not whole to begin with")
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
                f"not seen: {victim.name} at byte {place} of {victim.stat().st_size}"
            )
        tally.compare(copy, acknowledged)
        if not check(copy).ok:
            tally.notes.append(f"not whole after recovery: {victim.name} at byte {place}")
            tally.unreadable += 1
        shutil.rmtree(copy)
    return tally


def full_disks(count: int, rng: np.random.Generator, folder: Path) -> Tally:
    """Files that may not grow any more, and a file system without space; then room again."""
    tally = Tally()
    with hasty_instrument(int(rng.integers(2**31))) as instrument:
        for number in range(count):
            small = number % 2 == 1 and _mount(folder / "small")
            survey = (folder / "small" / "survey") if small else folder / f"limited-{number}"
            limit = None if small else int(rng.integers(2_300_000, 3_000_000))
            logger = Logger(instrument.url, survey, limit)
            logger.first.wait(START)
            time.sleep(float(rng.uniform(0.5, 3.0)))
            logger.process.terminate()
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
    """A file system of a few megabytes, where the system lets one; False where it does not."""
    folder.mkdir(exist_ok=True)
    if not hasattr(os, "geteuid") or os.geteuid() != 0 or shutil.which("mount") is None:
        return False
    command = ["mount", "-t", "tmpfs", "-o", "size=9m", "pfwd", str(folder)]
    if subprocess.run(command, capture_output=True, check=False).returncode != 0:
        return False
    (folder / "ballast").write_bytes(bytes(1_000_000))
    return True


def unplugs(count: int, rng: np.random.Generator, folder: Path) -> Tally:
    """The cable pulled and put back, again and again, between drops and within them."""
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
        logger = Logger(instrument.url, survey)
        lost = 0
        deadline = time.monotonic() + 60.0 + 10.0 * count
        while lost < count and time.monotonic() < deadline:
            time.sleep(0.2)
            # Of many connections in a minute the log names only some, but every loss.
            lost = sum("INSTRUMENT LOST" in line for line in logger.errors)
            if logger.process.poll() is not None:
                break
        logger.process.terminate()
        logger.wait()
    tally.faults = lost
    tally.acknowledged = len(logger.acknowledged)
    tally.compare(survey, logger.acknowledged)
    if tally.faults < count:
        tally.notes.append(f"only {lost} of {count} losses: {logger.errors[-3:]}")
        tally.unreadable += 1
    return tally


def bit_errors(count: int, rng: np.random.Generator, folder: Path) -> Tally:
    """One byte in ten thousand flipped: whole drops as without, the others marked, none twice.

    The instrument does the same twice, over a good cable and over a bad one.
    """
    tally = Tally()
    seed = int(rng.integers(2**31))
    surveys = {}
    for rate in (0.0, 1e-4):
        surveys[rate] = folder / f"errors-{rate:g}"
        # The first drop falls when the handshake and the check of the sensors are over for certain,
        # five seconds of ours after the start.
        drops = HASTY["drops"] | {"first": 5.0 * RATE}
        scenario = {"base": "typical", "drops": drops, "link": {"bit_error_rate": rate}}
        with serve(scenario, drops=count, seed=seed, rate=RATE) as instrument:
            logger = Logger(instrument.url, surveys[rate])
            logger.wait(60.0 + count)
        tally.acknowledged += len(logger.acknowledged)
        tally.compare(surveys[rate], logger.acknowledged)
        if logger.process.returncode != 0:
            tally.unreadable += 1
            tally.notes.append(f"the logger ended with {logger.errors[-3:]}")
    good, bad = ([drop.read() for drop in _read_all(survey)] for survey in surveys.values())
    for one in good:
        same = [other for other in bad if abs(_trigger(other) - _trigger(one)) < NEAR]
        if len(same) != 1:
            tally.lost += not same
            tally.twice += len(same) > 1
            tally.notes.append(f"drop at {_trigger(one)}: {len(same)} times over the bad cable")
            continue
        (other,) = same
        gone = np.isnan(other.drop.load)
        tally.faults += bool(gone.any())
        if gone.any() != bool(other.metadata["marks"]):
            tally.missed += 1
            tally.notes.append(f"drop at {_trigger(one)}: damaged {gone.any()}, marks differ")
        if _trigger(one) == _trigger(other) and not np.array_equal(
            one.counts[~gone], other.counts[~gone]
        ):
            tally.missed += 1
            tally.notes.append(f"drop at {_trigger(one)}: wrong samples")
    return tally


def replaced_files(count: int, rng: np.random.Generator, folder: Path) -> Tally:
    """Replace, delete, move or damage files of a survey that `pfwd log` records.

    Drops may be lost only after the program has reported it.
    """
    tally = Tally()
    cannot = impossible()
    tally.notes += [f"{name}: SKIPPED: {reason}" for name, reason in cannot.items()]
    names = [name for name in REPLACEMENTS if name not in cannot]
    order = rng.permutation(len(names))
    with contextlib.ExitStack() as stack:
        seeds = rng.integers(2**31, size=2)
        one, two = (stack.enter_context(hasty_instrument(int(seed))) for seed in seeds)
        for number in range(count):
            name = names[int(order[number % len(names)])]
            place = folder / "replaced"
            place.mkdir(exist_ok=True)
            outcome = trial((one.url, two.url), place, name, rng, killed=number % 5 == 4)
            verdict = judge(outcome)
            tally.faults += 1
            tally.acknowledged += sum(said.what == ACKNOWLEDGED for said in outcome.said)
            tally.lost += "lost" in verdict.faults
            tally.twice += "twice" in verdict.faults
            tally.unreadable += "unreadable" in verdict.faults
            tally.missed += not verdict.good
            tally.notes += [f"{name}: {text}" for text in verdict.details]
    return tally


NEAR = 300  # samples: a trigger that was lost is found within the pulse, 30 ms


def _trigger(record: Any) -> int:
    return int(record.metadata["key"].rsplit("/", 1)[1])


def run(arguments: list[str]) -> int:
    """Run the whole campaign; ``--short`` for one that takes a minute or two."""
    parser = argparse.ArgumentParser(prog="pfwd bench faults")
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--part", action="append", help="only this part; may be repeated")
    args = parser.parse_args(arguments)
    report = Reporter(arguments)
    rng = np.random.default_rng(args.seed)
    parts = {
        "kill -9": (kills, 300, 10, {}),
        "truncations": (damages, 100, 12, {"cut": True}),
        "flipped bits": (damages, 100, 12, {"cut": False}),
        "full disks": (full_disks, 50, 4, {}),
        "unplugged": (unplugs, 100, 4, {}),
        "bit errors": (bit_errors, 300, 40, {}),
        "replaced files": (replaced_files, 2 * len(REPLACEMENTS), 4, {}),
    }
    for name in args.part or ():
        if name not in parts:
            parser.error(f"--part: expected one of {', '.join(parts)}, got {name}")
    good = True
    for name in args.part or parts:
        part, count, short, options = parts[name]
        with tempfile.TemporaryDirectory(prefix="pfwd-faults-") as folder:
            began = time.monotonic()
            tally = part(short if args.short else count, rng, Path(folder), **options)  # type: ignore[operator]
        report.record(
            part=name,
            faults=tally.faults,
            acknowledged=tally.acknowledged,
            lost=tally.lost,
            recorded_twice=tally.twice,
            unreadable=tally.unreadable,
            unseen=tally.missed,
            seconds=time.monotonic() - began,
        )
        for note in tally.notes[:10]:
            print(f"  {note}", file=sys.stderr)
        good &= tally.good
    return 0 if good else 1


def logger_main(largest_file: int, arguments: list[str]) -> int:
    """``pfwd`` in this process, with files that may not grow beyond so many bytes (0: any)."""
    if largest_file and sys.platform != "win32":
        import resource
        import signal

        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, largest_file))
    from tui.cli import main

    return main(arguments)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--logger"]:
        sys.exit(logger_main(int(sys.argv[2]), sys.argv[3:]))
    sys.exit(run(sys.argv[1:]))
