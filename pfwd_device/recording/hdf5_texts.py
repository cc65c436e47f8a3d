"""Reading of the texts in an HDF5 file without the HDF5 library.

A text of variable length is stored as its length and its place in a heap, a block of the file with
many texts. The library allocates memory of any stored length, and reads a heap with wrong sizes
without end: one changed bit is enough for either. Therefore this module reads the texts and
verifies each length before its use. Only the layout that this program writes, the oldest one, is
supported: object headers of version 1 ("HDF5 File Format Specification", sections III.E and
IV.A.1.a).
"""

import io
import struct
from collections.abc import Iterator
from typing import BinaryIO

from pfwd_device.errors import RecordingError

MAX_OBJECT_HEADER_BYTES = 4 * 2**20
"""Largest header of an object with its attributes, bytes; 4096 attributes take 1 MB."""

MAX_HEAPS = 16
"""Largest number of heaps in memory; the file of a drop has two or three."""

_OBJECT = struct.Struct("<BBHIII")
_MESSAGE = struct.Struct("<HHB3x")
_PLACE = struct.Struct("<QQ")
_HEAP = struct.Struct("<4sB3xQ")
_HEAP_OBJECT = struct.Struct("<HHIQ")
_TEXT_REFERENCE = struct.Struct("<IQI")
_CONTINUATION, _ATTRIBUTE = 0x10, 0x0C


class StoredTexts:
    """Reader of the texts in an open HDF5 file.

    Parameters
    ----------
    stream : binary stream
        Stream of the file, from its first byte.
    largest : int
        Largest heap that is accepted, bytes; it limits the length of a text.
    """

    def __init__(self, stream: BinaryIO, largest: int) -> None:
        self._stream = stream
        self._largest = largest
        self._heaps: dict[int, dict[int, bytes]] = {}

    def of_attributes(self, address: int) -> dict[bytes, bytes]:
        """Return the stored values of the attributes of an object, by name.

        The value of an attribute with a text is the place of the text; see `text`.

        Parameters
        ----------
        address : int
            Position of the header of the object in the file, bytes.
        """
        values: dict[bytes, bytes] = {}
        for kind, flags, data in self._messages(address):
            if kind != _ATTRIBUTE:
                continue
            name, value = _attribute(data)
            if flags & ~0x04 or name in values:  # the flag 0x04 forbids sharing of the attribute
                raise RecordingError("expected plain attributes, each once, got other attributes")
            values[name] = value
        return values

    def at(self, offset: int) -> bytes:
        """Return the text of a dataset as UTF-8.

        Parameters
        ----------
        offset : int
            Position of the value of the dataset in the file, bytes.
        """
        return self.text(self._read(offset, _TEXT_REFERENCE.size))

    def text(self, place: bytes) -> bytes:
        """Return a text as UTF-8.

        Parameters
        ----------
        place : bytes
            Stored value, 16 bytes: length of the text, address of its heap, number in the heap.

        Raises
        ------
        RecordingError
            If the text does not exist or has another length.
        """
        if len(place) < _TEXT_REFERENCE.size:
            raise RecordingError(f"expected the place of a text, 16 bytes, got {len(place)}")
        length, address, index = _TEXT_REFERENCE.unpack_from(place)
        if length == 0:
            if address or index:
                raise RecordingError("expected no place for an empty text, got a place")
            return b""
        heap = self._heaps.get(address)
        if heap is None:
            while len(self._heaps) >= MAX_HEAPS:
                del self._heaps[next(iter(self._heaps))]
            heap = self._heaps[address] = self._heap(address)
        text = heap.get(index)
        if text is None or len(text) != length:
            raise RecordingError(
                f"expected the stored text of {length} bytes, got another one or none: damaged"
            )
        if b"\0" in text:
            raise RecordingError("expected a text without the character NUL, got one with it")
        return text

    def _messages(self, address: int) -> Iterator[tuple[int, int, bytes]]:
        version, _, count, _, size, _ = _OBJECT.unpack(self._read(address, _OBJECT.size))
        if version != 1:
            raise RecordingError(f"expected the header of an object, got version {version}")
        blocks = [(address + _OBJECT.size, size)]
        remaining = MAX_OBJECT_HEADER_BYTES
        for offset, length in blocks:  # the loop appends further blocks
            remaining -= length
            if remaining < 0 or len(blocks) > MAX_OBJECT_HEADER_BYTES // _MESSAGE.size:
                raise RecordingError("expected the header of an object, got a longer one")
            data = self._read(offset, length)
            position = 0
            while count and position + _MESSAGE.size <= length:
                kind, size, flags = _MESSAGE.unpack_from(data, position)
                position += _MESSAGE.size
                body = data[position : position + size]
                if len(body) != size:
                    raise RecordingError("expected the header of an object, got a part of one")
                position += size
                count -= 1
                if kind == _CONTINUATION:
                    blocks.append(_PLACE.unpack_from(body.ljust(_PLACE.size, b"\0")))
                yield kind, flags, body
        if count:
            raise RecordingError("expected the header of an object, got a part of one")

    def _heap(self, address: int) -> dict[int, bytes]:
        magic, version, size = _HEAP.unpack(self._read(address, _HEAP.size))
        if magic != b"GCOL" or version != 1 or size > self._largest:
            raise RecordingError("expected a heap of texts, got other data or a longer heap")
        data = self._read(address, size)
        texts: dict[int, bytes] = {}
        position = _HEAP.size
        while position + _HEAP_OBJECT.size <= size:
            index, _, _, length = _HEAP_OBJECT.unpack_from(data, position)
            if index == 0:  # free space up to the end
                if length != size - position:
                    raise RecordingError("expected a heap that ends, got one of another length")
                return texts
            position += _HEAP_OBJECT.size
            if index in texts or length > size - position:
                raise RecordingError("expected distinct texts within a heap, got damaged ones")
            texts[index] = data[position : position + length]
            position += length + -length % 8
        return texts

    def _read(self, offset: int, length: int) -> bytes:
        if length > max(self._largest, MAX_OBJECT_HEADER_BYTES):
            raise RecordingError(f"expected a short part of the file, got {length} bytes")
        if self._stream.seek(0, io.SEEK_END) - offset < length:
            raise RecordingError("expected the whole file, got a part")
        self._stream.seek(offset)
        data = self._stream.read(length)
        if len(data) != length:
            raise RecordingError("expected the whole file, got a part")
        return data


def _attribute(data: bytes) -> tuple[bytes, bytes]:
    """Return name and stored value of an attribute from its entry in an object header."""
    if len(data) < 9 or data[0] not in (1, 3) or data[1]:
        raise RecordingError("expected an attribute as this program writes it, got another form")
    lengths = struct.unpack_from("<HHH", data, 2)
    if data[0] == 1:  # padded to multiples of eight
        padded, start = [length + -length % 8 for length in lengths], 8
    else:
        padded, start = list(lengths), 9
    name = data[start : start + lengths[0]].rstrip(b"\0")
    return name, data[start + sum(padded) :]
