"""Pictures of test points: what is stored, what is stripped, what is refused."""

import io
import os
import struct
import zlib
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from pfwd.errors import OptionError, SurveyError
from pfwd.files import photos
from pfwd.files.photos import photos_of, store_photo

ORIENTATION, GPS, LATITUDE = 0x0112, 0x8825, 2


def picture(kind: str = "JPEG", *, orientation: int = 6, progressive: bool = False) -> bytes:
    """A picture of noise with a position, a comment and something behind its end."""
    image = Image.frombytes("RGB", (64, 48), os.urandom(64 * 48 * 3))
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    exif.get_ifd(GPS)[LATITUDE] = (52.0, 31.0, 12.0)
    stream = io.BytesIO()
    if kind == "PNG":
        text = PngInfo()
        text.add_text("Comment", "SECRET PLACE")
        image.save(stream, "PNG", exif=exif, pnginfo=text)
    else:
        more = {"comment": b"SECRET PLACE", "progressive": progressive}
        image.save(stream, "JPEG", exif=exif, icc_profile=b"profile of colours", **more)
    return stream.getvalue() + b"SECRET FILM"


def pixels(data: bytes) -> bytes:
    with Image.open(io.BytesIO(data)) as image:
        return image.convert("RGB").tobytes()


def position(data: bytes) -> dict[int, object]:
    with Image.open(io.BytesIO(data)) as image:
        return dict(image.getexif().get_ifd(GPS))


@pytest.mark.parametrize(
    ("kind", "options"),
    [("JPEG", {"orientation": 1}), ("JPEG", {"progressive": True}), ("PNG", {})],
)
def test_a_stripped_picture_is_the_same_the_same_side_up(
    kind: str, options: dict[str, Any], tmp_path: Path
) -> None:
    data = picture(kind, **options)
    assert position(data)
    stored = store_photo(tmp_path, "P1", data).read_bytes()
    assert pixels(stored) == pixels(data)
    assert position(stored) == {}
    assert b"SECRET" not in stored
    if kind == "JPEG":
        with Image.open(io.BytesIO(stored)) as image:
            assert image.getexif().get(ORIENTATION, 1) == options.get("orientation", 6)
            assert image.info["icc_profile"] == b"profile of colours"


@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
def test_a_picture_is_stored_unchanged_on_request(kind: str, tmp_path: Path) -> None:
    data = picture(kind)
    file = store_photo(tmp_path, "P1", data, keep_position=True)
    assert file.read_bytes() == data
    assert file.suffix == {"JPEG": ".jpg", "PNG": ".png"}[kind]


def test_the_same_picture_is_stored_once(tmp_path: Path) -> None:
    data = picture()
    assert store_photo(tmp_path, "P1", data) == store_photo(tmp_path, "P1", data)
    assert len(photos_of(tmp_path, "P1")) == 1
    store_photo(tmp_path, "P2", data)
    assert len(photos_of(tmp_path, "P2")) == 1


NAMES = ["\ud800", "../../x", "..", "/etc/passwd", "CON", "a:b", "x" * 64, "点" * 64, ".h", "P1 "]


@pytest.mark.parametrize("name", NAMES)
def test_any_name_of_a_point_has_a_folder_within_the_survey(name: str, tmp_path: Path) -> None:
    survey = tmp_path / "survey"
    survey.mkdir()
    file = store_photo(survey, name, picture())
    assert file.resolve().parent.parent == (survey / "photos").resolve()
    assert photos_of(survey, name) == [file]
    assert photos_of(survey, name + "x") == []
    assert photos_of(survey, f"{name.swapcase()}.") == []


NO_PICTURES = {
    "empty": b"",
    "svg": b"<svg onload='alert(1)'>",
    "gif": b"GIF89a" + bytes(200),
    "cut": picture()[:900],
    "no picture": b"\xff\xd8\xff\xe1" + bytes(50),
}


@pytest.mark.parametrize("data", NO_PICTURES.values(), ids=NO_PICTURES)
def test_files_without_picture_are_rejected(data: bytes, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="a JPEG or PNG file" if data else "at most 20 MB"):
        store_photo(tmp_path, "P1", data)
    assert list(tmp_path.rglob("*.*")) == []


@pytest.mark.parametrize(
    ("limit", "value", "message"),
    [
        ("MAX_PHOTO_PIXELS", 1000, "million pixels"),
        ("MAX_PHOTO_BYTES", 1000, "a picture of at most"),
        ("MAX_PHOTOS_OF_A_POINT", 0, "P1: expected at most 0 pictures of a point"),
    ],
)
def test_size_and_number_of_pictures_are_limited(
    limit: str, value: int, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(photos, limit, value)
    with pytest.raises(OptionError, match=message):
        store_photo(tmp_path, "P1", picture())


def test_a_picture_of_200_million_pixels_is_stored(tmp_path: Path) -> None:
    width, height = 20_000, 10_000
    header = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)  # one bit for each pixel
    rows = zlib.compress(bytes((1 + width // 8) * height), 1)
    parts = [(b"IHDR", header), (b"IDAT", rows), (b"IEND", b"")]
    data = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(part)) + name + part + struct.pack(">I", zlib.crc32(name + part))
        for name, part in parts
    )
    assert store_photo(tmp_path, "P1", data).read_bytes() == data


def test_a_full_disk_leaves_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_number: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(SurveyError, match=r"\.jpg: No space left on device; the picture"):
        store_photo(tmp_path, "P1", picture())
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
