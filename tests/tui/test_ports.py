"""``pfwd ports``."""

import argparse
import json
from pathlib import Path

import pytest

from pfwd.ports import Adapter, Port, Probe
from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_plugins.quantities import Measurand
from tui.commands import ports

IDENTITY = Identity(
    "SN-7", "Model\x1b[2J", "1.2", 10_000.0, 24, 2.5,
    (
        ChannelIdentity("load", Measurand.LOAD),
        ChannelIdentity("g0", Measurand.VELOCITY, 0.3)
    ),
    plate_radius=0.15,
)  # fmt: skip
PORTS = [
    Port("/dev/ttyUSB0", "USB serial\x1b", Adapter(0x0403, 0x6001, "A5"), "/dev/serial/by-id/x"),
    Port("/dev/ttyUSB1", "USB serial", Adapter(0x1A86, 0x7523, None)),
    Port("/dev/ttyS0", "ttyS0"),
]
PROBES = {
    "/dev/ttyUSB0": Probe("/dev/ttyUSB0", "pfwd", IDENTITY, "answers as Model SN-7"),
    "/dev/ttyUSB1": Probe("/dev/ttyUSB1", "ascii", None, "sends lines"),
    "/dev/ttyS0": Probe("/dev/ttyS0", None, None, "/dev/ttyS0: in use\x1b by another program"),
}


@pytest.fixture(autouse=True)
def _world(monkeypatch: pytest.MonkeyPatch) -> None:
    def probes(urls: list[str], timeout: float | None = 0.0) -> list[Probe]:
        silent = "silent" if timeout is not None else "not tested"
        known = {} if timeout is None else PROBES
        return [known.get(url, Probe(url, None, None, silent)) for url in urls]

    monkeypatch.setattr("pfwd.ports.list_ports", lambda: PORTS)
    monkeypatch.setattr("pfwd.ports.port_advice", lambda _: [])
    monkeypatch.setattr("pfwd.ports.probe_ports", probes)


def run(*urls: str, json: bool = False, no_probe: bool = False) -> int:
    return ports.run(argparse.Namespace(urls=list(urls), json=json, no_probe=no_probe))


def test_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert run() == 0
    out = capsys.readouterr().out
    assert "\x1b" not in out
    first, second, third = out.splitlines()
    assert first.startswith("/dev/ttyUSB0  USB serial")
    assert "[0403:6001 A5]" in first
    assert "SN-7, firmware 1.2, 2 channels, plate radius 150 mm" in first
    assert "[1a86:7523]" in second
    assert second.endswith("sends lines")
    assert "ttyS0: in use" not in third
    assert first.index("PFWD") == second.index("sends") == third.index("in use")


def test_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(json=True) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["url"] for line in lines] == [port.url for port in PORTS]
    assert [line["answers"] for line in lines] == ["pfwd", "ascii", None]
    assert (lines[0]["vid"], lines[0]["pid"], lines[0]["port_serial_number"]) == (
        0x0403, 0x6001, "A5",
    )  # fmt: skip
    assert lines[2]["vid"] is None
    identity = lines[0]["identity"]
    assert (identity["serial_number"], identity["plate_radius_m"]) == ("SN-7", 0.15)
    assert identity["channels"][1] == {"name": "g0", "role": "geophone", "offset_m": 0.3}
    assert "\x1b" not in identity["model"]
    assert lines[1]["identity"] is None
    assert lines[1]["reason"] == "sends lines"


def test_without_asking(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(json=True, no_probe=True) == 0
    captured = capsys.readouterr()
    lines = [json.loads(line) for line in captured.out.splitlines()]
    assert {line["reason"] for line in lines} == {"not tested"}
    assert captured.err == ""


def test_named_ports(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("tcp://host:1", "/dev/serial/by-id/x", json=True) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["url"] for line in lines] == ["tcp://host:1", "/dev/ttyUSB0"]
    assert [line["reason"] for line in lines] == ["silent", "answers as Model SN-7"]


def test_no_ports(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("pfwd.ports.list_ports", list)
    assert run() == 0
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "no serial ports" in captured.err


@pytest.mark.posix
def test_a_port_under_another_name_has_its_description(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    device, link = tmp_path / "ttyUSB0", tmp_path / "instrument"
    device.touch()
    link.symlink_to(device)
    listed = [Port(str(device), "USB serial", Adapter(0x0403, 0x6001, "A5"))]
    monkeypatch.setattr("pfwd.ports.list_ports", lambda: listed)
    assert run(str(link)) == 0
    assert "[0403:6001 A5]" in capsys.readouterr().out
