"""The page for a browser against hostile clients."""

import socket
from pathlib import Path

import pytest

from pfwd.errors import SurveyError
from tests.tui.page.conftest import Browser, serving
from tui.page.server import MAX_WRONG_CODES, MAX_WRONG_PER_CLIENT, SurveyServer
from tui.screen.opened.rows import OpenedSurvey

CODE = "12345678"


@pytest.fixture
def coded_server(browser: Browser) -> SurveyServer:
    """A server that needs a code."""
    browser.server.code, browser.server.needs_code = CODE, True
    return browser.server


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
def test_a_malformed_request_prints_no_line(
    request_line: bytes, browser: Browser, capfd: pytest.CaptureFixture[str]
) -> None:
    response = browser.send(request_line + b"\r\nHost: localhost\r\n\r\n")
    # 404: Python shortens "//" at the beginning of a path.
    expected = b"HTTP/1.0 404 " if b"//[" in request_line[:7] else b"HTTP/1.0 400 "
    assert response.startswith(expected) if request_line else response == b""
    assert browser.status() == 200, "the server goes on"
    assert capfd.readouterr() == ("", "")
    assert browser.lines == []


def test_an_error_in_a_request_is_a_single_line_for_the_owner(
    browser: Browser, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def fail() -> None:
        raise RuntimeError("a bug")

    monkeypatch.setattr(browser.server, "rows", fail)
    assert browser.send(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n") == b""
    assert browser.lines == ["request of 127.0.0.1: RuntimeError: a bug"]
    assert capfd.readouterr() == ("", "")


def test_only_names_of_this_computer_are_accepted(browser: Browser) -> None:
    for host in ("localhost", "LOCALHOST:9000", "127.0.0.1:8765", "[::1]:8765"):
        assert browser.status("/points.json", Host=host) == 200, host
    for host in (
        "evil.example",
        "evil.example:8765",
        "127.0.0.1.evil.example",
        "localhost@evil.example",
        "192.168.1.7:8765",
        "",
    ):
        assert browser.status("/points.json", Host=host) == 403, host
    assert browser.send(b"GET /points.json HTTP/1.0\r\n\r\n").startswith(b"HTTP/1.0 403 ")


@pytest.mark.parametrize("host", ["localhost:8765", "office:8765"])
def test_a_page_of_another_site_is_refused(host: str, browser: Browser) -> None:
    browser.server.only_this_computer = host.startswith("localhost")
    for origin, status in (
        (f"http://{host}", 200),
        ("http://evil.example", 403),
        (f"https://{host}", 403),
        ("null", 403),
    ):
        assert browser.status("/points.json", Host=host, Origin=origin) == status, origin


def test_a_client_that_guesses_is_locked_out_and_reported(
    coded_server: SurveyServer, browser: Browser
) -> None:
    for _ in range(MAX_WRONG_PER_CLIENT - 1):
        assert coded_server.let_in("00000000", "10.0.0.5") is None
    assert browser.lines == []
    for _ in range(3):
        assert coded_server.let_in("00000000", "10.0.0.5") is None
    (line,) = browser.lines
    assert "client 10.0.0.5: 10 wrong codes, it gets no more access" in line
    assert coded_server.let_in(CODE, "10.0.0.5") is None
    assert coded_server.let_in(CODE, "::ffff:10.0.0.5") is None, "the same client over IPv6"
    assert coded_server.let_in(CODE, "10.0.0.6") is not None


def test_addresses_of_a_network_of_ipv6_are_a_single_client(coded_server: SurveyServer) -> None:
    for number in range(MAX_WRONG_PER_CLIENT):
        assert coded_server.let_in("00000000", f"2001:db8::{number}") is None
    assert coded_server.let_in(CODE, "2001:db8::ffff") is None
    assert coded_server.let_in(CODE, "2001:db8:0:1::1") is not None


def test_guesses_from_different_addresses_are_limited(
    coded_server: SurveyServer, browser: Browser
) -> None:
    for number in range(MAX_WRONG_CODES):
        assert coded_server.let_in("00000000", f"10.0.{number % 250}.1") is None
    assert coded_server.let_in(CODE, "10.1.0.1") is None
    assert "1000 wrong codes" in browser.lines[-1]


def test_a_locked_browser_has_a_separate_status(
    coded_server: SurveyServer, browser: Browser
) -> None:
    assert coded_server.needs_code
    tries = [browser.status("/?code=00000000") for _ in range(MAX_WRONG_PER_CLIENT)]
    assert tries == [403] * (MAX_WRONG_PER_CLIENT - 1) + [429]
    assert browser.status(f"/?code={CODE}") == 429


@pytest.mark.skipif(not socket.has_ipv6, reason="no IPv6 on this computer")
def test_ipv6_of_this_computer_needs_no_code(survey: Path) -> None:
    with serving(survey, "::1") as browser:
        assert browser.server.url.startswith("http://[::1]:")
        assert not browser.server.needs_code
        assert browser.status() == 200


def test_an_address_in_use_is_refused(survey: Path) -> None:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        port = listener.getsockname()[1]
        with pytest.raises(SurveyError, match=rf"--serve 127\.0\.0\.1:{port}: .*Choose another"):
            SurveyServer(OpenedSurvey(survey), "127.0.0.1", port)
    with pytest.raises(SurveyError, match=r"--serve 203\.0\.113\.1:8765: .*an address of this"):
        SurveyServer(OpenedSurvey(survey), "203.0.113.1", 8765)
