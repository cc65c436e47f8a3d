"""A survey that is served to a browser."""

import http.client
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from tests.tui.surveys import write_small_survey
from tui.page.pages import Photos
from tui.page.server import SurveyServer
from tui.screen.opened.rows import OpenedSurvey

HOSTILE = "<script>alert('x')</script>"
NAMES = ("P 1/2", HOSTILE, "点 3")


@dataclass
class Browser:
    """Requests to a server, and the lines that its owner reads."""

    server: SurveyServer
    lines: list[str] = field(default_factory=list)

    def request(
        self, method: str, path: str, body: bytes | None = None, **headers: str
    ) -> tuple[int, bytes, Any]:
        host, port = self.server.server_address[:2]
        connection = http.client.HTTPConnection(str(host), port, timeout=20)
        try:
            connection.request(method, path, body, headers)
            response = connection.getresponse()
            return response.status, response.read(), response.headers
        finally:
            connection.close()

    def status(self, path: str = "/", **headers: str) -> int:
        return self.request("GET", path, **headers)[0]

    def text(self, path: str) -> str:
        status, body, _ = self.request("GET", path)
        assert status == 200
        return body.decode()

    def send(self, request: bytes) -> bytes:
        """Send bytes and return the complete response."""
        host, port = self.server.server_address[:2]
        with socket.create_connection((str(host), port), timeout=20) as connection:
            connection.sendall(request)
            connection.shutdown(socket.SHUT_WR)
            response = b""
            while part := connection.recv(65536):
                response += part
        return response

    def upload(self, path: str, *files: bytes, **headers: str) -> tuple[int, str]:
        mark = "----mark"
        body = b""
        for count, file in enumerate(files):
            disposition = f'form-data; name="photo"; filename="p{count}.jpg"'
            head = f"--{mark}\r\nContent-Disposition: {disposition}\r\n"
            body += f"{head}Content-Type: image/jpeg\r\n\r\n".encode() + file + b"\r\n"
        body += f"--{mark}--\r\n".encode()
        origin = self.server.url.rstrip("/")
        form = {"Origin": origin, "Content-Type": f"multipart/form-data; boundary={mark}"}
        status, response, _ = self.request("POST", path, body, **(form | headers))
        return status, response.decode()


@pytest.fixture
def survey(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PFWD_CACHE", str(tmp_path / "cache"))
    return write_small_survey(
        tmp_path / "road", *NAMES, latitude=48.0, longitude=9.0, plate_radius_m=0.15
    )


@contextmanager
def serving(
    survey: Path, host: str = "127.0.0.1", photos: Photos | None = None
) -> Iterator[Browser]:
    lines: list[str] = []
    with SurveyServer(OpenedSurvey(survey), host, 0, lines.append, photos=photos) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
        thread.start()
        yield Browser(server, lines)
        server.shutdown()
        thread.join()


@pytest.fixture
def browser(survey: Path, request: pytest.FixtureRequest) -> Iterator[Browser]:
    with serving(survey, photos=getattr(request, "param", "strip")) as browser:
        yield browser
