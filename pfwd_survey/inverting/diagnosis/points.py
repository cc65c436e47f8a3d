"""Points, each by itself: in this process or in several."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from threading import Lock
from typing import Any, TypeVar

import numpy as np

from inversion import InversionError, SurrogateLibrary
from inversion.diagnosis import (
    PointDiagnosis,
    PointRecords,
    UnknownKey,
    diagnose_point,
)
from pfwd_survey.inverting.diagnosis.entries import DiagnosisPoint
from pfwd_survey.spawning import worker_pool

# Devices that share the processes, for each of these.
_AT_ONCE = 2

_R = TypeVar("_R")
_G = TypeVar("_G")
DeviceValues = dict[str, dict[str, float]]
Found = dict[int, PointDiagnosis | str]
"""Diagnoses, or why there is none, by the identity of the point."""
Progress = Callable[[str, int, int], None]
"""Told what is being tried, how many points are done, and of how many."""


@dataclass(frozen=True)
class Look:
    """How a point is looked at, see `inversion.diagnosis.diagnose_point`.

    Parameters
    ----------
    device, spread : values of device effects that are known, and their deviations
    likely : effects that are tried first
    begun : values from which they may begin
    plain : whether every sample counts alike from the beginning
    leave_out : whether each drop is tried on the ground of the others
    brief : whether what the survey needs of it is enough
    """

    device: DeviceValues | None = None
    spread: DeviceValues | None = None
    likely: Sequence[str] = ()
    begun: Sequence[Mapping[UnknownKey, float]] = ()
    plain: bool = False
    leave_out: bool = True
    brief: bool = False


class Told:
    """Counts points for who wants to know how far it is; several devices may share one.

    Parameters
    ----------
    progress : callable or None
    what : str, what is being tried
    total : int, points that are looked at, as far as is known
    """

    def __init__(self, progress: Progress | None, what: str, total: int) -> None:
        self._progress = progress
        self._what = what
        self._done = 0
        self._lock = Lock()
        self.total = total

    def expect(self, more: int) -> None:
        """So many points more are going to be looked at."""
        with self._lock:
            self.total += more

    def counted(self, results: Iterable[PointDiagnosis | str]) -> list[PointDiagnosis | str]:
        """Results in a list."""
        found = []
        for result in results:
            found.append(result)
            with self._lock:
                self._done += 1
                if self._progress is not None:
                    self._progress(self._what, self._done, self.total)
        return found


class Workers:
    """Processes that share the work of several devices; a single one is this one.

    Parameters
    ----------
    count : int
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool: ProcessPoolExecutor | None = None
        self._waiting: ThreadPoolExecutor | None = None

    def __enter__(self) -> Workers:
        if self._count > 1:
            self._pool = worker_pool(self._count)
        return self

    def __exit__(self, *_: object) -> None:
        # What waits for the processes ends when they do.
        for pool in (self._pool, self._waiting):
            if pool is not None:
                pool.shutdown(cancel_futures=True)

    def map(self, function: Callable[..., _R], *columns: Sequence[Any]) -> Iterator[_R]:
        """What a function gives for each row, in order."""
        return map(function, *columns) if self._pool is None else self._pool.map(function, *columns)

    def at_once(self, function: Callable[[_G], _R], groups: Sequence[_G]) -> Iterator[_R]:
        """What a function that waits for these processes gives for each group, in order.

        While one group waits for its last point, the processes are another's.
        """
        if self._pool is None or len(groups) < 2:
            return map(function, groups)
        self._waiting = ThreadPoolExecutor(_AT_ONCE * self._count)
        return self._waiting.map(function, groups)


def are_plain(found: Sequence[PointDiagnosis]) -> bool:
    """Whether at most of the points every sample counted alike."""
    return 2 * sum(d.plain for d in found) > len(found)


def diagnose_all(
    work: Sequence[DiagnosisPoint], looks: Sequence[Look], workers: Workers, told: Told
) -> list[PointDiagnosis | str]:
    """Diagnoses, or why there is none, in order."""
    records = [point.records for point in work if point.records is not None]
    return told.counted(workers.map(_diagnose, records, looks)) if records else []


def _diagnose(records: PointRecords, look: Look) -> PointDiagnosis | str:
    begun = time.perf_counter()
    try:
        found = diagnose_point(
            records,
            _library(),
            look.device,
            look.likely,
            look.begun,
            look.leave_out,
            look.spread,
            plain=look.plain,
            brief=look.brief,
        )
    except InversionError as err:
        return str(err)
    except np.linalg.LinAlgError as err:
        # One odd record costs its own point, not those of all files.
        return f"the fit broke down ({err}): check the header, and the unit of the times"
    return replace(found, elapsed=time.perf_counter() - begun)


@cache
def _library() -> SurrogateLibrary:
    """Of this process."""
    return SurrogateLibrary()
