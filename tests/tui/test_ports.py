"""``pfwd ports``."""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

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
def _ports(monkeypatch: pytest.MonkeyPatch) -> None:
    def probes(urls: list[str], timeout: float | None = 0.0) -> list[Probe]:
        is_tested = timeout is not None
        reason = "silent" if is_tested else "not tested"
        probes = PROBES if is_tested else {}
        return [probes.get(url, Probe(url, None, None, reason)) for url in urls]

    monkeypatch.setattr("pfwd.ports.list_ports", lambda: PORTS)
    monkeypatch.setattr("pfwd.ports.port_advice", lambda _: [])
    monkeypatch.setattr("pfwd.ports.probe_ports", probes)


def run(*urls: str, json: bool = False, no_probe: bool = False) -> int:
    return ports.run(argparse.Namespace(urls=list(urls), json=json, no_probe=no_probe))


def test_the_table_has_a_row_for_each_port(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run() == 0
    out = capsys.readouterr().out
    assert "\x1b" not in out
    first, second, third = out.splitlines()
    assert first.startswith("/dev/ttyUSB0  USB serial")
    for part in ("[0403:6001 A5]", "SN-7, firmware 1.2, 2 channels, plate radius 150 mm"):
        assert part in first
    assert "[1a86:7523]" in second
    assert second.endswith("sends lines")
    assert "ttyS0: in use" not in third
    assert first.index("PFWD") == second.index("sends") == third.index("in use")
    monkeypatch.setattr("pfwd.ports.list_ports", list)
    assert run() == 0
    output = capsys.readouterr()
    assert (output.out, "no serial ports" in output.err) == ("", True)


@pytest.fixture
def records(capsys: pytest.CaptureFixture[str]) -> Callable[..., list[dict[str, Any]]]:
    """Return the records of ``pfwd ports --json``."""

    def run_json(*urls: str, no_probe: bool = False) -> list[dict[str, Any]]:
        assert run(*urls, json=True, no_probe=no_probe) == 0
        output = capsys.readouterr()
        assert (output.err == "") == no_probe
        return [json.loads(line) for line in output.out.splitlines()]

    return run_json


def test_json_has_a_record_for_each_port(records: Callable[..., list[dict[str, Any]]]) -> None:
    lines = records()
    assert [line["url"] for line in lines] == [port.url for port in PORTS]
    assert [line["answers"] for line in lines] == ["pfwd", "ascii", None]
    usb = (lines[0]["vid"], lines[0]["pid"], lines[0]["port_serial_number"])
    assert usb == (0x0403, 0x6001, "A5")
    assert lines[2]["vid"] is None
    identity = lines[0]["identity"]
    assert (identity["serial_number"], identity["plate_radius_m"]) == ("SN-7", 0.15)
    assert identity["channels"][1] == {"name": "g0", "role": "geophone", "offset_m": 0.3}
    assert "\x1b" not in identity["model"]
    assert (lines[1]["identity"], lines[1]["reason"]) == (None, "sends lines")
    assert {line["reason"] for line in records(no_probe=True)} == {"not tested"}
    lines = records("tcp://host:1", "/dev/serial/by-id/x")
    assert [line["url"] for line in lines] == ["tcp://host:1", "/dev/ttyUSB0"]
    assert [line["reason"] for line in lines] == ["silent", "answers as Model SN-7"]


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
