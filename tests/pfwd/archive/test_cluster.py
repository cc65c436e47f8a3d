"""The same work on a dask cluster, here one on this machine."""

import contextlib
import re
import socket
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import psutil
import pytest

from pfwd.archive import cluster
from pfwd.archive import run as running
from pfwd.archive.cluster import ClusterWorkers, check_address
from pfwd.archive.run import Summary, invert_archive, invert_stream
from pfwd.archive.work import ArchiveWorkers, SourceFailure
from pfwd.errors import OptionError, SurveyError

pytest.importorskip("pyarrow")
from tests.pfwd.archive.stand_ins import OPTIONS, facts


@pytest.fixture(scope="module")
def dask_cluster() -> Iterator[Any]:
    """Two workers with a thread each."""
    distributed = pytest.importorskip("distributed", reason="the extra cluster is not installed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0", processes=True
    ) as local:
        yield local


def test_a_cluster_has_the_results_of_processes(
    dask_cluster: Any, drops: Path, tmp_path: Path
) -> None:
    with contextlib.closing(ClusterWorkers(OPTIONS, dask_cluster.scheduler_address)) as workers:
        summary = invert_archive([str(drops)], tmp_path / "there", workers)
    assert (summary.drops, summary.failed_in_all) == (12, 0)
    with contextlib.closing(ArchiveWorkers(OPTIONS)) as workers:
        invert_archive([str(drops)], tmp_path / "here", workers)
    assert facts(tmp_path / "there") == facts(tmp_path / "here")


def test_the_work_of_a_killed_cluster_worker_is_repeated(
    dask_cluster: Any, drops: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running, "BATCH_SOURCES", 1)
    killed = []

    def tell(summary: Summary, failures: Sequence[SourceFailure]) -> None:
        if not killed:
            killed.append(next(iter(dask_cluster.workers.values())).process.process.pid)
            psutil.Process(killed[0]).kill()

    with contextlib.closing(ClusterWorkers(OPTIONS, dask_cluster.scheduler_address)) as workers:
        summary = invert_archive([str(drops)], tmp_path / "out", workers, tell)
    assert killed
    assert (summary.drops, summary.failed_in_all) == (12, 0)
    assert len(facts(tmp_path / "out")) == 12


def test_workers_with_another_version_are_refused(
    dask_cluster: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    versions = iter(["9.9"])
    real = cluster.software_version
    monkeypatch.setattr(cluster, "software_version", lambda: next(versions, real()))
    with pytest.raises(SurveyError, match=r"expected pfwd 9\.9 on all, got"):
        ClusterWorkers(OPTIONS, dask_cluster.scheduler_address)


def test_a_cluster_that_ends_is_an_error_with_a_remedy(
    drops: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # So long the client looks whether it comes back.
    monkeypatch.setattr(cluster, "_CONNECT_TIMEOUT_S", 2.0)
    distributed = pytest.importorskip("distributed", reason="the extra cluster is not installed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=":0", processes=True
    ) as local:
        workers = ClusterWorkers(OPTIONS, local.scheduler_address)
        outcomes = invert_stream([str(drops)], workers)
    with (
        contextlib.closing(workers),
        pytest.raises(SurveyError, match="repeat the command: it continues where this one ended"),
    ):
        list(outcomes)


def test_a_missing_scheduler_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="the extra cluster is not installed")
    monkeypatch.setattr(cluster, "_CONNECT_TIMEOUT_S", 1.0)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        with pytest.raises(SurveyError, match=f"{address}: expected a scheduler, got no answer"):
            ClusterWorkers(OPTIONS, address)


@pytest.mark.parametrize(
    "address",
    [
        *("nonsense", "nonsense.invalid:8786", "foo://127.0.0.1:8786", "tcp://", "tcp://:1"),
        *("nowhere://x", "tcp://127.0.0.1:99999"),
    ],
)
def test_a_wrong_address_is_refused_at_once(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="the extra cluster is not installed")

    def refuse(*_: object, **_more: object) -> None:
        raise AssertionError("no client is made, for it would try for most of a minute")

    monkeypatch.setattr("distributed.Client", refuse)
    message = "(expected an address like tcp://host:8786|host nonsense.invalid: not found)"
    with pytest.raises(OptionError, match=f"^--scheduler {re.escape(address)}: {message}"):
        ClusterWorkers(OPTIONS, address)


@pytest.mark.parametrize(
    "address", ["127.0.0.1:8786", "tcp://localhost:1", "tls://[::1]:8786", "inproc://x/1/1"]
)
def test_addresses_of_dask_are_accepted(address: str) -> None:
    check_address(address)


def test_without_distributed_the_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(
        OptionError, match=r'package distributed, got none; .* install "pfwd\[cluster\]"'
    ):
        ClusterWorkers(OPTIONS, "tcp://127.0.0.1:8786")
