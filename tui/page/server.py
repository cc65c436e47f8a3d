"""Server that shows a survey as pages in a browser, for instance of a phone or tablet.

It serves the pages, their data and photos of the points, and no other files. The only input are
photos, if the owner of the survey allows them. A browser of another computer needs a code once: it
gets a cookie, and the code is not valid any more.

A page of another site could send requests from the user's browser. Therefore requests from pages of
another origin are refused. On this computer, where no code is needed, the request must also be
addressed to a name of this computer, because another site's name could resolve to its address.
"""

import contextlib
import hmac
import json
import logging
import os
import re
import secrets
import socket
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import IPv6Address, ip_address
from typing import IO, Any
from urllib.parse import SplitResult, parse_qs, urlsplit

from pfwd.errors import DeviceError, OptionError, SurveyError, refusal
from pfwd.files.photos import MAX_PHOTO_BYTES, photos_of, store_photo
from tui.page.pages import (
    FORM,
    PICTURE_NAMES,
    Photos,
    draw_overview_picture,
    overview_page,
    parse_point_address,
    plain_row,
    point_address,
    point_page,
)
from tui.screen.opened.rows import OpenedSurvey, PointRow

HOST, PORT = "127.0.0.1", 8765

CODE_DIGITS = 8
"""Digits of a code: of a hundred million codes a client may try `MAX_WRONG_PER_CLIENT`."""

MAX_WRONG_PER_CLIENT = 10
"""Number of wrong codes after which a client gets no access; other clients still do."""

MAX_WRONG_CODES = 1000
"""Number of wrong codes of all clients together after which no client gets access: one of 100,000
attackers would guess the code."""

_PLACE = re.compile(r"(?:\[(?P<six>[^\[\]]+)\]|(?P<name>[^:\[\]]*))(?::(?P<port>[0-9]{1,5}))?")

MAX_UPLOAD_BYTES = 5 * MAX_PHOTO_BYTES
"""Largest size of an upload, which may hold several photos."""

MAX_UPLOAD_S = 300.0
"""Longest time of an upload; the largest one needs a connection of 3 Mbit/s."""

UPLOAD_WAIT_S = 20.0
"""Time for which an upload waits for the end of another one."""

_CLOSE_S = 5.0
"""Time for which a client may still send after the response. If the connection were closed at once,
a browser would show an error of the connection in place of the response."""

_PHOTO_TYPES = {".jpg": "image/jpeg", ".png": "image/png"}


def parse_place(text: str | None) -> tuple[str, int]:
    """Return host and port of a text such as ``0.0.0.0:8765``; both may be missing.

    Raises
    ------
    OptionError
        If the text is no host and port.
    """
    if not text:
        return HOST, PORT
    if text.isascii() and text.isdigit():
        text = f":{text}"
    elif _is_ipv6(text):
        text = f"[{text}]"
    parts = _PLACE.fullmatch(text)
    port = PORT if parts is None or parts["port"] is None else int(parts["port"])
    if parts is None or port > 65_535 or (parts["six"] and not _is_ipv6(parts["six"])):
        raise OptionError(
            refusal("--serve", "HOST:PORT, as 0.0.0.0:8765 or [::1]:8765", repr(text))
        )
    return parts["six"] or parts["name"] or HOST, port


def _is_ipv6(text: str) -> bool:
    try:
        IPv6Address(text)
    except ValueError:
        return False
    return True


def is_local(host: str) -> bool:
    """Return whether a host is this computer's own address, which no other computer can reach."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


class SurveyServer(ThreadingHTTPServer):
    """HTTP server of one survey.

    Parameters
    ----------
    survey : OpenedSurvey
    host : str
    port : int
        0: any free port.
    report : callable, optional
        Receives a line for the owner when a client is refused or a request fails.
    photos : {"keep", "strip"}, optional
        Photos of points are accepted, and the position in them is kept or removed. None: no photos
        are accepted.

    Raises
    ------
    SurveyError
        If the address cannot be used.
    """

    daemon_threads = True
    # On Windows True would let a second program use the same port.
    allow_reuse_address = os.name != "nt"

    def __init__(
        self,
        survey: OpenedSurvey,
        host: str,
        port: int,
        report: Callable[[str], None] = lambda _text: None,
        photos: Photos | None = None,
    ) -> None:
        self.survey = survey
        self.folder = os.fspath(survey.folder)
        self.photos = photos
        self.report = report
        digits = (secrets.choice("0123456789") for _ in range(CODE_DIGITS))
        self.code = "" if is_local(host) else "".join(digits)
        """Code that gives one browser access; empty: no code is needed, or it was used."""
        self.needs_code = bool(self.code)
        self.only_this_computer = is_local(host)
        self._token = ""
        self._wrong: Counter[str] = Counter()
        self._lock = threading.Lock()
        self.uploading = threading.Lock()
        """Lock for uploads: one at a time is received, decoded and stored."""
        self.drawing = threading.Lock()
        """Lock for drawing, because matplotlib's settings are shared by all threads."""
        self._pictures: dict[str, str] = {}
        self._pictures_of: list[PointRow] = []
        if ":" in host:
            self.address_family = socket.AF_INET6
        try:
            super().__init__((host, port), _Handler)
        except OSError as err:
            where = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
            reason = err.strerror or str(err)
            hint = "Choose another port, or an address of this computer"
            raise SurveyError(f"--serve {where}: {reason}. {hint}") from err

    @property
    def url(self) -> str:
        """URL of the overview page."""
        host, port = self.server_address[:2]
        name = f"[{host!s}]" if ":" in str(host) else str(host)
        return f"http://{name}:{port}/"

    def let_in(self, code: str, client: str) -> str | None:
        """Return an access token for a code.

        Parameters
        ----------
        code : str
        client : str
            IP address. Wrong codes are counted for each address, with IPv6 for each network of 64
            bits.

        Returns
        -------
        str or None
            None: the code is wrong or was used, or the client has tried too many.
        """
        with self._lock:
            network = _network(client)
            if not self.code or self.is_locked(client):
                return None
            if hmac.compare_digest(code.encode(), self.code.encode()):
                self.code, self._token = "", secrets.token_urlsafe(32)
                return self._token
            self._wrong[network] += 1
            if self._wrong.total() >= MAX_WRONG_CODES:
                self.report(
                    f"{MAX_WRONG_CODES} wrong codes, the last from {client}: no browser gets "
                    "access any more. End with ctrl+c and start again for a new code"
                )
            elif self._wrong[network] >= MAX_WRONG_PER_CLIENT:
                self.report(
                    f"client {client}: {MAX_WRONG_PER_CLIENT} wrong codes, it gets no more access; "
                    "others do. If it is yours, end with ctrl+c and start again"
                )
            return None

    def is_locked(self, client: str) -> bool:
        """Return whether a client gets no access because of wrong codes, its own or those of all
        clients.
        """
        wrong = self._wrong
        return wrong[_network(client)] >= MAX_WRONG_PER_CLIENT or wrong.total() >= MAX_WRONG_CODES

    def answers_to(self, host: str) -> bool:
        """Return whether requests with this ``Host`` header are answered."""
        return not self.only_this_computer or is_local(_host_name(host))

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Report a failed request to the owner as one line, unless the client closed the
        connection.
        """
        error = sys.exception()
        if not isinstance(error, OSError):
            self.report(f"request of {client_address[0]}: {type(error).__name__}: {error}")

    def is_valid(self, token: str) -> bool:
        """Return whether an access token is valid."""
        valid = self._token
        return bool(valid) and hmac.compare_digest(token.encode(), valid.encode())

    def draw(self, name: str) -> str:
        """Return a picture of all points as SVG; it is drawn again only if points have changed."""
        rows = self.rows()
        with self.drawing:
            if self._pictures_of != rows:
                self._pictures, self._pictures_of = {}, rows
            if name not in self._pictures:
                self._pictures[name] = draw_overview_picture(self.folder, name)
            return self._pictures[name]

    def rows(self) -> list[PointRow]:
        """Return the points as they are in the survey now."""
        with self._lock:
            if self.survey.from_cache() is None:
                self.survey.read()
                self.survey.judge(lambda _rows: None)
            return list(self.survey.rows)


def _network(client: str) -> str:
    """Return the IP address, or the IPv6 network of 64 bits, for which wrong codes are counted."""
    try:
        address = ip_address(client.partition("%")[0])
    except ValueError:
        return client
    if isinstance(address, IPv6Address) and address.ipv4_mapped is None:
        return address.exploded[:19]
    return str(getattr(address, "ipv4_mapped", None) or address)


def _host_name(host: str) -> str:
    """Return the host in a ``Host`` header, without port and brackets; empty: the header is
    invalid.
    """
    parts = _PLACE.fullmatch(host)
    return "" if parts is None else parts["six"] or parts["name"]


_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data:; form-action 'self'; "
    "frame-ancestors 'none'; base-uri 'none'"
)
"""Content security policy of all pages: no scripts, and nothing from other servers."""


def _store_parts(content_type: str, body: Iterable[bytes], file: IO[bytes]) -> list[int]:
    """Write the files in an uploaded form one after the other into a file, and return their sizes.

    Raises
    ------
    OptionError
        If the data are no form, the form has no file, or one that is too large.
    """
    from python_multipart.multipart import MultipartParser, parse_options_header

    # The parser logs malformed forms, and Python prints such lines in the terminal.
    logging.getLogger("python_multipart").setLevel(logging.CRITICAL)
    sizes: list[int] = []

    def write(data: bytes, start: int, end: int) -> None:
        sizes[-1] += file.write(data[start:end])
        if sizes[-1] > MAX_PHOTO_BYTES:
            raise ValueError(f"a picture of more than {MAX_PHOTO_BYTES / 1e6:.0f} MB")

    try:
        kind, options = parse_options_header(content_type)
        if kind != b"multipart/form-data" or not options.get(b"boundary"):
            raise ValueError(f"content of the type {content_type!r}")
        calls: Any = {"on_part_begin": lambda: sizes.append(0), "on_part_data": write}
        parser = MultipartParser(options[b"boundary"], calls)
        for part in body:
            parser.write(part)
        parser.finalize()
    except ValueError as err:
        raise OptionError(refusal("upload", "a form with pictures", str(err))) from err
    sizes = [size for size in sizes if size]  # a form without a chosen file sends an empty one
    if not sizes:
        raise OptionError("No picture was chosen. Go back and choose one.")
    return sizes


class _Handler(BaseHTTPRequestHandler):
    server: SurveyServer
    server_version, sys_version = "pfwd", ""
    # For a request without a version Python's default is HTTP/0.9, whose responses have no status.
    default_request_version = "none"
    timeout = 20

    def do_GET(self) -> None:
        """Answer the request for a page or for data."""
        place = self._place()
        if place is None:
            return
        where, point, rest = place
        if not self._is_same_origin():
            self._answer(HTTPStatus.FORBIDDEN, f"Open {self.server.url}", "text/plain")
            return
        if self.server.needs_code and not self._has_access():
            code = (parse_qs(where.query).get("code") or [""])[0]
            client = str(self.client_address[0])
            token = self.server.let_in(code, client) if code else None
            if token is None:
                if self.server.is_locked(client):
                    text = "Too many wrong codes. Ask the person who started this server."
                    self._answer(HTTPStatus.TOO_MANY_REQUESTS, text, "text/plain")
                else:
                    self._answer(HTTPStatus.FORBIDDEN, FORM, "text/html")
                return
            self.send_response(HTTPStatus.SEE_OTHER)
            self.send_header("Set-Cookie", f"pfwd={token}; HttpOnly; SameSite=Strict; Path=/")
            self.send_header("Location", "/")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        self._send_page(where.path, point, rest)

    def _place(self) -> tuple[SplitResult, str, str] | None:
        """Return the requested address, with point and rest of its path; None: the request is
        malformed, and that was answered.
        """
        try:
            if self.request_version == self.default_request_version:
                raise ValueError("a request without a version")
            where = urlsplit(self.path)
            return where, *parse_point_address(where.path)
        except ValueError:
            self._answer(HTTPStatus.BAD_REQUEST, "Malformed request.", "text/plain")
            return None

    def _send_page(self, path: str, point: str, rest: str) -> None:
        server = self.server
        try:
            rows = server.rows()
            row = next((row for row in rows if row.name == point), None)
            if path == "/":
                title = server.survey.folder.resolve().name
                self._answer(HTTPStatus.OK, overview_page(server.folder, title, rows), "text/html")
            elif path == "/points.json":
                data = json.dumps([plain_row(row) for row in rows])
                self._answer(HTTPStatus.OK, data, "application/json")
            elif path in [f"/{name}.svg" for name in PICTURE_NAMES]:
                self._answer(HTTPStatus.OK, server.draw(path[1:-4]), "image/svg+xml")
            elif row is not None and rest == "":
                with server.drawing:
                    text = point_page(server.folder, row, rows, server.photos)
                self._answer(HTTPStatus.OK, text, "text/html")
            elif row is not None and rest.startswith("photos/"):
                self._send_photo(row.name, rest.removeprefix("photos/"))
            else:
                self._answer(HTTPStatus.NOT_FOUND, "Not found.", "text/plain")
        except (SurveyError, DeviceError, OSError) as err:
            self._answer(HTTPStatus.INTERNAL_SERVER_ERROR, str(err), "text/plain")

    def _send_photo(self, point: str, name: str) -> None:
        # The name must be one of the point's photos, so that no other file can be requested.
        files = {photo.name: photo for photo in photos_of(self.server.folder, point)}
        if name not in files:
            self._answer(HTTPStatus.NOT_FOUND, "Not found.", "text/plain")
            return
        kind = _PHOTO_TYPES[files[name].suffix]
        self._answer(HTTPStatus.OK, files[name].read_bytes(), kind)

    def do_POST(self) -> None:
        """Store uploaded photos of a point."""
        self._receive_photos()
        with contextlib.suppress(OSError):
            self.connection.shutdown(socket.SHUT_WR)
            self.connection.settimeout(_CLOSE_S)
            end = time.monotonic() + _CLOSE_S
            while time.monotonic() < end and self.rfile.read1(65536):
                pass

    def _receive_photos(self) -> None:
        place = self._place()
        if place is None:
            return
        _, point, rest = place
        size = self.headers.get("Content-Length")
        # Every browser sends the origin of a form.
        if not self._is_same_origin() or self.headers.get("Origin") is None:
            self._answer(HTTPStatus.FORBIDDEN, f"Open {self.server.url}", "text/plain")
        elif self.server.needs_code and not self._has_access():
            self._answer(HTTPStatus.FORBIDDEN, FORM, "text/html")
        elif self.server.photos is None or rest != "photos":
            self._answer(HTTPStatus.NOT_FOUND, "Not found.", "text/plain")
        elif size is None:
            self._answer(HTTPStatus.LENGTH_REQUIRED, "Content-Length is missing.", "text/plain")
        elif not re.fullmatch("[0-9]+", size):
            self._answer(HTTPStatus.BAD_REQUEST, "Content-Length is no number.", "text/plain")
        elif len(size) > 18 or int(size) > MAX_UPLOAD_BYTES:
            text = f"Send at most {MAX_UPLOAD_BYTES / 1e6:.0f} MB at once."
            self._answer(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, text, "text/plain")
        elif not self.server.uploading.acquire(timeout=UPLOAD_WAIT_S):
            text = "Another upload is running. Go back and send the pictures again."
            self._answer(HTTPStatus.SERVICE_UNAVAILABLE, text, "text/plain")
        else:
            try:
                self._store_photos(point, int(size))
            finally:
                self.server.uploading.release()

    def _store_photos(self, point: str, size: int) -> None:
        server = self.server
        try:
            if point not in (row.name for row in server.rows()):
                self._answer(HTTPStatus.NOT_FOUND, "Not found.", "text/plain")
                return
            kind, keep = self.headers.get("Content-Type", ""), server.photos == "keep"
            with tempfile.TemporaryFile() as file:
                sizes = _store_parts(kind, self._body(size), file)
                file.seek(0)
                for picture in map(file.read, sizes):
                    stored = store_photo(server.folder, point, picture, keep_position=keep)
                    server.report(f"picture of {point}: {stored.name}")
        except (OptionError, SurveyError) as err:
            self._answer(HTTPStatus.BAD_REQUEST, str(err), "text/plain")
            return
        self.send_response(HTTPStatus.SEE_OTHER)
        self.send_header("Location", point_address(point))
        self.send_header("Content-Length", "0")
        self.end_headers()

    def _body(self, size: int) -> Iterator[bytes]:
        end = time.monotonic() + MAX_UPLOAD_S
        while size > 0 and (part := self.rfile.read1(min(size, 1 << 16))):
            size -= len(part)
            yield part
            if time.monotonic() > end:
                raise ValueError(f"no end of it within {MAX_UPLOAD_S / 60:.0f} minutes")
        if size > 0:
            raise ValueError(f"{size} bytes less than announced")

    def do_HEAD(self) -> None:
        """Answer the request for the header of a page."""
        self.do_GET()

    def _is_same_origin(self) -> bool:
        """Return whether a request is addressed to this server and not sent by a page of another
        site.
        """
        host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
        return self.server.answers_to(host) and origin in (None, f"http://{host}")

    def _has_access(self) -> bool:
        try:
            cookies = SimpleCookie(self.headers.get("Cookie", ""))
        except CookieError:
            return False
        cookie = cookies.get("pfwd")
        return cookie is not None and self.server.is_valid(cookie.value)

    def _answer(self, status: HTTPStatus, content: str | bytes, kind: str) -> None:
        data = content.encode() if isinstance(content, str) else content
        self.send_response(status)
        charset = "; charset=utf-8" if isinstance(content, str) else ""
        self.send_header("Content-Type", f"{kind}{charset}")
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Content-Security-Policy", _POLICY)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing, so that the URL stays visible in the terminal."""
