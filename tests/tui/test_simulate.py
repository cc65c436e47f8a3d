"""``pfwd simulate``: its output and its end."""

import json
import signal
import socket
import subprocess
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


@pytest.mark.posix
def test_the_first_line_is_the_url() -> None:
    with running("simulate") as process:
        assert Path(first_line(process)).is_char_device(), "a virtual serial port"
    with running("simulate", *TCP, "--json") as process:
        record = json.loads(first_line(process))
        assert list(record) == ["url"]
        connect(record["url"]).close()


def test_the_simulation_ends_after_the_last_drop(tmp_path: Path) -> None:
    truth = tmp_path / "truth.json"
    scenario = tmp_path / "brief.toml"
    drops = "[drops]\nfirst = 0.3\ninterval = 0.5\nquiet = 0.2\nseating = []\n"
    scenario.write_text(f'base = "stiff"\n{drops}', encoding="utf-8")
    options = ["--scenario", str(scenario), "--drops", "2", "--rate", "0", "--truth", str(truth)]
    with running("simulate", *TCP, *options) as process:
        with connect(first_line(process)) as connection:
            connection.sendall(BinaryDialect().encode(Start()))
            while connection.recv(65_536):
                pass
        assert process.wait(20) == 0
    simulated = json.loads(truth.read_text(encoding="utf-8"))
    assert [drop["modulus_pa"] for drop in simulated] == [160e6, 160e6]


@pytest.mark.posix
@pytest.mark.parametrize(
    ("number", "is_sampling"), [(signal.SIGINT, False), (signal.SIGTERM, True)]
)
def test_a_signal_ends_the_simulation(
    number: signal.Signals, is_sampling: bool, tmp_path: Path
) -> None:
    truth = tmp_path / "truth.json"
    with running("simulate", *TCP, "--truth", str(truth)) as process:
        with connect(first_line(process)) as connection:
            if is_sampling:
                connection.sendall(BinaryDialect().encode(Start()))
                assert connection.recv(65_536)
            process.send_signal(number)
            assert process.wait(20) == 0
        assert process.stderr is not None
        assert "Traceback" not in process.stderr.read()
    assert json.loads(truth.read_text(encoding="utf-8")) == []
