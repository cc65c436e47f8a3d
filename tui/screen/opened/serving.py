"""The points of a survey as a page for a browser: read only, for a phone or a tablet beside it.

Nothing but one page, its data and nothing of the disk. Away from this computer only who knows the
code is let in, once: the browser that used it keeps a cookie, and the code is void from then on.

A page of another site may send requests from the reader's own browser. On this computer, where no
code is needed, only requests to a name of this computer are answered (the site may have its name
lead here), and everywhere only those that no page of another origin has sent.
"""

import hmac
import html
import json
import os
import re
import secrets
import socket
import sys
import threading
from collections import Counter
from collections.abc import Callable
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import IPv6Address, ip_address
from typing import Any
from urllib.parse import parse_qs, urlsplit

from pfwd.errors import DeviceError, OptionError, SurveyError, refusal
from pfwd.judging.job import target_text
from tui.screen.opened.rows import OpenedSurvey, PointRow, shares, shown_value
from tui.screen.units import figures

HOST, PORT = "127.0.0.1", 8765

CODE_DIGITS = 8
"""A hundred million of them, and `MOST_WRONG` may be tried."""

MOST_WRONG = 10
"""Wrong codes of one client until it is let in no more; the others still are."""

MOST_WRONG_IN_ALL = 1000
"""Wrong codes of all clients until no one is let in any more: one in 100,000 guesses so many."""

_PLACE = re.compile(r"(?:\[(?P<six>[^\[\]]+)\]|(?P<name>[^:\[\]]*))(?::(?P<port>[0-9]{1,5}))?")

_COLOURS = {"PASS": "#004d12", "FAIL": "#8f0000", "UNDECIDED": "#6b3d00"}


def parse_place(text: str | None) -> tuple[str, int]:
    """Host and port of HOST:PORT; what is not said is 127.0.0.1 and 8765.

    Raises
    ------
    OptionError
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


def is_here(host: str) -> bool:
    """Whether only this computer can reach a host."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def _code() -> str:
    return "".join(secrets.choice("0123456789") for _ in range(CODE_DIGITS))


class SurveyServer(ThreadingHTTPServer):
    """Serves one survey.

    Parameters
    ----------
    survey : OpenedSurvey
    host : str
    port : int
        0: a free one.
    tell : callable, optional
        Receives one line for the owner when a client is refused or a request fails.

    Raises
    ------
    SurveyError
        If the address cannot be used.
    """

    daemon_threads = True
    # On Windows a second program could then take a port that is in use.
    allow_reuse_address = os.name != "nt"

    def __init__(
        self,
        survey: OpenedSurvey,
        host: str,
        port: int,
        tell: Callable[[str], None] = lambda _text: None,
    ) -> None:
        self.survey = survey
        self._tell = tell
        self.code = "" if is_here(host) else _code()
        """Lets one browser in; empty: none is needed, or it was used."""
        self.needs_code = bool(self.code)
        self.only_here = is_here(host)
        self._token = ""
        self._wrong: Counter[str] = Counter()
        self._lock = threading.Lock()
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
        """Where it is."""
        host, port = self.server_address[:2]
        shown = str(host)
        return f"http://{f'[{shown}]' if ':' in shown else shown}:{port}/"

    def let_in(self, code: str, client: str) -> str | None:
        """Return the token for a client that sends the code; None: it is wrong, or was used.

        Parameters
        ----------
        code : str
        client : str
            Its address. Wrong codes are counted for each, of IPv6 for each network of 64 bits.
        """
        with self._lock:
            network = _network(client)
            if not self.code or self.is_locked(client):
                return None
            if hmac.compare_digest(code.encode(), self.code.encode()):
                self.code, self._token = "", secrets.token_urlsafe(32)
                return self._token
            self._wrong[network] += 1
            if self._wrong.total() >= MOST_WRONG_IN_ALL:
                self._tell(
                    f"{MOST_WRONG_IN_ALL} wrong codes, the last of {client}: no browser is let in "
                    "any more. End with ctrl+c and start again for a new code"
                )
            elif self._wrong[network] >= MOST_WRONG:
                self._tell(
                    f"client {client}: {MOST_WRONG} wrong codes, it is let in no more; others are. "
                    "If it is yours, end with ctrl+c and start again"
                )
            return None

    def is_locked(self, client: str) -> bool:
        """Whether a client is let in no more, for its wrong codes or for those of all."""
        wrong = self._wrong
        return wrong[_network(client)] >= MOST_WRONG or wrong.total() >= MOST_WRONG_IN_ALL

    def answers_to(self, host: str) -> bool:
        """Whether a request to this name, a ``Host`` header, may be answered."""
        return not self.only_here or is_here(_host_name(host))

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Tell the owner in one line what a request failed of; one that was cut says nothing."""
        error = sys.exception()
        if not isinstance(error, OSError):
            self._tell(f"request of {client_address[0]}: {type(error).__name__}: {error}")

    def knows(self, token: str) -> bool:
        """Whether a browser was let in."""
        known = self._token
        return bool(known) and hmac.compare_digest(token.encode(), known.encode())

    def rows(self) -> list[PointRow]:
        """The points as they are on the disk now."""
        with self._lock:
            if self.survey.from_cache() is None:
                self.survey.read()
                self.survey.judge(lambda _rows: None)
            return list(self.survey.rows)


def _network(client: str) -> str:
    """Return what wrong codes are counted for: an address, or the 64 bits of a network of IPv6."""
    try:
        address = ip_address(client.partition("%")[0])
    except ValueError:
        return client
    if isinstance(address, IPv6Address) and address.ipv4_mapped is None:
        return address.exploded[:19]
    return str(getattr(address, "ipv4_mapped", None) or address)


def _host_name(host: str) -> str:
    """Return the name of a ``Host`` header, without port and brackets; empty: it is none."""
    parts = _PLACE.fullmatch(host)
    return "" if parts is None else parts["six"] or parts["name"]


class _Handler(BaseHTTPRequestHandler):
    server: SurveyServer
    server_version, sys_version = "pfwd", ""
    timeout = 20

    def do_GET(self) -> None:
        """The page, or its data."""
        try:
            where = urlsplit(self.path)
        except ValueError:
            self._answer(HTTPStatus.BAD_REQUEST, "not an address", "text/plain")
            return
        if not self._is_own():
            self._answer(HTTPStatus.FORBIDDEN, f"Open {self.server.url}", "text/plain")
            return
        if self.server.needs_code and not self._is_known():
            code = (parse_qs(where.query).get("code") or [""])[0]
            client = str(self.client_address[0])
            token = self.server.let_in(code, client) if code else None
            if token is None:
                if self.server.is_locked(client):
                    text = "Too many wrong codes. Whoever started this page sees what to do."
                    self._answer(HTTPStatus.TOO_MANY_REQUESTS, text, "text/plain")
                else:
                    self._answer(HTTPStatus.FORBIDDEN, _FORM, "text/html")
                return
            self.send_response(HTTPStatus.SEE_OTHER)
            self.send_header("Set-Cookie", f"pfwd={token}; HttpOnly; SameSite=Strict; Path=/")
            self.send_header("Location", "/")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        if where.path not in ("/", "/points.json"):
            self._answer(HTTPStatus.NOT_FOUND, "not there", "text/plain")
            return
        try:
            rows = self.server.rows()
        except (SurveyError, DeviceError, OSError) as err:
            self._answer(HTTPStatus.INTERNAL_SERVER_ERROR, str(err), "text/plain")
            return
        if where.path == "/points.json":
            self._answer(
                HTTPStatus.OK, json.dumps([_plain(row) for row in rows]), "application/json"
            )
            return
        self._answer(HTTPStatus.OK, page(self.server.survey.folder.name, rows), "text/html")

    def do_HEAD(self) -> None:
        """The same without its text."""
        self.do_GET()

    def _is_own(self) -> bool:
        """Whether it is sent to this server by its reader, and by no page of another site."""
        host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
        return self.server.answers_to(host) and origin in (None, f"http://{host}")

    def _is_known(self) -> bool:
        try:
            cookies = SimpleCookie(self.headers.get("Cookie", ""))
        except CookieError:
            return False
        said = cookies.get("pfwd")
        return said is not None and self.server.knows(said.value)

    def _answer(self, status: HTTPStatus, text: str, kind: str) -> None:
        data = text.encode()
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Content-Security-Policy", "default-src 'none'; style-src 'unsafe-inline'")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing is printed: the terminal shows the address."""


def _plain(row: PointRow) -> dict[str, Any]:
    return {
        "point": row.title,
        "chainage_m": row.chainage_m,
        "latitude": row.latitude,
        "longitude": row.longitude,
        "quantity": row.quantity,
        "value": row.value,
        "interval": None if row.low is None else [row.low, row.high],
        "unit": row.unit,
        "target": row.target,
        "verdict": row.verdict,
        "drops": row.drops,
        "discarded": row.discarded,
    }


def page(title: str, rows: list[PointRow]) -> str:
    """The points as a page that needs no script."""
    counts = ", ".join(f"{count} {state}" for state, count in shares(rows))
    lines = []
    for row in rows:
        colour = _COLOURS.get(row.state, "#303030")
        unit = "mm" if row.unit == "m" else "MPa"
        value = "-" if row.value is None else f"{figures(shown_value(row))} {unit}"
        target = "-" if row.target is None else target_text(row.target)
        cells = "".join(
            f"<td>{html.escape(text)}</td>" for text in (row.title, value, target, row.notes)
        )
        state = html.escape(row.state)
        lines.append(f'<tr>{cells}<td style="color:{colour};font-weight:bold">{state}</td></tr>')
    return _PAGE.format(title=html.escape(title), counts=html.escape(counts), rows="\n".join(lines))


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="refresh" content="10">
<style>body{{font:18px sans-serif;margin:1em}}table{{border-collapse:collapse;width:100%}}
td,th{{border-bottom:1px solid #999;padding:.4em;text-align:left}}</style></head>
<body><h1>{title}</h1><p>{counts}</p>
<table><tr><th>point</th><th>judged</th><th>target</th><th>notes</th><th>verdict</th></tr>
{rows}
</table></body></html>
"""
_FORM = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>pfwd</title>
<meta name="viewport" content="width=device-width, initial-scale=1"></head>
<body><form><p>Code that the terminal shows: <input name="code" inputmode="numeric" autofocus>
<button>look</button></p></form></body></html>
"""
