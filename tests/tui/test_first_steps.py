"""First steps: ``pfwd`` without a command, and a port without rights."""

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from pfwd import ports as port_advice
from tests.tui.console import pfwd


def test_pfwd_without_a_command_prints_first_steps() -> None:
    printed = pfwd()
    assert (printed.status, printed.err) == (0, "")
    assert "pfwd demo" in printed.out


@pytest.fixture
def system(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Name of the operating system, on which the advice depends."""
    system = SimpleNamespace(platform="linux")
    monkeypatch.setattr(port_advice, "sys", system)
    return system


@pytest.mark.posix
def test_a_port_without_rights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, system: SimpleNamespace
) -> None:
    port = tmp_path / "ttyUSB0"
    port.write_text("", encoding="utf-8")
    monkeypatch.setattr(port_advice, "USB_DEVICES", tmp_path / "none")
    assert port_advice.port_advice([str(port)]) == []
    monkeypatch.setattr(os, "access", lambda *_: False)
    (advice,) = port_advice.port_advice([str(port), "COM3"])
    assert advice.startswith(f"no permission to open {port}. Run: sudo usermod -aG ")
    system.platform = "win32"  # where a look at the port would open it
    assert port_advice.port_advice([str(port)]) == []


@pytest.mark.usefixtures("system")
def test_brltty_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    device = tmp_path / "1-2"
    device.mkdir()
    (device / "idVendor").write_text("1a86\n", encoding="utf-8")
    (device / "idProduct").write_text("7523\n", encoding="utf-8")
    monkeypatch.setattr(port_advice, "USB_DEVICES", tmp_path)
    monkeypatch.setattr("shutil.which", lambda _: "/usr/bin/brltty")
    (advice,) = port_advice.port_advice([])
    assert "1a86:7523 is connected, but has no port: brltty" in advice
    (device / "1-2:1.0" / "ttyUSB0").mkdir(parents=True)
    assert port_advice.port_advice([]) == []
