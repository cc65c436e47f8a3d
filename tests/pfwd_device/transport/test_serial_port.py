"""Serial ports, on pseudo-terminals; each test is a trap that was met.

A pair of linked ports is a pseudo-terminal here. What pyserial raises of Windows' ports is raised
on every platform by the tests without this mark, those of lost devices and of ports not opened.
"""

import contextlib
import errno
import os
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial

from pfwd_device.errors import DeviceError, DeviceLost, PortError
from pfwd_device.transport import serial_port
from pfwd_device.transport.base import PORT_ERRORS, Transport
from pfwd_device.transport.opening import open_transport
from pfwd_device.transport.ports import Adapter, Port
from pfwd_device.transport.serial_port import SerialTransport, port_error

LONG = 10.0
"""s; nothing takes so long, however busy the computer is."""


class Pty:
    """A pseudo-terminal; `unplug` takes the instrument's end away."""

    def __init__(self) -> None:
        import tty

        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.name = os.ttyname(slave)
        os.close(slave)
        self._open = True

    def unplug(self) -> None:
        if self._open:
            os.close(self.master)
            self._open = False


@pytest.fixture
def pty() -> Iterator[Pty]:
    pair = Pty()
    yield pair
    pair.unplug()


def read_all(transport: Any, count: int) -> bytes:
    """`count` bytes, however they are cut."""
    data, end = b"", time.monotonic() + LONG
    while len(data) < count and time.monotonic() < end:
        data += transport.read(0.5)
    return data


def assert_close_ends_a_read(transport: Transport) -> None:
    """`DeviceLost` is raised in the reader, soon."""
    closing = threading.Timer(0.05, transport.close)
    closing.start()
    began = time.monotonic()
    with pytest.raises(DeviceLost, match="this program closed"):
        transport.read(LONG)
    assert time.monotonic() - began < 5.0
    closing.join()


@pytest.mark.posix
def test_bytes_go_both_ways(pty: Pty) -> None:
    with contextlib.closing(open_transport(pty.name)) as transport:
        assert transport.url == pty.name
        assert "115200" in transport.description
        transport.write(b"question\0")
        assert os.read(pty.master, 100) == b"question\0"
        os.write(pty.master, b"answer\0")
        assert read_all(transport, 7) == b"answer\0"


@pytest.mark.posix
def test_bytes_before_the_unplug_are_delivered(pty: Pty) -> None:
    """A read of a fixed size throws away what it holds when the device goes."""
    transport = open_transport(pty.name)
    got, lost = [], threading.Event()

    def read() -> None:
        try:
            while True:
                got.append(transport.read(LONG))
        except DeviceLost:
            lost.set()

    reader = threading.Thread(target=read)
    reader.start()
    os.write(pty.master, bytes(1000))
    end = time.monotonic() + LONG
    while sum(map(len, got)) < 1000 and time.monotonic() < end:
        time.sleep(0.01)
    pty.unplug()
    assert lost.wait(LONG / 2), "before the read gives up by itself"
    reader.join()
    transport.close()
    assert sum(map(len, got)) == 1000


@pytest.mark.posix
def test_every_call_after_an_unplug_is_a_lost_device(pty: Pty) -> None:
    """in_waiting raises a bare OSError then, write a SerialException, flush a termios.error."""
    with contextlib.closing(open_transport(pty.name)) as transport:
        pty.unplug()
        with pytest.raises(DeviceLost, match="unplugged"):
            read_all(transport, 1)
        with pytest.raises(DeviceLost, match="unplugged"):
            transport.read(0.1)
        with pytest.raises(DeviceLost, match=pty.name):
            transport.write(b"hello")


@pytest.mark.posix
def test_errors_of_pyserial_after_an_unplug_are_caught(pty: Pty) -> None:
    """The errors themselves, so that a new version of pyserial that raises others is noticed."""
    import termios

    with serial.Serial(pty.name, timeout=0.1) as port:
        pty.unplug()
        with pytest.raises(OSError, match=f"{errno.EIO}") as waiting:
            _ = port.in_waiting
        with pytest.raises(termios.error) as flushing:
            port.flush()
        assert not isinstance(flushing.value, OSError)
        assert isinstance(flushing.value, PORT_ERRORS)
        assert isinstance(waiting.value, PORT_ERRORS)
        assert port.is_open


@pytest.mark.posix
def test_close_from_another_thread_ends_a_read(pty: Pty) -> None:
    """Closing pyserial's port under its reader is a TypeError in the reader."""
    transport = open_transport(pty.name)
    assert_close_ends_a_read(transport)
    transport.close()  # once more does no harm


class TornPort:
    """Behaves as pyserial's port does that is closed under its reader."""

    port, baudrate, timeout = "torn", 9600, 0.1

    def __init__(self, error: Exception) -> None:
        self._error = error

    @property
    def in_waiting(self) -> int:
        return 1

    def read(self, size: int) -> bytes:
        raise self._error

    def write(self, data: bytes) -> int:
        raise self._error

    def close(self) -> None:
        raise self._error


@pytest.mark.parametrize(
    "error",
    [
        TypeError("'NoneType' object cannot be interpreted as an integer"),
        OSError(errno.EIO, "Input/output error"),
        serial.SerialException("device reports readiness to read but returned no data"),
        AttributeError("'NoneType' object has no attribute 'hEvent'"),
    ],
)
def test_any_error_of_a_port_is_a_lost_device(error: Exception) -> None:
    transport = open_transport(TornPort(error))
    with pytest.raises(DeviceLost, match="torn"):
        transport.read(0.1)
    with pytest.raises(DeviceLost, match="torn"):
        transport.write(b"x")
    transport.close()


class DyingPort(TornPort):
    """Gives one byte, then dies before the rest can be counted."""

    def __init__(self) -> None:
        super().__init__(OSError(errno.EIO, "gone"))
        self._bytes = [b"a"]
        self._counted = 0

    @property
    def in_waiting(self) -> int:
        self._counted += 1
        if self._counted > 1:
            raise self._error
        return 0

    def read(self, size: int) -> bytes:
        return self._bytes.pop()


def test_a_byte_read_is_not_lost_with_the_device() -> None:
    transport = SerialTransport(DyingPort())
    assert transport.read(0.1) == b"a"
    with pytest.raises(DeviceLost):
        transport.read(0.1)
    transport.close()


@pytest.mark.posix
def test_a_second_open_is_refused(pty: Pty) -> None:
    """It would succeed without the lock, and the two would take bytes from each other."""
    first = open_transport(pty.name)
    with contextlib.closing(first), pytest.raises(PortError, match="in use by another program"):
        open_transport(pty.name)
    open_transport(pty.name).close()


@pytest.mark.posix
def test_a_missing_port_lists_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    adapters = [
        Port("/dev/ttyUSB0", "USB2.0-Serial", Adapter(0x1A86, 0x7523, None)),
        Port("/dev/ttyS0", "/dev/ttyS0"),
    ]
    monkeypatch.setattr(serial_port, "list_ports", lambda: adapters)
    name = str(tmp_path / "ttyUSB9")
    with pytest.raises(PortError) as missing:
        open_transport(name)
    assert str(missing.value) == (
        f"port {name}: not found. Connected ports: /dev/ttyUSB0 (USB2.0-Serial), /dev/ttyS0. "
        "Check the cable or choose another port"
    )
    monkeypatch.setattr(serial_port, "list_ports", list)
    with pytest.raises(PortError, match=r"not found\. No port is connected\. Check the cable"):
        open_transport(name)


@pytest.mark.posix
def test_a_path_that_is_no_port_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    for path in (tmp_path / "file", tmp_path):
        with pytest.raises(PortError, match="no serial port"):
            open_transport(str(path))


def test_an_invalid_url_is_refused() -> None:
    with pytest.raises(PortError, match=r"foo.*Check the spelling"):
        open_transport("foo://bar")


@pytest.mark.parametrize(
    ("cause", "match"),
    [
        (serial.SerialException(errno.EACCES, "Permission denied"), "no permission"),
        (serial.SerialException("could not open port 'COM3': FileNotFoundError(2, '', None, 2)"),
         "port COM3: not found"),
        (serial.SerialException("could not open port 'COM3': PermissionError(13, '', None, 5)"),
         "port COM3: cannot be opened: in use by another program. End that program"),
        (serial.SerialException(errno.EIO, "Input/output error"), "plug it in again"),
    ],
)  # fmt: skip
def test_why_a_port_does_not_open(cause: Exception, match: str) -> None:
    error = port_error("COM3", cause)
    assert isinstance(error, OSError)
    assert isinstance(error, DeviceError)
    with pytest.raises(PortError, match=match):
        raise error


def test_missing_permission_names_the_group(monkeypatch: pytest.MonkeyPatch) -> None:
    cause = serial.SerialException(errno.EACCES, "Permission denied")
    monkeypatch.setattr(sys, "platform", "linux")
    assert "dialout" in str(port_error("/dev/ttyUSB0", cause))
    monkeypatch.setattr(sys, "platform", "darwin")  # has no such group
    assert "dialout" not in str(port_error("/dev/cu.usbserial", cause))


@pytest.mark.posix
def test_who_does_not_read_blocks_nobody_for_long(pty: Pty) -> None:
    with contextlib.closing(open_transport(pty.name, write_timeout=0.3)) as transport:
        began = time.monotonic()
        with pytest.raises(DeviceLost, match="got a timeout"):
            transport.write(bytes(1_000_000))
        assert time.monotonic() - began < LONG


@pytest.mark.posix
def test_bytes_before_the_open_are_discarded(pty: Pty) -> None:
    """Hence the instrument greets on request, not when it starts."""
    os.write(pty.master, b"greeting")
    with contextlib.closing(open_transport(pty.name)) as transport:
        assert transport.read(0.2) == b""
        os.write(pty.master, b"later")
        assert read_all(transport, 5) == b"later"


def test_an_open_port_is_used_unchanged() -> None:
    with contextlib.closing(serial.serial_for_url("loop://")) as port:
        transport = open_transport(port)
        transport.write(b"hello")
        assert read_all(transport, 5) == b"hello"
        assert open_transport(transport) is transport
        transport.close()
