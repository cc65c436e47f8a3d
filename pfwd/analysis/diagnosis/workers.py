"""Processes that diagnose points, and the report of their progress."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

from inversion.forward.library import default_cache_folder
from pfwd.analysis.result_store import software_name
from pfwd.jobs import Jobs

# Number of devices that are diagnosed at the same time, for each process.
_AT_ONCE = 2

_R = TypeVar("_R")
_G = TypeVar("_G")
Progress = Callable[[str, str, int, int], None]
"""Function that receives the kind of work, the name of the point in work (empty: none is left), the
number of points done, and their total number."""


class ProgressCounter:
    """Thread-safe counter of diagnosed points, shared by the devices of a survey.

    Parameters
    ----------
    progress : callable or None
        Receives every report.
    kind : str
        Kind of work, in words for the user.
    total : int
        Number of points to be diagnosed, as far as is known.
    """

    def __init__(self, progress: Progress | None, kind: str, total: int) -> None:
        self._progress = progress
        self._kind = kind
        self._count = 0
        self._lock = Lock()
        self.total = total

    def expect(self, more: int) -> None:
        """Increase the total number of points to be diagnosed."""
        with self._lock:
            self.total += more

    def counted(self, names: Sequence[str], results: Iterable[_R]) -> Iterator[_R]:
        """Yield the results of points, with a report before each point and after the last one.

        Parameters
        ----------
        names : sequence of str
            Names of the points, in the order of the results.
        results : iterable
            Computes each result when it is requested.
        """
        pending = iter(results)
        for name in names:
            self._report(name)
            result = next(pending)
            with self._lock:
                self._count += 1
            yield result
        self._report("")

    def _report(self, name: str) -> None:
        with self._lock:
            if self._progress is not None:
                self._progress(self._kind, name, self._count, self.total)


class Workers:
    """Processes that share the work on several devices.

    With a count of 1 all work is done in the calling process.

    Parameters
    ----------
    count : int
        Number of processes.
    requests : mapping, optional
        Identifiers of the requests by `DiagnosisPoint.name`. The diagnosis of each point is stored
        in the cache as soon as it is finished, so that an interrupted run can be continued. It is
        that of one step of the request and not the answer.
    """

    def __init__(self, count: int, requests: Mapping[str, str] | None = None) -> None:
        self._count = count
        self._requests = requests or {}
        self._files: set[Path] = set()
        self._jobs = Jobs(count if count > 1 else 0)
        self._waiting: ThreadPoolExecutor | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *error: Any) -> None:
        self._jobs.close()
        # Threads that wait for a process have ended with it.
        if self._waiting is not None:
            self._waiting.shutdown()

    def file_of(self, name: str, step: str) -> Path | None:
        """Return the file for the diagnosis of a point in a step of its request; None: no file."""
        if name not in self._requests:
            return None
        # Points with the same samples have the same request, and different numbers of drops.
        key = repr((self._requests[name], name, step, software_name()))
        folder = default_cache_folder() / "diagnoses"
        self._files.add(file := folder / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.pickle")
        return file

    def forget(self) -> None:
        """Remove the files of diagnoses, when all requests are complete."""
        for file in self._files:
            with contextlib.suppress(OSError):
                file.unlink()

    def map(self, function: Callable[..., _R], *columns: Sequence[Any]) -> Iterator[_R]:
        """Yield the results of a function for rows of the columns, in order."""
        return self._jobs.map(function, *columns)

    def at_once(self, function: Callable[[_G], _R], groups: Sequence[_G]) -> Iterator[_R]:
        """Yield the results of a function for groups of points, in order.

        The function runs in a thread and waits for the processes. While one group waits for its
        last point, the processes work on another one.
        """
        if self._jobs.count == 0 or len(groups) < 2:
            return map(function, groups)
        self._waiting = ThreadPoolExecutor(_AT_ONCE * self._count)
        return self._waiting.map(function, groups)
