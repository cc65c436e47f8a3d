"""``pfwd simulate``: what it prints, and how it ends."""

import json
import signal
import socket
import subprocess
import textwrap
from pathlib import Path

import pytest

from pfwd_device.wire.binary import BinaryDialect
from pfwd_device.wire.messages import Start
from tests.tui.console import running

TCP = ("--listen", "tcp://127.0.0.1:0")


def first_line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def connect(url: str) -> socket.socket:
    host, _, port = url.removeprefix("socket://").rpartition(":")
    return socket.create_connection((host, int(port)), 20)


def test_the_first_line_is_the_url() -> None:
    with running("simulate", *TCP) as process:
        connect(first_line(process)).close()
    with running("simulate", *TCP, "--json") as process:
        record = json.loads(first_line(process))
        assert list(record) == ["url"]
        connect(record["url"]).close()


@pytest.mark.posix
def test_by_default_it_is_a_virtual_serial_port() -> None:
    with running("simulate") as process:
        assert Path(first_line(process)).is_char_device()


def test_after_the_last_drop_it_ends_by_itself(tmp_path: Path) -> None:
    truth = tmp_path / "truth.json"
    scenario = tmp_path / "brief.toml"
    scenario.write_text(
        textwrap.dedent(
            """
            base = "stiff"
            [drops]
            first = 0.3
            interval = 0.5
            quiet = 0.2
            seating = []
            """
        ),
        encoding="utf-8",
    )
    options = ["--scenario", str(scenario), "--drops", "2", "--rate", "0", "--truth", str(truth)]
    with running("simulate", *TCP, *options) as process:
        with connect(first_line(process)) as connection:
            connection.sendall(BinaryDialect().encode(Start()))
            while connection.recv(65_536):
                pass
        assert process.wait(20) == 0
    drops = json.loads(truth.read_text(encoding="utf-8"))
    assert [drop["modulus_pa"] for drop in drops] == [160e6, 160e6]


@pytest.mark.posix
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("sampling", [False, True])
def test_a_signal_ends_it_cleanly(number: signal.Signals, sampling: bool, tmp_path: Path) -> None:
    truth = tmp_path / "truth.json"
    with running("simulate", *TCP, "--truth", str(truth)) as process:
        with connect(first_line(process)) as connection:
            if sampling:
                connection.sendall(BinaryDialect().encode(Start()))
                assert connection.recv(65_536)
            process.send_signal(number)
            assert process.wait(20) == 0
        assert process.stderr is not None
        assert "Traceback" not in process.stderr.read()
    assert json.loads(truth.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--scenario", "nowhere"], "expected an existing file or one of ascii"),
        (["--listen", "morse"], "expected pty or tcp://HOST:PORT"),
        (["--drops", "0"], "from 1"),
        (["--rate", "-1"], "rate"),
    ],
)
def test_wrong_usage_has_status_2(arguments: list[str], reason: str) -> None:
    with running("simulate", *arguments) as process:
        assert process.wait(20) == 2
        assert process.stderr is not None
        assert reason in process.stderr.read()
        assert process.stdout is not None
        assert process.stdout.read() == ""
