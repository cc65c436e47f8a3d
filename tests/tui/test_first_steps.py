"""What people meet first: bare ``pfwd``, a slip of the keyboard, a place that cannot be written."""

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from pfwd import ports as port_advice
from tui.cli import main


def test_bare_pfwd_says_what_to_do_first(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    out, err = capsys.readouterr()
    assert "pfwd demo" in out
    assert err == ""


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["lvie", "x"], "'lvie' is not a command; did you mean live?"),
        (["log", "x", "-o", "y", "--procedur", "mndot"], "did you mean --procedure?"),
        (["log", "x", "-o", "y", "--targett=4"], "did you mean --target?"),
        (["invert", "x", "--plate", "rigid-rouhg"], "did you mean rigid-rough?"),
        (["qqq"], "'qqq' is not a command; pfwd help --all"),
        (["edit", "x", "--zzz"], "unrecognized arguments: --zzz\n"),
    ],
)
def test_what_was_meant(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("command", ["log", "live"])
def test_the_output_is_tried_before_the_work(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("x", encoding="utf-8")
    for place, came in (("file", "a file"), ("file/s", str(tmp_path / "file"))):
        assert main([command, "/dev/no-port", "-o", str(tmp_path / place)]) == 1
        err = capsys.readouterr().err
        assert "expected a folder that can be written" in err
        assert came in err
        assert "no-port" not in err


@pytest.fixture
def system(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Name of the operating system, on which the advice depends."""
    stated = SimpleNamespace(platform="linux")
    monkeypatch.setattr(port_advice, "sys", stated)
    return stated


@pytest.mark.posix
def test_a_port_without_rights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, system: SimpleNamespace
) -> None:
    port = tmp_path / "ttyUSB0"
    port.write_text("", encoding="utf-8")
    monkeypatch.setattr(port_advice, "USB_DEVICES", tmp_path / "none")
    assert port_advice.port_advice([str(port)]) == []
    monkeypatch.setattr(os, "access", lambda *_: False)
    (said,) = port_advice.port_advice([str(port), "COM3"])
    assert said.startswith(f"no permission to open {port}. Run: sudo usermod -aG ")
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
    (said,) = port_advice.port_advice([])
    assert "1a86:7523 is connected, but has no port: brltty" in said
    (device / "1-2:1.0" / "ttyUSB0").mkdir(parents=True)
    assert port_advice.port_advice([]) == []
