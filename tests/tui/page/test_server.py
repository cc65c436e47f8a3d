"""The page for a browser against those that are not its reader."""

import http.client
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from pfwd.errors import SurveyError
from pfwd_device import Drop
from pfwd_device.recording import DropRecord, SurveyWriter
from tui.page.server import MAX_WRONG_CODES, MAX_WRONG_PER_CLIENT, SurveyServer
from tui.screen.opened.rows import OpenedSurvey

CODE = "12345678"


@pytest.fixture
def survey(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PFWD_CACHE", str(tmp_path / "cache"))
    with SurveyWriter.open(tmp_path / "road", publish=False) as writer:
        writer.save_drop(DropRecord("P", Drop(1, np.arange(4.0), np.zeros(4), ())))
    return tmp_path / "road"


@contextmanager
def serving(survey: Path, host: str, lines: list[str]) -> Iterator[SurveyServer]:
    with SurveyServer(OpenedSurvey(survey), host, 0, lines.append) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.fixture
def lines() -> list[str]:
    """What the owner is shown."""
    return []


@pytest.fixture
def server(survey: Path, lines: list[str]) -> Iterator[SurveyServer]:
    with serving(survey, "127.0.0.1", lines) as found:
        yield found


def sent(server: SurveyServer, request: bytes) -> bytes:
    """The answer to bytes, whole."""
    host, port = server.server_address[:2]
    with socket.create_connection((str(host), port), timeout=20) as connection:
        connection.sendall(request)
        connection.shutdown(socket.SHUT_WR)
        answer = b""
        while part := connection.recv(65536):
            answer += part
    return answer


def status_of(server: SurveyServer, path: str = "/", **headers: str) -> int:
    host, port = server.server_address[:2]
    connection = http.client.HTTPConnection(str(host), port, timeout=20)
    try:
        connection.request("GET", path, headers=headers)
        return connection.getresponse().status
    finally:
        connection.close()


@pytest.mark.parametrize(
    "request_line",
    [
        b"GET http://[ HTTP/1.1",
        b"GET //[/points.json HTTP/1.1",
        b"POST http://[ HTTP/1.1",
        b"GET /point/%FF HTTP/1.1",
        b"POST /point/%FF/photos HTTP/1.1",
        b"GET / HTTP/9",
        b"GET",
        b"GET /",
        b"\x00\xff\x16\x03\x01",
        b"GET / HTTP/1.1 more",
        b"",
    ],
)
def test_a_malformed_request_prints_nothing(
    request_line: bytes, server: SurveyServer, lines: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    answer = sent(server, request_line + b"\r\nHost: localhost\r\n\r\n")
    # 404: Python shortens "//" at the begin of a path.
    expected = b"HTTP/1.0 404 " if b"//[" in request_line[:7] else b"HTTP/1.0 400 "
    assert answer.startswith(expected) if request_line else answer == b""
    assert status_of(server) == 200, "it goes on"
    assert capfd.readouterr() == ("", "")
    assert lines == []


def test_an_error_in_a_request_is_one_line_for_the_owner(
    server: SurveyServer,
    lines: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    def fail() -> None:
        raise RuntimeError("a bug")

    monkeypatch.setattr(server, "rows", fail)
    assert sent(server, b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n") == b""
    assert lines == ["request of 127.0.0.1: RuntimeError: a bug"]
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("localhost", 200),
        ("LOCALHOST:9000", 200),
        ("127.0.0.1:8765", 200),
        ("[::1]:8765", 200),
        ("evil.example", 403),
        ("evil.example:8765", 403),
        ("127.0.0.1.evil.example", 403),
        ("localhost@evil.example", 403),
        ("192.168.1.7:8765", 403),
        ("", 403),
    ],
)
def test_on_this_computer_only_its_own_names_are_answered(
    host: str, status: int, server: SurveyServer
) -> None:
    assert status_of(server, "/points.json", Host=host) == status


@pytest.mark.parametrize("host", ["localhost:8765", "office:8765"])
@pytest.mark.parametrize(
    ("origin", "own"),
    [("http://{}", True), ("http://evil.example", False), ("https://{}", False), ("null", False)],
)
def test_a_page_of_another_site_is_not_answered(
    host: str, origin: str, own: bool, server: SurveyServer
) -> None:
    server.only_this_computer = host.startswith("localhost")
    sender = origin.replace("{}", host)
    assert status_of(server, "/points.json", Host=host, Origin=sender) == (200 if own else 403)


def test_without_a_host_nothing_is_shown(server: SurveyServer) -> None:
    assert sent(server, b"GET /points.json HTTP/1.0\r\n\r\n").startswith(b"HTTP/1.0 403 ")


def test_a_client_that_guesses_is_locked_out_alone_and_the_owner_is_told(
    server: SurveyServer, lines: list[str]
) -> None:
    server.code, server.needs_code = CODE, True
    for _ in range(MAX_WRONG_PER_CLIENT - 1):
        assert server.let_in("00000000", "10.0.0.5") is None
    assert lines == []
    for _ in range(3):
        assert server.let_in("00000000", "10.0.0.5") is None
    (line,) = lines
    assert "client 10.0.0.5: 10 wrong codes, it gets no more access" in line
    assert "end with ctrl+c and start again" in line
    assert server.let_in(CODE, "10.0.0.5") is None
    assert server.let_in(CODE, "::ffff:10.0.0.5") is None, "the same client over IPv6"
    assert server.let_in(CODE, "10.0.0.6") is not None


def test_addresses_of_one_network_of_ipv6_are_one_client(server: SurveyServer) -> None:
    server.code, server.needs_code = CODE, True
    for number in range(MAX_WRONG_PER_CLIENT):
        assert server.let_in("00000000", f"2001:db8::{number}") is None
    assert server.let_in(CODE, "2001:db8::ffff") is None
    assert server.let_in(CODE, "2001:db8:0:1::1") is not None


def test_guesses_from_many_addresses_come_to_an_end(server: SurveyServer, lines: list[str]) -> None:
    server.code, server.needs_code = CODE, True
    for number in range(MAX_WRONG_CODES):
        assert server.let_in("00000000", f"10.0.{number % 250}.1") is None
    assert server.let_in(CODE, "10.1.0.1") is None
    assert "1000 wrong codes" in lines[-1]
    assert "start again for a new code" in lines[-1]


def test_a_locked_browser_reads_why(server: SurveyServer) -> None:
    server.code, server.needs_code = CODE, True
    tries = [status_of(server, "/?code=00000000") for _ in range(MAX_WRONG_PER_CLIENT)]
    assert tries == [403] * (MAX_WRONG_PER_CLIENT - 1) + [429]
    assert status_of(server, f"/?code={CODE}") == 429


def test_ipv6_of_this_computer_needs_no_code(survey: Path, lines: list[str]) -> None:
    if not socket.has_ipv6:
        pytest.skip("no IPv6 on this computer")
    with serving(survey, "::1", lines) as server:
        assert server.url.startswith("http://[::1]:")
        assert not server.needs_code
        assert status_of(server) == 200


def test_an_address_that_is_taken_is_one_line(survey: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(SurveyError, match=rf"--serve 127\.0\.0\.1:{port}: .*Choose another"):
            SurveyServer(OpenedSurvey(survey), "127.0.0.1", port)
    with pytest.raises(SurveyError, match=r"--serve 203\.0\.113\.1:8765: .*an address of this"):
        SurveyServer(OpenedSurvey(survey), "203.0.113.1", 8765)
