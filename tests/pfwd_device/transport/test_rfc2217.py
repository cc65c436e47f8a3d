"""A serial port that another computer lends over the network."""

import contextlib
import socket
import threading
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
import serial
import serial.rfc2217

from pfwd_device.errors import PortError
from pfwd_device.transport.opening import open_transport
from tests.pfwd_device.transport.test_serial_port import assert_close_ends_a_read, read_all

# Names that Python gives up, in pyserial itself.
pytestmark = pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")


@pytest.fixture
def lender() -> Iterator[str]:
    """Lends one port, which sends back what it gets."""
    server = socket.create_server(("127.0.0.1", 0))
    server.settimeout(5)
    stop = threading.Event()

    def run() -> None:
        with contextlib.suppress(OSError):
            peer, _ = server.accept()
            peer.settimeout(0.02)
            lent = serial.serial_for_url("loop://", timeout=0.05)
            with peer, contextlib.closing(lent):
                manager = serial.rfc2217.PortManager(lent, SimpleNamespace(write=peer.sendall))
                while not stop.is_set():
                    with contextlib.suppress(TimeoutError):
                        data = peer.recv(1024)
                        if not data:
                            return
                        lent.write(b"".join(manager.filter(data)))
                    if waiting := lent.in_waiting:
                        peer.sendall(b"".join(manager.escape(lent.read(waiting))))

    thread = threading.Thread(target=run)
    thread.start()
    yield f"rfc2217://127.0.0.1:{server.getsockname()[1]}"
    stop.set()
    server.close()
    thread.join()


def test_bytes_go_both_ways_and_close_ends_a_read(lender: str) -> None:
    """It knows neither a timeout for writing nor how to interrupt a read."""
    transport = open_transport(lender)
    transport.write(b"hello\0\xff\xff")
    assert read_all(transport, 8) == b"hello\0\xff\xff"
    assert_close_ends_a_read(transport)


def test_nobody_lends(lender: str) -> None:
    with contextlib.closing(open_transport(lender)), pytest.raises(PortError, match="refused"):
        open_transport("rfc2217://127.0.0.1:1")
