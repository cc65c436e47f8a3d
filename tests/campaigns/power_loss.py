"""Recording under power loss: what a disk may hold after each system call, and what is recovered.

A survey is recorded with every call to the disk noted. From the notes follow the states that a
kill at each call leaves, and states after a power cut: what was synced is there; of the rest each
sector of 512 bytes arrived or not, and of the names not synced the first few. Each state is put
on the disk, recovered and compared with what had been acknowledged.
"""

import argparse
import contextlib
import errno
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.output import Reporter
from pfwd_device import Channel, Drop
from pfwd_device.errors import RecordingError
from pfwd_device.jobs import Jobs
from pfwd_device.recording import (
    DropRecord,
    ReboundRecord,
    SurveyWriter,
    read_survey,
    recover,
)
from pfwd_device.recording.drop_file import drop_digest
from tests.campaigns.noted_disk import Disk, Fault, NotingStorage, Operation, State, put

SURVEY = "survey"


@dataclass
class Recorded:
    """A recorded run."""

    notes: list[Operation]
    digests: dict[int, str]
    """Of each drop, by survey-wide number."""
    refused: int
    """Drops that the disk did not take at once."""


def make_record(number: int, rng: np.random.Generator, samples: int = 96) -> DropRecord:
    """A small drop with three channels, a sample of them missing."""
    time = np.arange(samples) / 10_000.0
    values = rng.normal(size=(3, samples))
    values[1, samples // 2] = np.nan
    channels = (Channel(0.0, "velocity", values[1]), Channel(0.3, "velocity", values[2]))
    return DropRecord(
        point=f"P {(number - 1) // 10 + 1}",
        drop=Drop((number - 1) % 10 + 1, time, values[0], channels),
        counts=rng.integers(-(2**23), 2**23, (samples, 3), dtype=np.int32),
        declared={"plate_radius_m": 0.15},
        metadata={"key": f"7/1/{number}", "missing": [[samples // 2, 1]]},
    )


def record_run(
    folder: Path,
    drops: int,
    seed: int,
    *,
    storage_type: type[NotingStorage] = NotingStorage,
    faults: bool = True,
    publish: bool = True,
) -> Recorded:
    """Record a survey below `folder` and note every call.

    Parameters
    ----------
    faults : bool
        Now and then the disk is full, takes fewer bytes, or a sync fails.
    """
    rng = np.random.default_rng(seed)
    storage = storage_type(folder, _faults(np.random.default_rng(seed + 1)) if faults else None)
    digests: dict[int, str] = {}
    refused = 0
    writer = _persist(
        lambda: SurveyWriter.open(
            folder / SURVEY,
            storage=storage,
            publish=publish,
            jobs=Jobs(0),
            reserve_bytes=1024,
        )
    )
    with writer:
        for number in range(1, drops + 1):
            record = make_record(number, rng)
            digests[number] = drop_digest(record, 0)
            before = storage.calls
            saved = _persist(lambda record=record: writer.save_drop(record))  # type: ignore[misc]
            refused += storage.calls - before > 8
            assert saved == number
            storage.mark(number)
            if number % 5 == 0:
                rebound = ReboundRecord(0.4, 900.0, 100 * number, np.ones((4, 3), dtype=np.int32))
                _persist(lambda n=number, r=rebound: writer.save_rebound(n, r))  # type: ignore[misc]
            if publish:
                writer.publish(number)
    return Recorded(storage.notes, digests, refused)


def lost_drops(folder: Path, acknowledged: int, digests: dict[int, str]) -> list[int]:
    """Recover the survey below `folder`; numbers of acknowledged drops that are not as saved."""
    survey = folder / SURVEY
    if not acknowledged:  # there may be no survey yet, and it must be possible to begin one
        with SurveyWriter.open(survey, jobs=Jobs(0)):
            return []
    report = recover(survey, jobs=Jobs(0))
    found = {drop.number: drop for drop in read_survey(survey).drops}
    lost = []
    for number in range(1, acknowledged + 1):
        try:
            record = found[number].read()
            whole = DropRecord(
                record.point, record.drop, record.counts, record.declared, record.metadata
            )
            if drop_digest(whole, 0) != digests[number]:
                lost.append(number)
        except Exception:
            lost.append(number)
    if not lost and not report.ok:
        raise RecordingError(f"nothing is lost, and recovery says {report.damaged}")
    return lost


@dataclass(frozen=True)
class Outcome:
    """What a series of states came to."""

    states: int
    losing: int
    """States after which an acknowledged drop was gone or changed."""
    unreadable: int
    """States at which recovery or reading failed."""


def replay_kills(run: Recorded, every: int = 1, first: int = 0) -> Outcome:
    """A kill at every, or every n-th, call."""
    states = losing = unreadable = 0
    for index, acknowledged, disk in follow(run.notes):
        if index % every != first % every:
            continue
        lost = _judge(disk.killed(), acknowledged, run)
        states += 1
        losing += bool(lost)
        unreadable += lost is None
    return Outcome(states, losing, unreadable)


def replay_power_cuts(run: Recorded, cuts: int, seed: int) -> Outcome:
    """Power cuts at random calls."""
    rng = np.random.default_rng(seed)
    if not run.notes:  # the disk took nothing at all
        return Outcome(0, 0, 0)
    chosen = np.sort(rng.integers(0, len(run.notes), cuts)).tolist()
    losing = unreadable = 0
    for index, acknowledged, disk in follow(run.notes):
        for _ in range(chosen.count(index)):
            lost = _judge(disk.power_cut(rng), acknowledged, run)
            losing += bool(lost)
            unreadable += lost is None
    return Outcome(cuts, losing, unreadable)


def campaign(
    drops: int,
    power_losses: int,
    seed: int,
    report: Callable[..., None],
    *,
    every: int = 1,
    storage_type: type[NotingStorage] = NotingStorage,
    faults: bool = True,
) -> bool:
    """Whether no state loses an acknowledged drop; each series is reported.

    Parameters
    ----------
    report : called with the figures of each series as keywords
    every : int
        Kill at every n-th call only.
    """
    with _scratch() as folder:
        run = record_run(folder, drops, seed, storage_type=storage_type, faults=faults)
    kills = replay_kills(run, every, seed)
    report(what="kill", calls=len(run.notes), **vars(kills))
    cuts = replay_power_cuts(run, power_losses, seed)
    report(what="power loss", calls=len(run.notes), **vars(cuts))
    return not (kills.losing or kills.unreadable or cuts.losing or cuts.unreadable)


def run(arguments: list[str]) -> int:
    """The whole campaign; 1 when anything was lost."""
    parser = argparse.ArgumentParser(prog="pfwd bench power_loss")
    parser.add_argument("--drops", type=int, default=40)
    parser.add_argument("--power-losses", type=int, default=200)
    parser.add_argument("--every", type=int, default=1, help="kill at every n-th call only")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    report = Reporter(arguments)
    report.title("acknowledged drops after a kill at every call and after power loss")
    whole = campaign(
        options.drops, options.power_losses, options.seed, report.record, every=options.every
    )
    return 0 if whole else 1


def follow(notes: list[Operation], before: State | None = None) -> Iterator[tuple[int, int, Disk]]:
    """Number of each call, the last drop acknowledged by then, and the disk after it."""
    disk = Disk(before)
    acknowledged = 0
    for index, note in enumerate(notes):
        disk.follow(note)
        if note[0] == "acknowledged":
            acknowledged = note[1]
        yield index, acknowledged, disk


def _judge(state: State, acknowledged: int, run: Recorded) -> list[int] | None:
    """Lost drops, or None when the state cannot be read."""
    with _scratch() as folder:
        put(state, folder)
        try:
            return lost_drops(folder, acknowledged, run.digests)
        except Exception:
            return None


@contextlib.contextmanager
def _scratch() -> Iterator[Path]:
    """A folder in memory where there is one: thousands of states are written."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as folder:
        yield Path(folder).resolve()


def _persist(action: Callable[[], Any]) -> Any:
    """Do it again until the disk takes it, as an operator would who frees some space."""
    for _ in range(20):
        try:
            return action()
        except OSError:
            continue
        except Exception as err:
            if "disk" not in str(err):
                raise
    return action()


def _faults(rng: np.random.Generator) -> Fault:
    kinds: dict[str, list[OSError | int]] = {
        "write": [OSError(errno.ENOSPC, "no space"), 7, 100],
        "sync": [OSError(errno.EIO, "input/output error")],
        "truncate": [OSError(errno.EIO, "input/output error")],
    }

    def fault(call: str, number: int) -> OSError | int | None:
        if call not in kinds or number < 60 or rng.random() > 0.06:
            return None
        choice = kinds[call][rng.integers(len(kinds[call]))]
        return OSError(*choice.args) if isinstance(choice, OSError) else choice

    return fault
