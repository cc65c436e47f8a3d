"""Instruments in the network, on sockets of this computer."""

import contextlib
import socket
import struct
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from pfwd_device.errors import DeviceLost, PortError
from pfwd_device.transport.opening import open_transport
from pfwd_device.transport.tcp import TcpTransport, open_tcp
from tests.pfwd_device.transport.test_serial_port import LONG, assert_close_ends_a_read


@pytest.fixture
def server() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        yield listening


def url_of(server: socket.socket, scheme: str = "socket") -> str:
    return f"{scheme}://127.0.0.1:{server.getsockname()[1]}"


@contextlib.contextmanager
def connected(
    server: socket.socket, **options: Any
) -> Iterator[tuple[TcpTransport, socket.socket]]:
    transport = open_tcp(url_of(server), **options)
    peer, _ = server.accept()
    with peer, contextlib.closing(transport):
        yield transport, peer


@pytest.mark.parametrize("scheme", ["socket", "tcp", "TCP"])
def test_both_schemes(server: socket.socket, scheme: str) -> None:
    with contextlib.closing(open_transport(url_of(server, scheme))) as transport:
        assert isinstance(transport, TcpTransport)
        assert "127.0.0.1" in transport.description
        peer, _ = server.accept()
        with peer:
            transport.write(b"question")
            assert peer.recv(100) == b"question"
            peer.sendall(b"answer")
            assert transport.read(LONG) == b"answer"
            assert transport.read(0.05) == b""


def test_small_commands_leave_at_once(server: socket.socket) -> None:
    with connected(server) as (transport, _):
        incoming = transport._incoming
        assert incoming.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        assert incoming.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)


@pytest.mark.skipif(sys.platform != "linux", reason="the number of the option is that of Linux")
def test_macos_detects_a_cable_too(server: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its option for the idle time has another name."""
    number = socket.TCP_KEEPIDLE
    monkeypatch.setattr(socket, "TCP_KEEPALIVE", number, raising=False)
    monkeypatch.delattr(socket, "TCP_KEEPIDLE")
    with connected(server) as (transport, _):
        assert transport._incoming.getsockopt(socket.IPPROTO_TCP, number) == 5


def test_end_of_the_connection(server: socket.socket) -> None:
    """Bytes before it are delivered; the first write after it "succeeds"."""
    with connected(server) as (transport, peer):
        peer.sendall(bytes(1000))
        peer.close()
        got = 0
        while got < 1000:
            got += len(transport.read(LONG))
        with pytest.raises(DeviceLost, match="end of the connection"):
            transport.read(LONG)
        assert got == 1000


def test_reset_of_the_connection(server: socket.socket) -> None:
    with connected(server) as (transport, peer):
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        peer.close()
        with pytest.raises(DeviceLost, match="reset"):
            transport.read(LONG)
        with pytest.raises(DeviceLost):
            transport.write(b"x")


def test_nobody_listens(server: socket.socket) -> None:
    url = url_of(server)
    server.close()
    with pytest.raises(PortError, match=r"refused.*switched on"):
        open_transport(url)


@pytest.mark.parametrize(
    "url", ["socket://", "tcp://host", "tcp://:5", "tcp://host:99999", "tcp://[::1", "tcp://h:x"]
)
def test_an_invalid_address_is_refused(url: str) -> None:
    with pytest.raises(PortError, match="host:port"):
        open_transport(url)


def test_close_from_another_thread_ends_a_read(server: socket.socket) -> None:
    with connected(server) as (transport, _):
        assert_close_ends_a_read(transport)


def test_closing_resets_no_connection(server: socket.socket) -> None:
    """A reset would delete the last command that the instrument has not read yet."""
    with connected(server) as (transport, peer):
        peer.sendall(b"samples that are not read")
        transport.write(b"stop")
        transport.close()
        assert peer.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) == 0
        assert peer.recv(100) == b"stop"
        assert peer.recv(100) == b""


def test_who_does_not_read_blocks_nobody_for_long(server: socket.socket) -> None:
    with connected(server, write_timeout=0.2) as (transport, _):

        def flood() -> None:
            for _ in range(2):  # Windows takes the first message whole, whatever its size
                transport.write(bytes(100_000_000))

        began = time.monotonic()
        with pytest.raises(DeviceLost, match="a timeout while sending"):
            flood()
        assert time.monotonic() - began < LONG


def test_bytes_come_in_large_pieces(server: socket.socket) -> None:
    """pyserial's socket:// gives them one by one, 0.2 MB/s at a whole core."""
    size = 4_000_000
    with connected(server) as (transport, peer):
        sender = threading.Thread(target=peer.sendall, args=(bytes(size),))
        sender.start()
        got, reads = 0, 0
        while got < size:
            got += len(transport.read(LONG))
            reads += 1
        sender.join()
        assert size / reads > 1000
