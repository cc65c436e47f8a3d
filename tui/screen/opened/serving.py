"""The points of a survey as a page for a browser: read only, for a phone or a tablet beside it.

Nothing but one page, its data and nothing of the disk. Away from this computer only who knows the
code is let in, once: the browser that used it keeps a cookie, and the code is void from then on.
"""

import hmac
import html
import json
import secrets
import threading
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import ip_address
from typing import Any
from urllib.parse import parse_qs, urlsplit

from pfwd_survey.errors import DeviceError, OptionError, SurveyError, refusal
from pfwd_survey.judging.job import target_text
from tui.screen.opened.rows import OpenedSurvey, PointRow, shares, shown_value
from tui.screen.units import figures

HOST, PORT = "127.0.0.1", 8765

CODE_DIGITS = 8
"""A hundred million of them, and `MOST_WRONG` may be tried."""

MOST_WRONG = 10
"""Wrong codes until nobody is let in any more."""

_COLOURS = {"PASS": "#004d12", "FAIL": "#8f0000", "UNDECIDED": "#6b3d00"}


def parse_place(text: str | None) -> tuple[str, int]:
    """Host and port of HOST:PORT; what is not said is 127.0.0.1 and 8765.

    Raises
    ------
    OptionError
    """
    if not text:
        return HOST, PORT
    host, sign, port = text.rpartition(":")
    if not sign:
        host, port = (HOST, text) if text.isdigit() else (text, str(PORT))
    if not port.isdigit() or int(port) > 65_535:
        raise OptionError(refusal("--serve", "HOST:PORT, as 0.0.0.0:8765", repr(text)))
    return host.strip("[]") or HOST, int(port)


def is_here(host: str) -> bool:
    """Whether only this computer can reach a host."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


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
    """

    daemon_threads = True

    def __init__(self, survey: OpenedSurvey, host: str, port: int) -> None:
        self.survey = survey
        self.code = "" if is_here(host) else _code()
        """Lets one browser in; empty: none is needed, or it was used."""
        self.needs_code = bool(self.code)
        self._token = ""
        self._wrong = 0
        self._lock = threading.Lock()
        super().__init__((host, port), _Handler)

    @property
    def url(self) -> str:
        """Where it is."""
        host, port = self.server_address[:2]
        shown = str(host)
        return f"http://{f'[{shown}]' if ':' in shown else shown}:{port}/"

    def let_in(self, code: str) -> str | None:
        """The token for who has said the code; None: it is wrong, or was used."""
        with self._lock:
            if not self.code or self._wrong >= MOST_WRONG:
                return None
            if not hmac.compare_digest(code.encode(), self.code.encode()):
                self._wrong += 1
                return None
            self.code, self._token = "", secrets.token_urlsafe(32)
            return self._token

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


class _Handler(BaseHTTPRequestHandler):
    server: SurveyServer
    server_version, sys_version = "pfwd", ""
    timeout = 20

    def do_GET(self) -> None:
        """The page, or its data."""
        where = urlsplit(self.path)
        if self.server.needs_code and not self._is_known():
            code = (parse_qs(where.query).get("code") or [""])[0]
            token = self.server.let_in(code) if code else None
            if token is None:
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
