"""The pages of a survey in a browser, and photos that it sends."""

import http.client
import io
import json
import re
import time
import tracemalloc
import urllib.parse
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from pfwd.files.photos import photos_of
from tests.tui.page.conftest import HOSTILE, NAMES, Browser
from tui.page import pages
from tui.page.pages import overview_page, parse_point_address, point_address
from tui.screen.opened.rows import OpenedSurvey

POINT = point_address(NAMES[0])
UPLOADS = f"{POINT}/photos"


def photo(colour: str = "red") -> bytes:
    image = Image.new("RGB", (40, 30), colour)
    exif = Image.Exif()
    exif.get_ifd(0x8825)[2] = (48.0, 1.0, 2.0)
    stream = io.BytesIO()
    image.save(stream, "JPEG", exif=exif)
    return stream.getvalue()


@pytest.mark.parametrize("name", [*NAMES, "a?b#c", "..", "%2F", "\ud800"])
def test_the_address_of_a_point_contains_its_name(name: str) -> None:
    path = urllib.parse.urlsplit(point_address(name)).path
    assert parse_point_address(path) == (name, "")
    assert parse_point_address(f"{path}/photos/x.jpg") == (name, "photos/x.jpg")
    assert parse_point_address("/points.json") == ("", "")


def test_pages_lead_to_every_point_and_contain_no_markup_of_the_survey(browser: Browser) -> None:
    overview = browser.text("/")
    assert "3 without a verdict" in overview
    rows = json.loads(browser.text("/points.json"))
    assert [(row["point"], row["verdict"]) for row in rows] == [(name, "none") for name in NAMES]
    links = re.findall(r'href="(/point/[^"]*)"', overview)
    assert links == [point_address(name) for name in NAMES]
    assert "&lt;script&gt;" in overview
    first, middle, last = texts = [browser.text(link) for link in links]
    for page, name in zip(texts, NAMES, strict=True):
        assert 'href="/"' in page
        assert (f"Point {name}" in page) == (name != HOSTILE)
    assert not any("<script" in page for page in (overview, *texts))
    for relation, count in (("prev", [0, 1, 1]), ("next", [1, 1, 0])):
        assert [page.count(f'rel="{relation}"') for page in texts] == count
    assert f">{NAMES[2]} →<" in middle
    assert f">← {NAMES[0]}<" in middle
    assert 'href="#photos"' in first
    assert 'id="photos"' in last


@pytest.mark.parametrize("is_marked", [True, False])
def test_a_mark_of_a_value_is_explained(survey: Path, is_marked: bool) -> None:
    opened = OpenedSurvey(survey).read()
    rows = [replace(row, value=45e6, unit="Pa", value_marked=is_marked) for row in opened]
    page = overview_page(str(survey), "road", rows)
    assert bool(re.search(r">45[.0]*\* MPa<", page)) is is_marked
    assert ("* not supported by the data" in page) is is_marked


def test_a_page_runs_no_script_and_loads_from_this_server_only(browser: Browser) -> None:
    _, _, headers = browser.request("GET", "/")
    policy = headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; ")
    assert "script" not in policy
    assert "http" not in policy
    addresses = re.findall(r'(?:src|srcset|href|action)="([^"]*)"', browser.text("/"))
    assert addresses
    assert all(address.startswith(("/", "data:")) for address in addresses)


def test_pictures_of_all_points_are_svg_up_to_a_number_of_points(
    browser: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("map", "map-small", "profile", "profile-small"):
        status, body, headers = browser.request("GET", f"/{name}.svg")
        assert (status, headers["Content-Type"]) == (200, "image/svg+xml; charset=utf-8")
        assert b"<svg" in body
    assert "/map.svg" in browser.text("/")
    monkeypatch.setattr(pages, "MAX_PICTURE_POINTS", 2)
    assert ".svg" not in browser.text("/")


def test_unknown_addresses_and_places_of_photos_are_status_404(
    browser: Browser, survey: Path
) -> None:
    for path in ("/x.svg", "/point/none", "/point/P%201%2F2/x", "/point"):
        assert browser.status(path) == 404, path
    for path in ("/point/none/photos", "/", "/points.json"):
        assert browser.upload(path, photo())[0] == 404, path
    assert not (survey / "photos").exists()
    browser.upload(UPLOADS, photo())
    for name in ("..", "../../acknowledged.txt", "%2e%2e%2facknowledged.txt", ""):
        assert browser.status(f"{UPLOADS}/{name}") == 404, name


def test_a_photo_is_stored_without_its_position(browser: Browser, survey: Path) -> None:
    assert browser.upload(UPLOADS, photo(), photo("blue")) == (303, "")
    stored = photos_of(survey, NAMES[0])
    assert len(stored) == 2
    page = browser.text(POINT)
    for file in stored:
        source = f"{UPLOADS}/{file.name}"
        assert f'src="{source}"' in page
        status, body, headers = browser.request("GET", source)
        assert (status, headers["Content-Type"]) == (200, "image/jpeg")
        with Image.open(io.BytesIO(body)) as image:
            assert image.size == (40, 30)
            assert dict(image.getexif().get_ifd(0x8825)) == {}
    assert "2 photos" in browser.text("/")
    assert photos_of(survey, NAMES[2]) == []


@pytest.mark.parametrize("browser", ["keep"], indirect=True)
def test_a_photo_keeps_its_position_if_the_owner_wants_it(browser: Browser, survey: Path) -> None:
    browser.upload(UPLOADS, photo())
    (file,) = photos_of(survey, NAMES[0])
    assert file.read_bytes() == photo()
    assert "The position in the photo is kept" in browser.text(POINT)


@pytest.mark.parametrize("browser", [None], indirect=True)
def test_without_the_option_no_photo_is_stored(browser: Browser, survey: Path) -> None:
    assert browser.upload(UPLOADS, photo())[0] == 404
    assert "<form" not in browser.text(POINT)
    assert not (survey / "photos").exists()


def test_a_malformed_upload_is_refused(
    browser: Browser, survey: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for headers, status in (
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Host": "evil.example", "Origin": "http://evil.example"}, 403),
        ({"Content-Type": "text/plain"}, 400),
        ({"Content-Type": "multipart/form-data"}, 400),
        ({"Content-Type": "application/x-www-form-urlencoded"}, 400),
        ({"Content-Type": "multipart/form-data; boundary=" + "x" * 300}, 400),
        ({"Content-Length": "200000000"}, 413),
        ({"Content-Length": "9" * 5000}, 413),
        ({"Content-Length": "many"}, 400),
        ({"Content-Length": "-1"}, 400),
    ):
        assert browser.upload(UPLOADS, photo(), **headers)[0] == status, headers
    form = {"Content-Type": "multipart/form-data; boundary=x"}
    assert browser.request("POST", UPLOADS, b"--x--\r\n", **form)[0] == 403, "without an origin"
    for files, reason in (
        ([b"<svg/>"], "a JPEG or PNG file"),
        ([], "No picture was chosen"),
        ([b""], "No picture"),
    ):
        status, text = browser.upload(UPLOADS, *files)
        assert (status, reason in text) == (400, True), text
    assert not (survey / "photos").exists()
    assert capfd.readouterr() == ("", "")


def test_a_second_upload_waits_for_the_first_and_is_refused_then(
    browser: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tui.page.server.UPLOAD_WAIT_S", 0.0)
    host, port = browser.server.server_address[:2]
    first = http.client.HTTPConnection(str(host), port, timeout=20)
    first.putrequest("POST", UPLOADS)
    first.putheader("Origin", browser.server.url.rstrip("/"))
    first.putheader("Content-Type", "multipart/form-data; boundary=x")
    first.putheader("Content-Length", "9")
    first.endheaders(b"--x")
    end = time.monotonic() + 20
    while not browser.server.uploading.locked():
        assert time.monotonic() < end
    status, text = browser.upload(UPLOADS, photo())
    assert (status, "Another upload is running" in text) == (503, True)
    assert browser.status("/points.json") == 200
    first.send(b"------")
    assert first.getresponse().status == 400
    first.close()
    monkeypatch.setattr("tui.page.server.UPLOAD_WAIT_S", 20.0)
    assert browser.upload(UPLOADS, photo())[0] == 303


def test_an_upload_is_not_collected_in_memory(browser: Browser) -> None:
    files = [bytes(10**7)] * 9
    tracemalloc.start()
    try:
        browser.upload(f"{POINT}/none", b"x")
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        status, text = browser.upload(UPLOADS, *files)
        peak = tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()
    assert (status, "a JPEG or PNG file" in text) == (400, True)
    # The client allocates 270 MB: the parts, and the form twice. The server would add 90 MB.
    assert peak < 300e6


@pytest.mark.parametrize(
    ("limit", "value", "status", "reason"),
    [
        ("MAX_UPLOAD_BYTES", 1000, 413, "Send at most 0 MB"),
        ("MAX_PHOTO_BYTES", 1000, 400, "got a picture of more than 0 MB"),
        ("MAX_UPLOAD_S", -60.0, 400, "got no end of it within -1 minutes"),
    ],
)
def test_an_upload_beyond_a_limit_is_refused_with_the_reason(
    limit: str,
    value: float,
    status: int,
    reason: str,
    browser: Browser,
    survey: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(f"tui.page.server.{limit}", value)
    response, text = browser.upload(UPLOADS, *[bytes(5_000_000)] * 2)
    assert (response, reason in text) == (status, True), text
    assert not (survey / "photos").exists()


def test_a_code_admits_a_single_remote_browser(browser: Browser, survey: Path) -> None:
    browser.server.code, browser.server.needs_code = "12345678", True
    assert browser.upload(UPLOADS, photo())[0] == 403
    for path in ("/map.svg", "/", "/?code=87654321"):
        assert browser.status(path) == 403, path
    status, _, headers = browser.request("GET", "/?code=12345678")
    assert status == 303
    assert "HttpOnly" in headers["Set-Cookie"]
    assert browser.status("/", Cookie=headers["Set-Cookie"].split(";")[0]) == 200
    assert browser.status("/?code=12345678") == 403, "the code is void"
    assert browser.status("/", Cookie="pfwd=x") == 403
    assert not (survey / "photos").exists()
