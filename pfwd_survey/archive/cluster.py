"""Workers of an existing dask cluster; needs the package ``distributed`` (extra ``cluster``)."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from importlib import import_module
from typing import TYPE_CHECKING, Any

from pfwd_survey.archive.identity import software_version
from pfwd_survey.archive.work import SourceOutcome, invert_batch
from pfwd_survey.archive.workers import Batch
from pfwd_survey.errors import OptionError, SurveyError, refusal

if TYPE_CHECKING:
    from pfwd_survey.inverting.options import AnalysisOptions

_CONNECT_S = 20.0
_FIRST_WORKER_S = 60.0
"""s to wait for the first worker; a cluster may start them when they are asked for."""

_AHEAD = 2
"""Batches under way for each thread of the cluster: one is worked on, one lies ready."""


class ClusterWorkers:
    """A cluster that inverts batches; what a lost worker had is done again by another one.

    Its workers have to run the same version of this program and see the sources under the same
    paths. One thread a worker is best: inverting holds Python's lock half of the time.

    Parameters
    ----------
    options : AnalysisOptions
    scheduler : str
        Address, as ``tcp://host:8786``.

    Raises
    ------
    OptionError
        If ``distributed`` is not installed, or the address is none.
    SurveyError
        If there is no scheduler, no worker, or workers have another version of this program.
    """

    def __init__(self, options: AnalysisOptions, scheduler: str) -> None:
        try:
            distributed: Any = import_module("distributed")
        except ImportError as err:
            hint = 'python -m pip install "pfwd[cluster]", or --jobs N without a cluster'
            raise OptionError(
                refusal("--scheduler", "the package distributed", "none", hint)
            ) from err
        self._options = options
        self._where = f"--scheduler {scheduler}"
        try:
            self._client: Any = distributed.Client(
                scheduler, timeout=_CONNECT_S, set_as_default=False
            )
        except ValueError as err:
            expected = "an address like tcp://host:8786"
            raise OptionError(refusal(self._where, expected, str(err))) from err
        except (OSError, TimeoutError) as err:
            hint = "is it running, and can it be reached from here?"
            raise SurveyError(refusal(self._where, "a scheduler", "no answer", hint)) from err
        try:
            self._check_workers()
        except BaseException:
            self.close()
            raise

    def run(self, batches: Iterator[Batch]) -> Iterator[list[SourceOutcome]]:
        """See :class:`~pfwd_survey.archive.workers.Workers`.

        Raises
        ------
        SurveyError
            If the cluster is lost.
        """
        distributed: Any = import_module("distributed")
        waiting: list[Batch] = []
        under_way: dict[Any, Batch] = {}
        more = True
        try:
            while True:
                while waiting or (more and len(under_way) < self._most()):
                    batch = waiting.pop() if waiting else next(batches, None)
                    if batch is None:
                        more = False
                        continue
                    future = self._client.submit(
                        invert_batch, list(batch.sources), self._options, pure=False
                    )
                    under_way[future] = batch
                if not under_way:
                    return
                with self._client.as_current():
                    done = distributed.wait(list(under_way), return_when="FIRST_COMPLETED").done
                for future in done:
                    batch = under_way.pop(future)
                    if future.status == "finished":
                        outcomes: list[SourceOutcome] = future.result()
                        yield outcomes
                        continue
                    if future.status != "error":
                        raise self._lost(f"a task that is {future.status}")
                    error = future.exception()
                    if not isinstance(error, distributed.scheduler.KilledWorker):
                        raise self._lost(f"{type(error).__name__}: {error}")
                    again = batch.after_a_death()
                    waiting += again
                    if not again:
                        yield batch.given_up()
        except (OSError, TimeoutError, distributed.CancelledError) as err:
            raise self._lost(str(err) or type(err).__name__) from err

    def close(self) -> None:
        """Leave the cluster; what it still works on is forgotten there."""
        # A cluster that has gone cannot be left in good order.
        with contextlib.suppress(Exception):
            self._client.close(timeout=5.0)

    def _most(self) -> int:
        """Batches to have under way; asked anew, because clusters grow."""
        threads: int = sum(self._client.nthreads().values())
        return _AHEAD * max(1, threads)

    def _check_workers(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=_FIRST_WORKER_S)
        except TimeoutError as err:
            came = f"none within {_FIRST_WORKER_S:.0f} s"
            raise SurveyError(refusal(self._where, "a worker", came)) from err
        hint = "install the same one everywhere"
        ours = software_version()
        try:
            versions = self._client.run(software_version)
        except Exception as err:
            expected = f"workers with pfwd {ours}"
            raise SurveyError(refusal(self._where, expected, str(err), hint)) from err
        for worker, version in versions.items():
            if version != ours:
                came = f"{version} on {worker}"
                raise SurveyError(refusal(self._where, f"pfwd {ours} on all", came, hint))

    def _lost(self, came: str) -> SurveyError:
        hint = "the same command goes on where this one ended"
        return SurveyError(refusal(self._where, "a cluster that answers", came, hint))
