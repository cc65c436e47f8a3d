"""The same work on a dask cluster, here one on this machine."""

import contextlib
import os
import re
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import psutil
import pytest

from pfwd.archive import cluster
from pfwd.archive import run as running
from pfwd.archive.cluster import ClusterWorkers, check_address, protection_warning
from pfwd.archive.run import Summary, invert_archive, invert_stream
from pfwd.archive.work import SourceFailure
from pfwd.errors import OptionError, SurveyError

pytest.importorskip("pyarrow")
from tests.pfwd.archive.stand_ins import OPTIONS, LocalWorkers, facts
from tests.records import known
from tui.cli import main

distributed: Any = pytest.importorskip("distributed", reason="the extra cluster is not installed")
dask: Any = pytest.importorskip("dask", reason="the extra cluster is not installed")


def local_cluster(workers: int = 1, **options: Any) -> Any:
    """A cluster on this machine whose workers have a thread each."""
    return distributed.LocalCluster(
        n_workers=workers, threads_per_worker=1, dashboard_address=":0", **options
    )


@pytest.fixture(scope="module")
def dask_cluster() -> Iterator[Any]:
    with local_cluster(2) as local:
        yield local


def test_a_cluster_has_the_results_of_processes(
    dask_cluster: Any, drops: Path, tmp_path: Path
) -> None:
    with contextlib.closing(ClusterWorkers(OPTIONS, dask_cluster.scheduler_address)) as workers:
        summary = invert_archive([str(drops)], tmp_path / "there", workers)
    assert (summary.drops, summary.failed_in_all) == (12, 0)
    invert_archive([str(drops)], tmp_path / "here", LocalWorkers())
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
    with local_cluster(processes=False, protocol="tcp://") as local:
        workers = ClusterWorkers(OPTIONS, local.scheduler_address)
        outcomes = invert_stream([str(drops)], workers)
    with (
        contextlib.closing(workers),
        pytest.raises(SurveyError, match="repeat the command: it continues where this one ended"),
    ):
        list(outcomes)


def test_a_missing_scheduler_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
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


# Certificates, and the warning about clusters without.

TOP = Path(__file__).resolve().parents[3]
METHOD = ("--method", "posterior", "--sensors", "centre", "--bedrock-depth", "1.2")
NAME = "DASK_DISTRIBUTED__COMM__TLS__"


def certificates(folder: Path) -> tuple[Any, dict[str, str]]:
    """Return new certificates for a cluster, and the settings that point dask to their files."""
    pytest.importorskip("cryptography", reason="it makes the certificates")
    made = distributed.Security.temporary()
    folder.mkdir()
    (folder / "certificate.pem").write_text(made.tls_ca_file)
    (folder / "key.pem").write_text(made.tls_client_key)
    return made, {
        "distributed.comm.tls.ca-file": str(folder / "certificate.pem"),
        "distributed.comm.tls.client.cert": str(folder / "certificate.pem"),
        "distributed.comm.tls.client.key": str(folder / "key.pem"),
    }


@pytest.fixture(scope="module")
def protected(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[tuple[str, dict[str, str], dict[str, str]]]:
    """Address of a cluster, the settings that it believes, and others."""
    folder = tmp_path_factory.mktemp("certificates")
    security, right = certificates(folder / "right")
    _, wrong = certificates(folder / "wrong")
    with local_cluster(processes=False, protocol="tls://", security=security) as local:
        assert local.scheduler_address.startswith("tls://")
        yield local.scheduler_address, right, wrong


Protected = tuple[str, dict[str, str], dict[str, str]]


def test_the_command_takes_them_from_its_environment(protected: Protected, drops: Path) -> None:
    address, right, _ = protected
    names = dict(zip(right, ("CA_FILE", "CLIENT__CERT", "CLIENT__KEY"), strict=True))
    environment = {NAME + names[key]: value for key, value in right.items()}
    result = subprocess.run(
        [
            sys.executable, "-c", "import sys; from tui.cli import main; sys.exit(main())",
            "invert", str(drops), "--scheduler", address, "--json", *METHOD,
        ],
        cwd=TOP, env={**os.environ, **environment}, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert len(result.stdout.splitlines()) == 12
    assert result.stderr == ""


def test_wrong_certificates_are_rejected(protected: Protected) -> None:
    address, _, wrong = protected
    with (
        dask.config.set(wrong),
        pytest.raises(SurveyError, match=r"whose certificate fits, got .*; see distributed\.comm"),
    ):
        ClusterWorkers(OPTIONS, address)


def test_missing_certificates_name_the_settings(protected: Protected) -> None:
    with pytest.raises(OptionError, match=r"expected certificates in .*ca-file.*, got none"):
        ClusterWorkers(OPTIONS, protected[0])


def test_unreadable_certificates_are_rejected(protected: Protected, tmp_path: Path) -> None:
    (tmp_path / "text.pem").write_text("no certificate")
    for name in ("none.pem", "text.pem"):
        files = dict.fromkeys(protected[1], str(tmp_path / name))
        with dask.config.set(files), pytest.raises(OptionError, match="expected certificates in"):
            ClusterWorkers(OPTIONS, protected[0])


def test_a_plain_address_does_not_reach_it(
    protected: Protected, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "_CONNECT_TIMEOUT_S", 2.0)
    plain = protected[0].replace("tls://", "tcp://")
    with pytest.raises(SurveyError, match="uses this protocol"):
        ClusterWorkers(OPTIONS, plain)


def test_required_encryption_rejects_a_plain_address() -> None:
    with (
        dask.config.set({"distributed.comm.require-encryption": True}),
        pytest.raises(OptionError, match="expected an address like"),
    ):
        ClusterWorkers(OPTIONS, "tcp://127.0.0.1:1")


@pytest.mark.parametrize(
    "address",
    [
        *("tcp://head-node:8786", "tcp://[2001:db8::1]:8786", "ws://head-node:8786"),
        *("tcp://localhost.example.org:8786", "head-node:8786", "tcp://0.0.0.0:8786"),
    ],
)
def test_a_remote_cluster_without_certificates_gets_a_warning(address: str) -> None:
    remark = known(protection_warning(address))
    assert address in remark
    assert "tls://" in remark


def test_a_protected_or_local_cluster_gets_no_warning() -> None:
    local = [f"tcp://{host}:8786" for host in ("127.0.0.1", "[::1]", "localhost")]
    for address in ("tls://head-node:8786", "inproc://10.0.0.1/1/1", *local):
        assert protection_warning(address) is None


def test_the_command_says_it_on_standard_error(
    drops: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cluster, "_CONNECT_TIMEOUT_S", 0.5)
    # A network that is for documents: nobody answers.
    assert main(["invert", str(drops), "--scheduler", "tcp://192.0.2.1:8786", *METHOD]) == 1
    output = capsys.readouterr()
    first, last = output.err.splitlines()
    assert "without certificates anyone who reaches the cluster" in first
    assert "expected a scheduler, got no answer" in last
    assert output.out == ""
