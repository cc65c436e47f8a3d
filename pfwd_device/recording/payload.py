"""Payload (content) of a record of the journal: JSON, then the arrays that the JSON describes.

The layout is ``u32 length of the JSON | JSON in ASCII, keys sorted | arrays, little-endian``. The
JSON is an object with ``data`` (the values), ``arrays`` (name, dtype and shape of each, in order)
and ``packed`` (true: the arrays together are compressed by zlib). Numbers that are not finite are
written NaN, Infinity and -Infinity, as Python's json does.
"""

import contextlib
import json
import math
import struct
import zlib
from collections.abc import Callable, Mapping
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfwd_device.errors import RecordingError

MAX_ARRAY_BYTES = 128 * 2**20
"""Largest size of all arrays of a record before compression, bytes. It is twice that of a drop of 8
channels and 10 s at 50 kHz with its counts, 58 MB. A few compressed bytes can announce any size."""

MAX_JSON_BYTES = 32 * 2**20
"""Largest JSON text, bytes. The longest lists the files of a survey, some 130 bytes each: 13 MB for
100,000 files."""

MAX_JSON_VALUES = 2_500_000
"""Largest number of commas, colons and brackets in a JSON text. Each may be a value of up to 100
bytes of memory, thirty times its length in the text; a list of 100,000 files has 700,000."""

MAX_ARRAYS = 4096
DTYPES = ("<f8", "<i4", "|u1")

_JSON_LENGTH = struct.Struct("<I")
_DECODE = json.JSONDecoder().raw_decode
_JSON_BLANKS = b" \t\n\r"
"""White space that JSON allows between values."""
_SIGNS = (",", ":", "[", "{")

Array = NDArray[Any]


def encode_json(data: Any) -> str:
    """Return data as JSON in ASCII, always the same text for the same data.

    Raises
    ------
    RecordingError
        If the data contain a value that JSON cannot express.
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
    raise TypeError(f"an object of the class {type(value).__name__}")


def decode_json(text: str | bytes) -> Any:
    """Return the value of a JSON text.

    Raises
    ------
    RecordingError
        If the text is not JSON or exceeds a limit of this module.
    """
    if (problem := json_excess(text)) is not None:
        raise RecordingError(problem)
    try:
        if isinstance(text, bytes) and text.isascii():
            # json.loads takes twice as long, because it detects encodings and skips leading blanks.
            # It is only used for unusual texts, and to raise the errors. The file of a result ends
            # with a line feed.
            with contextlib.suppress(ValueError):
                value, end = _DECODE(text.decode("ascii"))
                if end == len(text) or not text[end:].strip(_JSON_BLANKS):
                    return value
        return json.loads(text)
    except (ValueError, RecursionError) as err:  # UnicodeDecodeError is a ValueError
        raise RecordingError(f"expected JSON, got {err}") from err


def json_excess(text: str | bytes) -> str | None:
    """Return a message if a JSON text exceeds a limit of length or number of values; else None.

    The text is not parsed, because parsing could fill the memory.
    """
    if len(text) > MAX_JSON_BYTES:
        return f"expected JSON of at most {MAX_JSON_BYTES} bytes, got {len(text)}"
    if len(text) <= MAX_JSON_VALUES:  # every record of the journal is shorter
        return None
    if isinstance(text, str):
        values = sum(text.count(sign) for sign in _SIGNS)
    else:
        values = sum(text.count(sign.encode()) for sign in _SIGNS)
    if values > MAX_JSON_VALUES:
        return f"expected JSON of at most {MAX_JSON_VALUES} values, got {values}"
    return None


def encode_payload(
    data: Mapping[str, Any], arrays: Mapping[str, Array] | None = None, *, pack: bool = True
) -> bytes:
    """Return the payload of a record.

    Parameters
    ----------
    data : mapping
        Values that JSON can express.
    arrays : mapping of str to ndarray, optional
        Arrays with one or two dimensions and a dtype of `DTYPES`.
    pack : bool
        Compress the arrays.

    Raises
    ------
    RecordingError
        If data or arrays cannot be encoded or are too large.
    """
    described = []
    parts = []
    total = 0
    for name, array in (arrays or {}).items():
        dtype = array.dtype.newbyteorder("<").str
        if dtype not in DTYPES:
            raise RecordingError(f"array {name}: expected one of {DTYPES}, got {dtype}")
        described.append({"name": name, "dtype": dtype, "shape": list(array.shape)})
        total += array.nbytes
        if array.nbytes:
            parts.append(np.ascontiguousarray(array, dtype=dtype).data.cast("B"))
    if total > MAX_ARRAY_BYTES:
        raise RecordingError(f"expected arrays of at most {MAX_ARRAY_BYTES} bytes, got {total}")
    pack = pack and bool(parts)
    text = encode_json({"data": data, "arrays": described, "packed": pack}).encode("ascii")
    if (problem := json_excess(text)) is not None:  # a larger text could not be read
        raise RecordingError(problem)
    head = _JSON_LENGTH.pack(len(text)) + text
    if not pack:
        return b"".join([head, *parts])
    packer = zlib.compressobj(1)
    return b"".join([head, *map(packer.compress, parts), packer.flush()])


def decode_payload(
    payload: bytes, select: Callable[[str], bool] = lambda _: True
) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the data and the arrays (read-only) of the payload of a record.

    Parameters
    ----------
    payload : bytes
    select : callable
        Function of the name of an array that returns True if the array is needed. Arrays after the
        last needed one are not unpacked.

    Raises
    ------
    RecordingError
        If the payload has another form than that of :func:`encode_payload`.
    """
    head, end = _head(payload)
    return _object(head.get("data")), _arrays(head, payload[end:], select)


def _arrays(
    head: Mapping[str, Any], rest: bytes, select: Callable[[str], bool]
) -> dict[str, Array]:
    described = head.get("arrays")
    if not isinstance(described, list) or len(described) > MAX_ARRAYS:
        raise RecordingError(f"expected a list of at most {MAX_ARRAYS} arrays, got other data")
    layout = [_described(entry) for entry in described]
    total = sum(size for *_, size in layout)
    if total > MAX_ARRAY_BYTES:
        raise RecordingError(f"expected arrays of at most {MAX_ARRAY_BYTES} bytes, got {total}")
    if len({name for name, *_ in layout}) != len(layout):
        raise RecordingError("expected every array once, got a name twice")
    ends = list(accumulate(size for *_, size in layout))
    last = max((n for n, (name, *_) in enumerate(layout) if select(name)), default=-1)
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
        if end <= needed and select(name):
            values = np.frombuffer(block, dtype, math.prod(shape), end - size)
            arrays[name] = values.reshape(shape)
    return arrays


def payload_data(payload: bytes) -> dict[str, Any]:
    """Return the data of the payload of a record, without its arrays."""
    return _object(_head(payload)[0].get("data"))


def _head(payload: bytes) -> tuple[dict[str, Any], int]:
    """Return the JSON object of a payload, and the position at which its arrays begin."""
    if len(payload) < _JSON_LENGTH.size:
        raise RecordingError(f"expected a payload, got {len(payload)} bytes")
    (length,) = _JSON_LENGTH.unpack_from(payload)
    end = _JSON_LENGTH.size + length
    if end > len(payload):
        raise RecordingError(f"expected {length} bytes of JSON, got {len(payload)}")
    return _object(decode_json(payload[_JSON_LENGTH.size : end])), end


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
        or not all(type(n) is int and 0 <= n <= MAX_ARRAY_BYTES for n in shape)
    ):
        name = name[:64]
        raise RecordingError(f"array {name}: expected one or two dimensions, got another shape")
    sides = tuple(shape)
    return name, dtype, sides, math.prod(sides) * np.dtype(dtype).itemsize


def _begin_of_unpacked(packed: bytes, size: int) -> bytes:
    """Return the first `size` unpacked bytes; the record's CRC has already verified all bytes."""
    if not size:
        return b""
    try:
        return zlib.decompressobj().decompress(packed, size)
    except (zlib.error, MemoryError) as err:
        raise RecordingError(f"expected compressed arrays, got {err}") from err


def _unpacked(packed: bytes, size: int) -> bytes:
    # Limit the output to the announced size: a few compressed bytes can contain gigabytes.
    opener = zlib.decompressobj()
    try:
        block = opener.decompress(packed, size + 1)
    except (zlib.error, MemoryError) as err:
        raise RecordingError(f"expected compressed arrays, got {err}") from err
    if not opener.eof or opener.unused_data or len(block) > size:
        raise RecordingError(f"expected compressed arrays of {size} bytes, got another size")
    return block
