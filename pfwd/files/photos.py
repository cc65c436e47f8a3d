"""Photos of test points, in the folder ``photos`` of a survey.

A photo is a JPEG or PNG file and is decoded before it is stored. It is stored unchanged, or without
what a camera adds to the picture: position, serial numbers, comments, appended video.
"""

from __future__ import annotations

import datetime
import hashlib
import io
import os
import struct
import urllib.parse
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from pfwd.errors import OptionError, SurveyError, refusal
from pfwd.files.output_path import replaced_durably

MAX_PHOTO_BYTES = 20_000_000
"""Largest file of a photo; the largest of a phone have half of it."""

MAX_PHOTO_PIXELS = 200_000_000
"""Largest picture, that of the largest sensors of phones. Decoding it takes 20 MB of memory for the
JPEG of a camera, 0.8 GB for a PNG and up to 1.6 GB for a progressive JPEG."""

MAX_PHOTOS_OF_A_POINT = 100
"""Photos of a point; a larger number would be a mistake, or an attempt to fill the disk."""

_SUFFIX_BY_FORMAT = {"JPEG": ".jpg", "PNG": ".png"}
_MOMENT_FORMAT = "%Y%m%dT%H%M%SZ"

_ORIENTATION = 0x0112
"""Exif tag with the orientation of the picture."""

# ISO/IEC 10918-1, table B.1: markers without a length. A scan's data end before any other marker.
_JPEG_START, _JPEG_END, _JPEG_SCAN = 0xD8, 0xD9, 0xDA
_JPEG_IN_SCAN = {0x00, *range(0xD0, 0xD8)}
_JPEG_APPLICATION = range(0xE0, 0xF0)
_JPEG_COMMENT = 0xFE

_JPEG_SIGNATURE = b"\xff\xd8\xff"
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_CHUNKS_OF_THE_PICTURE = {
    *(b"IHDR", b"PLTE", b"IDAT", b"IEND", b"tRNS", b"gAMA", b"cHRM", b"sRGB", b"iCCP", b"sBIT"),
    *(b"bKGD", b"pHYs"),
}


def store_photo(
    survey: str | os.PathLike[str],
    point: str,
    data: bytes,
    *,
    keep_position: bool = False,
    moment: datetime.datetime | None = None,
) -> Path:
    """Store a photo of a test point and return its file once it is on the disk.

    Parameters
    ----------
    survey : path of a survey
    point : str
        Name of the test point.
    data : bytes of a JPEG or PNG file
    keep_position : bool
        True: the file is stored unchanged. False: everything but the picture is removed, the
        position included.
    moment : datetime, UTC, optional
        Time by which the photos of a point are sorted; None: now.

    Returns
    -------
    Path
        If the point has the same photo already, the file of that one.

    Raises
    ------
    OptionError
        If the data are no picture that can be decoded, or the point has too many photos.
    SurveyError
        If the file cannot be written.
    """
    kind, orientation = _inspect(data)
    if not keep_position:
        data = _stripped_jpeg(data, orientation) if kind == "JPEG" else _stripped_png(data)
    checksum = _checksum(data)
    folder = _folder(survey, point)
    present = photos_of(survey, point)
    same = next((photo for photo in present if photo.stem.endswith(checksum)), None)
    if same is not None:
        return same
    if len(present) >= MAX_PHOTOS_OF_A_POINT:
        expected = f"at most {MAX_PHOTOS_OF_A_POINT} pictures of a point"
        hint = "delete one in the folder photos of the survey"
        raise OptionError(refusal(point, expected, "one more", hint))
    moment = datetime.datetime.now(datetime.UTC) if moment is None else moment
    file = folder / f"{moment:{_MOMENT_FORMAT}}-{checksum}{_SUFFIX_BY_FORMAT[kind]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with replaced_durably(file) as draft, open(draft, "xb") as stream:
            stream.write(data)
    except OSError as err:
        raise SurveyError(f"{file}: {err.strerror or err}; the picture is not stored") from err
    return file


def moment_of(name: str) -> datetime.datetime | None:
    """Return the time, UTC, at the beginning of a photo's file name; None: it has no time."""
    try:
        return datetime.datetime.strptime(name.partition("-")[0], _MOMENT_FORMAT)
    except ValueError:
        return None


def photos_of(survey: str | os.PathLike[str], point: str) -> list[Path]:
    """Return the files of a point's photos, the oldest first.

    Parameters
    ----------
    survey : path of a survey
    point : str
        Name of the test point.
    """
    try:
        with os.scandir(_folder(survey, point)) as entries:
            names = [e.name for e in entries if e.is_file(follow_symlinks=False)]
    # ValueError: no file has such a name.
    except (OSError, ValueError):
        return []
    suffixes = tuple(_SUFFIX_BY_FORMAT.values())
    return [
        _folder(survey, point) / name
        for name in sorted(names)
        if name.endswith(suffixes) and not name.startswith(".")
    ]


def is_sound_photo(file: Path) -> bool:
    """Return whether the content of a photo is the one that was stored.

    The name of a stored photo has the beginning of its SHA-256. A photo that a user has copied into
    the folder has another name, and is decoded.
    """
    try:
        data = file.read_bytes()
        if moment_of(file.name) is None:
            _inspect(data)
            return True
    except (OSError, OptionError):
        return False
    return file.stem.endswith(_checksum(data))


def _checksum(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def _folder(survey: str | os.PathLike[str], point: str) -> Path:
    # Names of points may hold anything and may be long: no separator, no leading dot and no name
    # that Windows reserves reaches the disk. The checksum keeps "P1" and "p1" apart where the
    # disk does not.
    quoted = urllib.parse.quote(point, " ()+=,", errors="surrogatepass").replace(".", "%2E")[:100]
    checksum = hashlib.sha256(point.encode("utf-8", "surrogatepass")).hexdigest()[:8]
    return Path(survey) / "photos" / f"point {quoted}-{checksum}"


def opened_photo(source: IO[bytes]) -> Any:
    """Return the image of Pillow in a JPEG or PNG file, without decoding it.

    Image.open of Pillow would refuse pictures of more than 179 million pixels, and open a JPEG with
    several pictures as another format.
    """
    from PIL.JpegImagePlugin import JpegImageFile
    from PIL.PngImagePlugin import PngImageFile

    signature = source.read(len(_PNG_SIGNATURE))
    source.seek(0)
    return PngImageFile(source) if signature == _PNG_SIGNATURE else JpegImageFile(source)


def _inspect(data: bytes) -> tuple[str, int]:
    """Decode a picture; return its format, "JPEG" or "PNG", and its Exif orientation, 1 to 8."""
    if not 0 < len(data) <= MAX_PHOTO_BYTES:
        expected = f"a picture of at most {MAX_PHOTO_BYTES / 1e6:.0f} MB"
        raise OptionError(refusal("picture", expected, f"{len(data) / 1e6:.1f} MB"))
    if not data.startswith((_JPEG_SIGNATURE, _PNG_SIGNATURE)):
        raise OptionError(refusal("picture", "a JPEG or PNG file", "another kind of file"))
    try:
        # Pillow reports damage of metadata as warnings, which would appear in the terminal.
        with warnings.catch_warnings(action="ignore"), opened_photo(io.BytesIO(data)) as image:
            kind, pixels = str(image.format), image.width * image.height
            if pixels <= MAX_PHOTO_PIXELS:
                orientation = image.getexif().get(_ORIENTATION, 1)
                image.draft("L", (64, 64))  # decodes a JPEG small
                image.load()
                return kind, orientation if orientation in range(1, 9) else 1
    # On damaged files Pillow raises OSError, SyntaxError, ValueError, struct.error and others.
    except Exception as err:
        reason = f"{type(err).__name__}: {err}"
        raise OptionError(refusal("picture", "a JPEG or PNG file", reason)) from err
    expected = f"at most {MAX_PHOTO_PIXELS // 10**6} million pixels"
    raise OptionError(refusal("picture", expected, f"{pixels / 1e6:.0f} million"))


def _stripped_jpeg(data: bytes, orientation: int) -> bytes:
    """Return a JPEG file without comments and metadata; colour profile and orientation stay."""
    exif = b""
    if orientation != 1:
        # TIFF header and one entry: big-endian, SHORT, count 1 (Exif 2.32, 4.6).
        entry = struct.pack(">HHIHH", _ORIENTATION, 3, 1, orientation, 0)
        body = b"Exif\0\0MM\0*" + struct.pack(">IH", 8, 1) + entry + struct.pack(">I", 0)
        exif = b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body
    parts = [b"\xff\xd8", exif]
    for marker, part in _jpeg_parts(data):
        is_colour = (marker == 0xE2 and part[4:].startswith(b"ICC_PROFILE\0")) or marker == 0xEE
        is_metadata = marker in _JPEG_APPLICATION or marker == _JPEG_COMMENT
        if not is_metadata or is_colour:
            parts.append(part)
    return b"".join(parts)


def _jpeg_parts(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the type (marker) and the bytes of each segment of a JPEG file, up to the end of the
    picture.
    """
    at = 2
    while at + 2 <= len(data):
        marker = data[at + 1]
        if data[at] != 0xFF or marker == 0xFF:
            at += 1  # fill bytes
            continue
        if marker == _JPEG_END:
            break
        end = at + 2 + int.from_bytes(data[at + 2 : at + 4])
        if marker == _JPEG_SCAN:
            while end < len(data) and (data[end] != 0xFF or data[end + 1 : end + 2] in _IN_SCAN):
                following = data.find(b"\xff", end + 1)
                end = len(data) if following < 0 else following
        yield marker, data[at:end]
        at = end
    yield _JPEG_END, b"\xff\xd9"


_IN_SCAN = {bytes([marker]) for marker in (*_JPEG_IN_SCAN, 0xFF)}


def _stripped_png(data: bytes) -> bytes:
    """Return a PNG file without texts, Exif data and anything that follows the picture."""
    parts, at = [_PNG_SIGNATURE], len(_PNG_SIGNATURE)
    while at + 12 <= len(data):
        end = at + 12 + int.from_bytes(data[at : at + 4])
        name = data[at + 4 : at + 8]
        if name in _PNG_CHUNKS_OF_THE_PICTURE:
            parts.append(data[at:end])
        if name == b"IEND":
            break
        at = end
    return b"".join(parts)
