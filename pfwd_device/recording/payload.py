"""Payload of a record: JSON, then arrays as the JSON describes them.

``u32 length of the JSON | JSON in ASCII, keys sorted | arrays, little-endian``. The JSON is an
object with ``data`` (what it says), ``arrays`` (name, dtype and shape of each, in order) and
``packed`` (true: the arrays together are compressed by zlib). Numbers that are not finite are
written NaN, Infinity and -Infinity, as Python's json does.
"""

import contextlib
import hashlib
import json
import math
import struct
import zlib
from collections.abc import Callable, Mapping
from itertools import accumulate
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pfwd_device.errors import RecordingError

LARGEST_ARRAYS = 128 * 2**20
"""Bytes of all arrays of a record, unpacked: twice a drop of 8 channels and 10 s at 50 kHz, which
has 58 MB with its counts. A few packed bytes can announce any number."""

LARGEST_JSON = 32 * 2**20
"""Bytes of a JSON text. The longest is what an exported survey says of its drops, some 300 bytes
of each, so that one of 10,000 drops has 3 MB."""

MOST_JSON_VALUES = 2_500_000
"""Commas, colons and brackets of a JSON text. Each may stand for a value of up to 100 bytes of
memory, thirty times what it takes in the text; 10,000 drops of an exported survey have 300,000."""

MOST_ARRAYS = 4096
DTYPES = ("<f8", "<i4", "|u1")

_LENGTH = struct.Struct("<I")
_DECODE = json.JSONDecoder().raw_decode
_BLANKS = b" \t\n\r"
"""Those of JSON."""
_SIGNS = (",", ":", "[", "{")

Array = NDArray[Any]
Payload = bytes | memoryview
Found = TypeVar("Found")


def encode_json(data: Any) -> str:
    """`data` as JSON in ASCII, always the same text for the same data.

    Raises
    ------
    RecordingError
        If it holds something that JSON does not know.
    """
    try:
        return json.dumps(
            data, sort_keys=True, ensure_ascii=True, separators=(",", ":"), default=_plain
        )
    except (TypeError, ValueError, RecursionError) as err:
        raise RecordingError(
            f"expected texts, numbers, lists and mappings with texts as keys, got {err}"
        ) from err


def _plain(value: object) -> object:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"a {type(value).__name__}")


def decode_json(text: str | bytes) -> Any:
    """What JSON says; every refusal is a RecordingError."""
    if (problem := json_excess(text)) is not None:
        raise RecordingError(problem)
    try:
        if isinstance(text, bytes) and text.isascii():
            # Half of the time goes to telling UTF-16 and others, and to blanks before the value;
            # nobody writes those. A result's file ends with the end of a line. An error is found
            # again, and told, below.
            with contextlib.suppress(ValueError):
                value, end = _DECODE(text.decode("ascii"))
                if end == len(text) or not text[end:].strip(_BLANKS):
                    return value
        return json.loads(text)
    except (ValueError, RecursionError) as err:  # UnicodeDecodeError is a ValueError
        raise RecordingError(f"expected JSON, got {err}") from err


def json_excess(text: str | bytes) -> str | None:
    """What is too much of a JSON text, before anything is made of it; None: nothing."""
    if len(text) > LARGEST_JSON:
        return f"expected JSON of at most {LARGEST_JSON} bytes, got {len(text)}"
    if len(text) <= MOST_JSON_VALUES:  # as every record of the journal
        return None
    if isinstance(text, str):
        values = sum(text.count(sign) for sign in _SIGNS)
    else:
        values = sum(text.count(sign.encode()) for sign in _SIGNS)
    if values > MOST_JSON_VALUES:
        return f"expected JSON of at most {MOST_JSON_VALUES} values, got {values}"
    return None


def encode_payload(
    data: Mapping[str, Any], arrays: Mapping[str, Array] | None = None, *, pack: bool = True
) -> bytes:
    """`data` and `arrays` as the payload of a record."""
    head, parts = _described_parts(data, arrays or {}, pack=pack)
    if not (pack and parts):
        return b"".join([head, *parts])
    packer = zlib.compressobj(1)
    return b"".join([head, *map(packer.compress, parts), packer.flush()])


def _described_parts(
    data: Mapping[str, Any], arrays: Mapping[str, Array], *, pack: bool
) -> tuple[bytes, list[memoryview]]:
    """What stands before the arrays, and the bytes of those that have any."""
    described = []
    parts = []
    total = 0
    for name, array in arrays.items():
        dtype = array.dtype.newbyteorder("<").str
        if dtype not in DTYPES:
            raise RecordingError(f"array {name}: expected one of {DTYPES}, got {dtype}")
        described.append({"name": name, "dtype": dtype, "shape": list(array.shape)})
        total += array.nbytes
        if array.nbytes:
            parts.append(np.ascontiguousarray(array, dtype=dtype).data.cast("B"))
    if total > LARGEST_ARRAYS:
        raise RecordingError(f"expected arrays of at most {LARGEST_ARRAYS} bytes, got {total}")
    pack = pack and bool(parts)
    text = encode_json({"data": data, "arrays": described, "packed": pack}).encode("ascii")
    if (problem := json_excess(text)) is not None:  # what is not read again is not written
        raise RecordingError(problem)
    return _LENGTH.pack(len(text)) + text, parts


def decode_payload(
    payload: bytes, wanted: Callable[[str], bool] = lambda _: True
) -> tuple[dict[str, Any], dict[str, Array]]:
    """Data and arrays (read-only) of a payload.

    Parameters
    ----------
    payload : bytes
    wanted : callable
        Whether an array is, by its name; nothing is unpacked behind the last that is.

    Raises
    ------
    RecordingError
        If the payload is anything else than what :func:`encode_payload` makes.
    """
    head, end = _head(payload)
    return _object(head.get("data")), _arrays(head, payload[end:], wanted)


def decode_payload_unless(
    payload: bytes, find: Callable[[dict[str, Any]], Found | None], wanted: Callable[[str], bool]
) -> tuple[dict[str, Any], Found | dict[str, Array]]:
    """As :func:`decode_payload`, with what is found in the data in place of the arrays."""
    head, end = _head(payload)
    data = _object(head.get("data"))
    found = find(data)
    return data, _arrays(head, payload[end:], wanted) if found is None else found


def _arrays(
    head: Mapping[str, Any], rest: bytes, wanted: Callable[[str], bool]
) -> dict[str, Array]:
    described = head.get("arrays")
    if not isinstance(described, list) or len(described) > MOST_ARRAYS:
        raise RecordingError(f"expected a list of at most {MOST_ARRAYS} arrays, got another thing")
    layout = [_described(entry) for entry in described]
    total = sum(size for *_, size in layout)
    if total > LARGEST_ARRAYS:
        raise RecordingError(f"expected arrays of at most {LARGEST_ARRAYS} bytes, got {total}")
    if len({name for name, *_ in layout}) != len(layout):
        raise RecordingError("expected every array once, got a name twice")
    ends = list(accumulate(size for *_, size in layout))
    last = max((n for n, (name, *_) in enumerate(layout) if wanted(name)), default=-1)
    needed = ends[last] if last >= 0 else 0
    if head.get("packed") is not True:
        block = rest
    elif needed == total:
        block = _unpacked(rest, total)
    else:
        block = _begin_of_unpacked(rest, needed)
    if len(block) != (total if head.get("packed") is not True else needed):
        raise RecordingError(f"expected arrays of {total} bytes, got {len(block)}")
    arrays: dict[str, Array] = {}
    for (name, dtype, shape, size), end in zip(layout, ends, strict=True):
        if end <= needed and wanted(name):
            values = np.frombuffer(block, dtype, math.prod(shape), end - size)
            arrays[name] = values.reshape(shape)
    return arrays


def payload_data(payload: Payload) -> dict[str, Any]:
    """The data of a payload alone, its arrays unread."""
    return _object(_head(payload)[0].get("data"))


def content_digest(data: Mapping[str, Any], arrays: Mapping[str, Array]) -> str:
    """SHA-256 of data and arrays, which no compression changes."""
    head, parts = _described_parts(data, arrays, pack=False)
    found = hashlib.sha256(head)
    for part in parts:
        found.update(part)
    return found.hexdigest()


def _head(payload: Payload) -> tuple[dict[str, Any], int]:
    """The JSON, and where the arrays begin: they are not copied for who does not want them."""
    if len(payload) < _LENGTH.size:
        raise RecordingError(f"expected a payload, got {len(payload)} bytes")
    (length,) = _LENGTH.unpack_from(payload)
    end = _LENGTH.size + length
    if end > len(payload):
        raise RecordingError(f"expected {length} bytes of JSON, got {len(payload)}")
    return _object(decode_json(bytes(payload[_LENGTH.size : end]))), end


def _object(value: object) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise RecordingError(f"expected an object of JSON, got {type(value).__name__}")
    return value


def _described(entry: object) -> tuple[str, str, tuple[int, ...], int]:
    entry = _object(entry)
    name, dtype, shape = entry.get("name"), entry.get("dtype"), entry.get("shape")
    if not isinstance(name, str) or dtype not in DTYPES:
        raise RecordingError(f"expected a name and one of {DTYPES}, got another array")
    if (
        not isinstance(shape, list)
        or len(shape) > 2
        or not all(type(n) is int and 0 <= n <= LARGEST_ARRAYS for n in shape)
    ):
        raise RecordingError(f"array {name[:64]}: expected one or two lengths, got another shape")
    sides = tuple(shape)
    return name, dtype, sides, math.prod(sides) * np.dtype(dtype).itemsize


def _begin_of_unpacked(packed: bytes, size: int) -> bytes:
    """The first bytes; what follows is not looked at: the record's checksum is of all of it."""
    if not size:
        return b""
    try:
        return zlib.decompressobj().decompress(packed, size)
    except (zlib.error, MemoryError) as err:
        raise RecordingError(f"expected compressed arrays, got {err}") from err


def _unpacked(packed: bytes, size: int) -> bytes:
    # Never more than was announced: a few bytes can promise gigabytes.
    opener = zlib.decompressobj()
    try:
        block = opener.decompress(packed, size + 1)
    except (zlib.error, MemoryError) as err:
        raise RecordingError(f"expected compressed arrays, got {err}") from err
    if not opener.eof or opener.unused_data or len(block) > size:
        raise RecordingError(f"expected compressed arrays of {size} bytes, got others")
    return block
