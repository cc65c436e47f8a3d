"""Clusters with certificates, and the warning about clusters without."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pfwd.archive import cluster
from pfwd.archive.cluster import ClusterWorkers, protection_warning
from pfwd.errors import OptionError, SurveyError
from tests.pfwd.archive.stand_ins import OPTIONS

TOP = Path(__file__).resolve().parents[3]
METHOD = ("--method", "posterior", "--sensors", "centre", "--bedrock-depth", "1.2")
NAME = "DASK_DISTRIBUTED__COMM__TLS__"

distributed: Any = pytest.importorskip("distributed", reason="the extra cluster is not installed")
dask: Any = pytest.importorskip("dask", reason="the extra cluster is not installed")
pytest.importorskip("cryptography", reason="it makes the certificates")


def certificates(folder: Path) -> tuple[Any, dict[str, str]]:
    """Return new certificates for a cluster, and the settings that point dask to their files."""
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
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=":0", security=security
    ) as local:
        assert local.scheduler_address.startswith("tls://")
        yield local.scheduler_address, right, wrong


Protected = tuple[str, dict[str, str], dict[str, str]]


def test_the_command_takes_them_from_its_environment(protected: Protected, drops: Path) -> None:
    address, right, _ = protected
    names = {
        "distributed.comm.tls.ca-file": "CA_FILE",
        "distributed.comm.tls.client.cert": "CLIENT__CERT",
        "distributed.comm.tls.client.key": "CLIENT__KEY",
    }
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


@pytest.mark.parametrize("content", [None, "no certificate"])
def test_unreadable_certificates_are_rejected(
    content: str | None, protected: Protected, tmp_path: Path
) -> None:
    path = tmp_path / "file.pem"
    if content is not None:
        path.write_text(content)
    settings = dict.fromkeys(protected[1], str(path))
    with dask.config.set(settings), pytest.raises(OptionError, match="expected certificates in"):
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
    ("address", "warned"),
    [
        ("tls://head-node:8786", False),
        ("inproc://10.0.0.1/1/1", False),
        ("tcp://127.0.0.1:8786", False),
        ("tcp://[::1]:8786", False),
        ("tcp://localhost:8786", False),
        ("tcp://head-node:8786", True),
        ("tcp://[2001:db8::1]:8786", True),
        ("tcp://localhost.example.org:8786", True),
        ("ws://head-node:8786", True),
        ("head-node:8786", True),
        ("tcp://0.0.0.0:8786", True),
    ],
)
def test_a_remote_cluster_without_certificates_gets_a_warning(address: str, warned: bool) -> None:
    remark = protection_warning(address)
    assert (remark is not None) is warned
    if remark is not None:
        assert address in remark
        assert "tls://" in remark


def test_the_command_says_it_on_standard_error(
    drops: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from tui.cli import main

    monkeypatch.setattr(cluster, "_CONNECT_TIMEOUT_S", 0.5)
    # A network that is for documents: nobody answers.
    assert main(["invert", str(drops), "--scheduler", "tcp://192.0.2.1:8786", *METHOD]) == 1
    output = capsys.readouterr()
    first, last = output.err.splitlines()
    assert "without certificates anyone who reaches the cluster" in first
    assert "expected a scheduler, got no answer" in last
    assert output.out == ""
