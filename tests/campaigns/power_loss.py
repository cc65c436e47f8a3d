"""Recording under kills and power loss: recovery from the possible contents of a disk.

A survey is recorded on a disk that notes every call. The notes give the contents after a kill at
each call, and after a power cut: all that was synced, some unsynced sectors of 512 bytes, and the
first unsynced names. Each content is recovered and compared with the acknowledged drops.
"""

import contextlib
import errno
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.output import parse_options
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
    """Recorded run."""

    notes: list[Operation]
    digests: dict[int, str]
    """Digest of each drop, by its number in the survey."""
    refused: int
    """Number of drops that were not written in the first attempt."""


def make_record(number: int, rng: np.random.Generator, samples: int = 96) -> DropRecord:
    """Return a small drop with three channels and a missing sample."""
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
        True: the disk is full at random calls, writes fewer bytes, or a sync fails.
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
    """Recover the survey below `folder` and return the numbers of lost or changed drops."""
    survey = folder / SURVEY
    if not acknowledged:  # a survey that may be absent must open
        with SurveyWriter.open(survey, jobs=Jobs(0)):
            return []
    report = recover(survey, jobs=Jobs(0))
    drops = {drop.number: drop for drop in read_survey(survey).drops}
    lost = []
    for number in range(1, acknowledged + 1):
        try:
            record = drops[number].read()
            saved = DropRecord(
                record.point, record.drop, record.counts, record.declared, record.metadata
            )
            if drop_digest(saved, 0) != digests[number]:
                lost.append(number)
        except Exception:
            lost.append(number)
    if not lost and not report.ok:
        raise RecordingError(f"no drop is lost, but recovery reports {report.damaged}")
    return lost


@dataclass(frozen=True)
class Outcome:
    """Results of a series of states."""

    states: int
    losing: int
    """Number of states in which an acknowledged drop is lost or changed."""
    unreadable: int
    """Number of states in which recovery or reading failed."""


def replay_kills(run: Recorded, every: int = 1, first: int = 0) -> Outcome:
    """Recover after a kill at every n-th call."""
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
    """Recover after power cuts at random calls."""
    rng = np.random.default_rng(seed)
    if not run.notes:  # every call failed
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
    """Return True if no state loses an acknowledged drop, and report each series.

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
    """Run the campaign; return 1 if a drop was lost."""
    options, report = parse_options(
        "power_loss",
        __doc__,
        arguments,
        drops=(40, "number of drops"),
        power_losses=(200, "number of power cuts"),
        every=(1, "kill at every n-th call only"),
        seed=(0, "random seed"),
    )
    report.title("acknowledged drops after a kill at every call and after power loss")
    is_complete = campaign(
        options.drops, options.power_losses, options.seed, report.record, every=options.every
    )
    return 0 if is_complete else 1


def follow(notes: list[Operation], before: State | None = None) -> Iterator[tuple[int, int, Disk]]:
    """Yield the number of each call, the last acknowledged drop, and the disk after the call."""
    disk = Disk(before)
    acknowledged = 0
    for index, note in enumerate(notes):
        disk.follow(note)
        if note[0] == "acknowledged":
            acknowledged = note[1]
        yield index, acknowledged, disk


def _judge(state: State, acknowledged: int, run: Recorded) -> list[int] | None:
    """Return the lost drops; None: the state cannot be read."""
    with _scratch() as folder:
        put(state, folder)
        try:
            return lost_drops(folder, acknowledged, run.digests)
        except Exception:
            return None


@contextlib.contextmanager
def _scratch() -> Iterator[Path]:
    """Yield a folder, in memory if possible, because thousands of states are written."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as folder:
        yield Path(folder).resolve()


def _persist(action: Callable[[], Any]) -> Any:
    """Repeat an action until the disk accepts it, as after an operator has freed space."""
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
