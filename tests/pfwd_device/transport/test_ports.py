"""Ports by name and by adapter."""

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pfwd_device.errors import PortError
from pfwd_device.transport import opening, ports
from pfwd_device.transport.opening import PortFinder
from pfwd_device.transport.ports import Adapter, adapter_of, candidate_urls, list_ports

FTDI = Adapter(0x0403, 0x6001, "A50285BI")


def usb(device: str, adapter: Adapter | None = FTDI, description: str = "USB serial") -> Any:
    return SimpleNamespace(
        device=device,
        description=description,
        vid=adapter and adapter.vid,
        pid=adapter and adapter.pid,
        serial_number=adapter and adapter.serial_number,
    )


@pytest.fixture
def plugged(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Ports that are connected."""
    connected: list[Any] = []
    monkeypatch.setattr(ports._serial_ports, "comports", lambda: list(connected))
    return connected


def test_listing_is_by_name_and_harmless(plugged: list[Any]) -> None:
    plugged += [usb("/dev/ttyUSB1", None, "x\x1b[2J"), usb("/dev/ttyUSB0")]
    first, second = list_ports()
    assert (first.url, first.adapter) == ("/dev/ttyUSB0", FTDI)
    assert second.adapter is None
    assert "\x1b" not in second.description


def test_the_real_ports_can_be_listed() -> None:
    assert all(port.url for port in list_ports())


@pytest.mark.posix
def test_a_link_is_the_port_it_points_to(plugged: list[Any], tmp_path: Path) -> None:
    device, link = tmp_path / "ttyUSB0", tmp_path / "instrument"
    device.touch()
    link.symlink_to(device)
    plugged.append(usb(str(device)))
    assert adapter_of(str(link)) == FTDI
    assert adapter_of("socket://host:1") is None
    assert candidate_urls(str(link), FTDI) == [str(link)]


def test_the_adapter_is_identified_under_another_name(plugged: list[Any]) -> None:
    second = Adapter(0x0403, 0x6001, "OTHER")
    plugged += [usb("/dev/ttyUSB0", second), usb("/dev/ttyUSB3")]
    assert candidate_urls("/dev/ttyUSB0", FTDI) == ["/dev/ttyUSB3"]


def test_names_on_windows_are_compared(plugged: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: str, **_: object) -> str:
        raise OSError(22, "The semaphore timeout period has expired", path)

    plugged += [usb("COM3", None), usb("COM10")]
    path = SimpleNamespace(**{**vars(os.path), "realpath": refuse})
    windows = {**vars(os), "name": "nt", "path": path}
    monkeypatch.setattr(ports, "os", SimpleNamespace(**windows))
    assert [port.url for port in list_ports()] == ["COM10", "COM3"]
    for name in ("com10", r"\\.\COM10", "//./com10", "COM10:"):
        assert adapter_of(name) == FTDI
        assert candidate_urls(name, FTDI) == [name]
    assert adapter_of("COM1") is None


@pytest.mark.posix
def test_both_names_on_macos_have_the_adapter(
    plugged: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    plugged.append(usb("/dev/cu.usbserial-A50285BI"))
    monkeypatch.setattr(ports, "sys", SimpleNamespace(platform="darwin"))
    assert adapter_of("/dev/tty.usbserial-A50285BI") == FTDI
    assert adapter_of("/dev/tty.usbserial-OTHER") is None


def test_another_adapter_under_the_old_name_is_not_the_instrument(plugged: list[Any]) -> None:
    plugged.append(usb("/dev/ttyUSB0", Adapter(1, 2, None)))
    assert candidate_urls("/dev/ttyUSB0", FTDI) == []


def test_equal_adapters_are_all_candidates_the_old_name_first(plugged: list[Any]) -> None:
    cheap = Adapter(0x1A86, 0x7523, None)
    plugged += [usb("/dev/ttyUSB0", cheap), usb("/dev/ttyUSB1", cheap)]
    assert candidate_urls("/dev/ttyUSB1", cheap) == ["/dev/ttyUSB1", "/dev/ttyUSB0"]


def test_an_unlisted_port_is_tried_by_name(plugged: list[Any]) -> None:
    assert candidate_urls("/dev/pts/3", None) == ["/dev/pts/3"]
    assert candidate_urls("/dev/ttyUSB0", FTDI) == ["/dev/ttyUSB0"]


def test_finder_follows_the_adapter(plugged: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr(opening, "open_transport", lambda url, rate: opened.append(url))
    find = PortFinder("/dev/ttyUSB0")
    plugged[:] = [usb("/dev/ttyUSB0")]
    find()
    plugged[:] = [usb("/dev/ttyUSB7")]
    find()
    plugged[:] = [usb("/dev/ttyUSB0", Adapter(1, 2, "x"))]
    with pytest.raises(PortError, match="own adapter"):
        find()
    assert opened == ["/dev/ttyUSB0", "/dev/ttyUSB7"]


def test_equal_adapters_are_all_tried(plugged: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr(opening, "open_transport", lambda url, rate: opened.append(url))
    cheap = Adapter(0x1A86, 0x7523, None)
    plugged += [usb("/dev/ttyUSB0", cheap), usb("/dev/ttyUSB1", cheap)]
    find = PortFinder("/dev/ttyUSB0")
    for _ in range(4):
        find()
    assert opened == [f"/dev/ttyUSB{k}" for k in (0, 0, 1, 0)]
