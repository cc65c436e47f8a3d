"""The pages of a survey as a browser gets them, and photos that it sends."""

import http.client
import io
import json
import re
import threading
import time
import tracemalloc
import urllib.parse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from pfwd.files.photos import photos_of
from pfwd_device import Drop
from pfwd_device.recording import DropRecord, SurveyWriter
from tui.page import pages
from tui.page.pages import Photos, overview_page, parse_point_address, point_address
from tui.page.server import SurveyServer
from tui.screen.opened.rows import OpenedSurvey

HOSTILE = "<script>alert('x')</script>"
NAMES = ("P 1/2", HOSTILE, "点 3")


@pytest.fixture
def survey(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PFWD_CACHE", str(tmp_path / "cache"))
    with SurveyWriter.open(tmp_path / "road", publish=False) as writer:
        for number, name in enumerate(NAMES):
            declared = {"latitude": 48.0 + number / 1000, "longitude": 9.0, "plate_radius_m": 0.15}
            drop = Drop(1, np.arange(4.0), np.zeros(4), ())
            writer.save_drop(DropRecord(name, drop, declared=declared))
    return tmp_path / "road"


class Browser:
    def __init__(self, server: SurveyServer) -> None:
        self.server = server
        self.origin = server.url.rstrip("/")

    def request(
        self, method: str, path: str, body: bytes | None = None, **headers: str
    ) -> tuple[int, bytes, Any]:
        host, port = self.server.server_address[:2]
        connection = http.client.HTTPConnection(str(host), port, timeout=20)
        try:
            connection.request(method, path, body, headers)
            answer = connection.getresponse()
            return answer.status, answer.read(), answer.headers
        finally:
            connection.close()

    def text(self, path: str) -> str:
        status, body, _ = self.request("GET", path)
        assert status == 200
        return body.decode()

    def upload(self, path: str, *files: bytes, **headers: str) -> tuple[int, str]:
        mark = "----mark"
        parts = [
            f'--{mark}\r\nContent-Disposition: form-data; name="photo"; filename="p{count}.jpg"'
            "\r\nContent-Type: image/jpeg\r\n\r\n".encode()
            + file
            + b"\r\n"
            for count, file in enumerate(files)
        ]
        body = b"".join(parts) + f"--{mark}--\r\n".encode()
        sent = {"Origin": self.origin, "Content-Type": f"multipart/form-data; boundary={mark}"}
        status, answer, _ = self.request("POST", path, body, **(sent | headers))
        return status, answer.decode()


@pytest.fixture
def photos(request: pytest.FixtureRequest) -> Photos | None:
    found: Photos | None = getattr(request, "param", "strip")
    return found


@pytest.fixture
def browser(survey: Path, photos: Photos | None) -> Iterator[Browser]:
    with SurveyServer(OpenedSurvey(survey), "127.0.0.1", 0, photos=photos) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
        thread.start()
        yield Browser(server)
        server.shutdown()
        thread.join()


def photo(colour: str = "red") -> bytes:
    image = Image.new("RGB", (40, 30), colour)
    exif = Image.Exif()
    exif.get_ifd(0x8825)[2] = (48.0, 1.0, 2.0)
    stream = io.BytesIO()
    image.save(stream, "JPEG", exif=exif)
    return stream.getvalue()


@pytest.mark.parametrize("name", [*NAMES, "a?b#c", "..", "%2F", "\ud800"])
def test_an_address_of_a_point_gives_its_name(name: str) -> None:
    path = urllib.parse.urlsplit(point_address(name)).path
    assert parse_point_address(path) == (name, "")
    assert parse_point_address(f"{path}/photos/x.jpg") == (name, "photos/x.jpg")
    assert parse_point_address("/points.json") == ("", "")


def test_the_overview_and_its_data_have_every_point(browser: Browser) -> None:
    assert "3 without a verdict" in browser.text("/")
    rows = json.loads(browser.text("/points.json"))
    assert [(row["point"], row["verdict"]) for row in rows] == [(name, "none") for name in NAMES]


def test_every_point_has_a_page_that_the_overview_leads_to(browser: Browser) -> None:
    links = re.findall(r'href="(/point/[^"]*)"', browser.text("/"))
    assert links == [point_address(name) for name in NAMES]
    for link, name in zip(links, NAMES, strict=True):
        page = browser.text(link)
        assert 'href="/"' in page
        if name != HOSTILE:
            assert f"Point {name}" in page


def test_the_page_of_a_point_leads_to_its_neighbours_and_photos(browser: Browser) -> None:
    first, last = browser.text(point_address(NAMES[0])), browser.text(point_address(NAMES[2]))
    assert 'rel="prev"' not in first
    assert 'rel="next"' in first
    assert f">{NAMES[2]} →<" in browser.text(point_address(NAMES[1]))
    assert f">← {NAMES[0]}<" in browser.text(point_address(NAMES[1]))
    assert 'rel="next"' not in last
    assert 'href="#photos"' in first
    assert 'id="photos"' in first


@pytest.mark.parametrize("marked", [True, False])
def test_a_mark_behind_a_value_is_explained(survey: Path, marked: bool) -> None:
    opened = OpenedSurvey(survey).read()
    rows = [replace(row, value=45e6, unit="Pa", value_marked=marked) for row in opened]
    page = overview_page(str(survey), "road", rows)
    assert bool(re.search(r">45[.0]*\* MPa<", page)) is marked
    assert ("* not supported by the data" in page) is marked


def test_nothing_of_a_survey_is_read_as_markup(browser: Browser) -> None:
    for path in ("/", *map(point_address, NAMES)):
        assert "<script" not in browser.text(path)
    assert "&lt;script&gt;" in browser.text("/")


def test_a_page_may_run_no_script_and_load_from_here_alone(browser: Browser) -> None:
    _, _, headers = browser.request("GET", "/")
    policy = headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; ")
    assert "script" not in policy
    assert "http" not in policy
    addresses = re.findall(r'(?:src|srcset|href|action)="([^"]*)"', browser.text("/"))
    assert addresses
    assert all(address.startswith(("/", "data:")) for address in addresses)


@pytest.mark.parametrize("name", ["map", "map-small", "profile", "profile-small"])
def test_pictures_of_all_points_are_svg(name: str, browser: Browser) -> None:
    status, body, headers = browser.request("GET", f"/{name}.svg")
    assert (status, headers["Content-Type"]) == (200, "image/svg+xml; charset=utf-8")
    assert b"<svg" in body


@pytest.mark.parametrize("path", ["/x.svg", "/point/none", "/point/P%201%2F2/x", "/point"])
def test_other_addresses_are_not_there(path: str, browser: Browser) -> None:
    assert browser.request("GET", path)[0] == 404


def test_a_photo_is_stored_without_its_position_and_shown(browser: Browser, survey: Path) -> None:
    address = point_address(NAMES[0])
    assert browser.upload(f"{address}/photos", photo(), photo("blue")) == (303, "")
    stored = photos_of(survey, NAMES[0])
    assert len(stored) == 2
    page = browser.text(address)
    for file in stored:
        source = f"{address}/photos/{file.name}"
        assert f'src="{source}"' in page
        status, body, headers = browser.request("GET", source)
        assert (status, headers["Content-Type"]) == (200, "image/jpeg")
        with Image.open(io.BytesIO(body)) as image:
            assert image.size == (40, 30)
            assert dict(image.getexif().get_ifd(0x8825)) == {}
    assert "2 photos" in browser.text("/")
    assert photos_of(survey, NAMES[2]) == []


@pytest.mark.parametrize("photos", ["keep"], indirect=True)
def test_the_position_is_kept_where_the_owner_says_so(browser: Browser, survey: Path) -> None:
    browser.upload(f"{point_address(NAMES[0])}/photos", photo())
    (file,) = photos_of(survey, NAMES[0])
    assert file.read_bytes() == photo()
    assert "The position in the photo is kept" in browser.text(point_address(NAMES[0]))


@pytest.mark.parametrize("photos", [None], indirect=True)
def test_without_the_option_nothing_is_stored_or_offered(browser: Browser, survey: Path) -> None:
    address = point_address(NAMES[0])
    assert browser.upload(f"{address}/photos", photo())[0] == 404
    assert "<form" not in browser.text(address)
    assert not (survey / "photos").exists()


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Host": "evil.example", "Origin": "http://evil.example"}, 403),
        ({"Content-Type": "text/plain"}, 400),
        ({"Content-Type": "multipart/form-data"}, 400),
        ({"Content-Length": "200000000"}, 413),
        ({"Content-Length": "many"}, 400),
        ({"Content-Length": "-1"}, 400),
        ({"Content-Length": "9" * 5000}, 413),
        ({"Content-Type": "application/x-www-form-urlencoded"}, 400),
        ({"Content-Type": "multipart/form-data; boundary=" + "x" * 300}, 400),
    ],
)
def test_what_is_no_upload_of_the_reader_is_refused(
    headers: dict[str, str],
    status: int,
    browser: Browser,
    survey: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    assert browser.upload(f"{point_address(NAMES[0])}/photos", photo(), **headers)[0] == status
    assert not (survey / "photos").exists()
    assert capfd.readouterr() == ("", "")


def test_a_second_upload_waits_for_the_first_and_is_refused_then(
    browser: Browser, survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tui.page.server.UPLOAD_WAIT_S", 0.0)
    path = f"{point_address(NAMES[0])}/photos"
    host, port = browser.server.server_address[:2]
    first = http.client.HTTPConnection(str(host), port, timeout=20)
    first.putrequest("POST", path)
    kind = "multipart/form-data; boundary=x"
    sent = {"Origin": browser.origin, "Content-Type": kind, "Content-Length": "9"}
    for name, value in sent.items():
        first.putheader(name, value)
    first.endheaders(b"--x")
    end = time.monotonic() + 20
    while not browser.server.uploading.locked():
        assert time.monotonic() < end
    status, text = browser.upload(path, photo())
    assert (status, "Another upload is running" in text) == (503, True)
    assert browser.request("GET", "/points.json")[0] == 200
    first.send(b"------")
    assert first.getresponse().status == 400
    first.close()
    monkeypatch.setattr("tui.page.server.UPLOAD_WAIT_S", 20.0)
    assert browser.upload(path, photo())[0] == 303


def test_an_upload_is_not_held_in_memory(browser: Browser, survey: Path) -> None:
    files = [bytes(10**7)] * 9
    tracemalloc.start()
    try:
        browser.upload(f"{point_address(NAMES[0])}/none", b"x")
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        status, text = browser.upload(f"{point_address(NAMES[0])}/photos", *files)
        held = tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()
    assert (status, "a JPEG or PNG file" in text) == (400, True)
    # The client holds 270 MB: the parts, and the form twice. The server would add 90 MB.
    assert held < 300e6


@pytest.mark.parametrize(
    ("limit", "value", "status", "reason"),
    [
        ("MAX_UPLOAD_BYTES", 1000, 413, "Send at most 0 MB"),
        ("MAX_PHOTO_BYTES", 1000, 400, "got a picture of more than 0 MB"),
        ("MAX_UPLOAD_S", -60.0, 400, "got no end of it within -1 minutes"),
    ],
)
def test_an_upload_beyond_a_limit_is_refused_and_the_reader_sees_why(
    limit: str,
    value: float,
    status: int,
    reason: str,
    browser: Browser,
    survey: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(f"tui.page.server.{limit}", value)
    files = [bytes(5_000_000)] * 2
    answer, text = browser.upload(f"{point_address(NAMES[0])}/photos", *files)
    assert (answer, reason in text) == (status, True), text
    assert not (survey / "photos").exists()


def test_a_form_of_no_origin_is_refused(browser: Browser, survey: Path) -> None:
    kind = "multipart/form-data; boundary=x"
    path = f"{point_address(NAMES[0])}/photos"
    assert browser.request("POST", path, b"--x--\r\n", **{"Content-Type": kind})[0] == 403
    assert not (survey / "photos").exists()


@pytest.mark.parametrize(
    ("files", "reason"),
    [((b"<svg/>",), "a JPEG or PNG file"), ((), "No picture was chosen"), ((b"",), "No picture")],
)
def test_what_is_no_picture_says_so(
    files: tuple[bytes, ...], reason: str, browser: Browser, survey: Path
) -> None:
    status, text = browser.upload(f"{point_address(NAMES[0])}/photos", *files)
    assert status == 400
    assert reason in text
    assert not (survey / "photos").exists()


@pytest.mark.parametrize("path", ["/point/none/photos", "/", "/points.json"])
def test_photos_go_to_a_point_of_the_survey(path: str, browser: Browser, survey: Path) -> None:
    assert browser.upload(path, photo())[0] == 404
    assert not (survey / "photos").exists()


@pytest.mark.parametrize("name", ["..", "../../acknowledged.txt", "%2e%2e%2facknowledged.txt", ""])
def test_photos_lead_to_no_other_file(name: str, browser: Browser) -> None:
    browser.upload(f"{point_address(NAMES[0])}/photos", photo())
    assert browser.request("GET", f"{point_address(NAMES[0])}/photos/{name}")[0] == 404


def test_away_from_this_computer_photos_need_the_code(browser: Browser, survey: Path) -> None:
    browser.server.code, browser.server.needs_code = "12345678", True
    assert browser.upload(f"{point_address(NAMES[0])}/photos", photo())[0] == 403
    assert browser.request("GET", "/map.svg")[0] == 403
    assert not (survey / "photos").exists()


def test_a_code_admits_a_single_remote_browser(browser: Browser) -> None:
    browser.server.code, browser.server.needs_code = "12345678", True

    def status_of(path: str, **headers: str) -> int:
        return browser.request("GET", path, **headers)[0]

    assert status_of("/") == status_of("/?code=87654321") == 403
    status, _, headers = browser.request("GET", "/?code=12345678")
    assert status == 303
    assert "HttpOnly" in headers["Set-Cookie"]
    assert status_of("/", Cookie=headers["Set-Cookie"].split(";")[0]) == 200
    assert status_of("/?code=12345678") == 403, "the code is void"
    assert status_of("/", Cookie="pfwd=x") == 403


def test_a_large_survey_has_no_picture_of_all_points(
    browser: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "/map.svg" in browser.text("/")
    monkeypatch.setattr(pages, "MAX_PICTURE_POINTS", 2)
    assert ".svg" not in browser.text("/")
