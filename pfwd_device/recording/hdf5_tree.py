"""Content of an HDF5 file as a tree of groups and datasets: safe reading, writing, digest.

A file from a stranger may refer to other files (links, external storage), announce more data than
there is memory, or have bytes whose change the library does not detect. Here a file is opened
through a stream that refuses long reads, and every object is inspected before it is read. Only
content that this program writes is accepted: hard links, numbers of 8, 32 and 64 bits, texts of
fixed length, and gzip, shuffle and checksum filters. A text of variable length would be stored as
its length and its place in the file: one changed bit may then make HDF5 fill the memory, or read
without end. h5py is imported by the functions that need it, because recording works without it.
"""

import contextlib
import functools
import hashlib
import io
import math
import os
import stat
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np

from pfwd_device.errors import RecordingError
from pfwd_device.recording.payload import MAX_ARRAY_BYTES, MAX_JSON_BYTES, Array
from pfwd_device.text import clean

MAX_READ_BYTES = MAX_JSON_BYTES + 2**20
"""Largest single read from the file, bytes. A text is read in one piece; arrays are read in smaller
chunks."""

MAX_READS_OF_A_FILE = 16
"""Largest number of bytes that may be read, relative to the size of the file. A file whose parts
refer to each other in a circle would be read without end."""

FREE_READ_BYTES = 2**20
"""Number of bytes that may be read in addition, for small files."""

MAX_CHUNK_BYTES = 2**20
"""Largest chunk of a dataset without compression, bytes; those of a drop have 512 KiB, those of a
capture 1 MiB."""

MAX_CHUNKS = 4096
"""Largest number of chunks of a dataset; the largest array has 512."""

MAX_MEMBERS = 2048
"""Largest number of members of a group; a drop has at most 1024 sensors and 1024 rebounds."""

MAX_ATTRIBUTES = 4096
"""Largest number of attributes of an object; 64 channels with 32 calibration values have 2048. The
time that HDF5 takes grows with the square of their number."""

MAX_DEPTH = 4
"""Largest depth of nested objects; a drop has three levels, such as ``sensors/1/values``."""

_VALUES_PER_CHUNK = 65_536
_DTYPES = ("<f8", "<i4", "|u1")
_PART_LENGTH = struct.Struct("<Q")

Attribute = str | int | float


@dataclass(frozen=True, eq=False, slots=True)
class Dataset:
    """Dataset of an HDF5 file: an array or a text, with its attributes."""

    value: Array | str
    attributes: Mapping[str, Attribute] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, slots=True)
class Group:
    """Group of an HDF5 file: its groups and datasets by name, and its attributes."""

    members: Mapping[str, "Group | Dataset"] = field(default_factory=dict)
    attributes: Mapping[str, Attribute] = field(default_factory=dict)


@contextlib.contextmanager
def opened(source: str | os.PathLike[str] | bytes) -> Iterator[Any]:
    """Open an HDF5 file with h5py for reading, with limits on the amount that is read.

    Parameters
    ----------
    source : path or bytes
        Path of the file, or its content.

    Raises
    ------
    RecordingError
        If the path is that of a pipe, a device or a folder, whose reading may never end.
    OSError
        If the file cannot be opened, or is no HDF5 file.
    """
    import h5py

    with contextlib.ExitStack() as stack:
        if isinstance(source, bytes):
            stream: BinaryIO = io.BytesIO(source)
        else:
            if not stat.S_ISREG(os.stat(source).st_mode):
                raise RecordingError("expected a file, got a folder, device or pipe")
            stream = stack.enter_context(open(source, "rb"))
        yield stack.enter_context(h5py.File(_BoundedStream(stream), "r"))


class _BoundedStream(io.RawIOBase):
    """Stream that raises an error if a single read or the sum of all reads exceeds its limit."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._remaining = MAX_READS_OF_A_FILE * stream.seek(0, io.SEEK_END) + FREE_READ_BYTES

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        return self._stream.seek(offset, whence)

    def tell(self) -> int:
        return self._stream.tell()

    def readinto(self, buffer: Any) -> int:
        size = len(buffer)
        self._remaining -= size
        if size > MAX_READ_BYTES:
            raise RecordingError(
                f"expected parts of at most {MAX_READ_BYTES} bytes, got one of {size}"
            )
        if self._remaining < 0:
            raise RecordingError("expected a file that ends, got parts that refer to each other")
        return self._stream.readinto(buffer)  # type: ignore[attr-defined, no-any-return]


def read_group(group: Any, where: str) -> Group:
    """Read the content of an HDF5 file or of one of its groups.

    Parameters
    ----------
    group : h5py.Group
        Open file or group.
    where : str
        Name of the file or group, for messages.

    Raises
    ------
    RecordingError
        If the content has other kinds of objects than this program writes, or exceeds a limit.
    """
    return _Reader().group(group.id, where, MAX_DEPTH)


def read_attribute(group: Any, name: str, where: str) -> Attribute | None:
    """Read one attribute of an open HDF5 file or group of h5py; None if it does not exist."""
    from h5py import h5a

    if not h5a.exists(group.id, name.encode()):
        return None
    return _Reader().attribute(group.id, name.encode(), where)


def digest(group: Group) -> str:
    """Return the SHA-256 of a group as hexadecimal digits: names, structure, types, values.

    It covers the following parts of every object, sorted by path: ``group`` or ``dataset`` and the
    path; for each attribute, sorted by name, ``attribute``, name, type and value; for a dataset
    ``value``, type, shape (lengths in decimals with commas between them) and bytes. Types are
    ``text`` (UTF-8), ``<i8``, ``<f8``, ``<i4`` and ``|u1``. Each part is preceded by its length
    in bytes as an unsigned little-endian number of 64 bits.
    """
    hasher = hashlib.sha256()

    def put(*parts: bytes) -> None:
        hasher.update(b"".join(_PART_LENGTH.pack(len(part)) + part for part in parts))

    for path, item in sorted(_walk("", group)):
        put(b"group" if isinstance(item, Group) else b"dataset", path)
        for name, attribute in sorted(item.attributes.items()):
            put(b"attribute", name.encode(), *_attribute_parts(attribute))
        value = item.value if isinstance(item, Dataset) else None
        if isinstance(value, str):
            put(b"value", b"text", b"", value.encode())
        elif value is not None:
            dtype = value.dtype.newbyteorder("<")
            array = np.ascontiguousarray(value, dtype)
            put(b"value", dtype.str.encode(), ",".join(map(str, value.shape)).encode())
            hasher.update(_PART_LENGTH.pack(array.nbytes))
            hasher.update(array.data.cast("B") if array.size else b"")
    return hasher.hexdigest()


def write_group(target: Any, group: Group) -> None:
    """Write a group into an empty HDF5 file or group, an object of h5py."""
    write_attributes(target, group.attributes)
    for name, item in group.members.items():
        if isinstance(item, Group):
            write_group(target.create_group(name), item)
        else:
            write_dataset(target, name, item)


def write_dataset(target: Any, name: str, dataset: Dataset) -> None:
    """Write a dataset into an HDF5 file or group, an object of h5py.

    Arrays are stored in chunks, with compression and checksums.
    """
    values = dataset.value
    options: dict[str, Any] = {}
    if not isinstance(values, str) and values.size:  # HDF5 has no empty chunks
        rows = max(1, _VALUES_PER_CHUNK // max(1, math.prod(values.shape[1:])))
        options = {
            "chunks": (min(values.shape[0], rows), *values.shape[1:]),
            "compression": "gzip",
            "compression_opts": 1,
            "shuffle": True,
            "fletcher32": True,
        }
    data = _stored_text(values) if isinstance(values, str) else values
    write_attributes(target.create_dataset(name, data=data, **options), dataset.attributes)


def write_attributes(target: Any, attributes: Mapping[str, Attribute]) -> None:
    """Write attributes to an open file, group or dataset of h5py."""
    for name, value in attributes.items():
        if isinstance(value, str):
            target.attrs[name] = _stored_text(value)
        else:
            target.attrs[name] = np.int64(value) if isinstance(value, int) else value


def _stored_text(text: str) -> Any:
    """Return a text as a value of fixed length for h5py; an empty text is one NUL."""
    import h5py

    data = text.encode()
    if b"\0" in data:
        raise RecordingError(f"expected a text without the character NUL, got {text!r:.40}")
    return np.array(data, h5py.string_dtype("utf-8", max(1, len(data))))


def _walk(path: str, item: Group | Dataset) -> Iterator[tuple[bytes, Group | Dataset]]:
    yield path.encode(), item
    if isinstance(item, Group):
        for name, member in item.members.items():
            yield from _walk(f"{path}/{name}", member)


def _attribute_parts(value: Attribute) -> tuple[bytes, bytes]:
    if isinstance(value, str):
        return b"text", value.encode()
    if isinstance(value, int):
        return b"<i8", struct.pack("<q", value)
    return b"<f8", struct.pack("<d", value)


@dataclass(slots=True)
class _Reader:
    """Reader of the objects of an HDF5 file, with limits on the amount that is read."""

    arrays: int = MAX_ARRAY_BYTES
    """Remaining bytes of arrays."""
    texts: int = MAX_JSON_BYTES
    """Remaining bytes of texts, including those of attributes."""
    addresses: set[int] = field(default_factory=set)
    """Addresses of the objects read so far; an object with a second name is refused."""

    def group(self, identity: Any, where: str, depth: int) -> Group:
        attributes = self.attributes(identity, where)
        members = {}
        for link in _links(identity, where, MAX_MEMBERS):
            name = _name(link, where)
            members[name] = self.member(identity, link, f"{where}, {clean(name)}", depth)
        return Group(members, attributes)

    def member(self, parent: Any, link: bytes, where: str, depth: int) -> Group | Dataset:
        """Read the object with a name in a group.

        `depth` is the number of levels of groups that may still follow.
        """
        from h5py import h5d, h5g, h5o

        _require_hard_link(parent, link, where)
        identity = h5o.open(parent, link)
        about = h5o.get_info(identity)
        if about.rc != 1 or about.addr in self.addresses:
            raise RecordingError(
                f"{where}: expected an object with one name, got one with several names"
            )
        self.addresses.add(about.addr)
        if isinstance(identity, h5d.DatasetID):
            return Dataset(self.value(identity, where), self.attributes(identity, where))
        if not isinstance(identity, h5g.GroupID) or depth <= 1:
            raise RecordingError(f"{where}: expected a dataset, got another object")
        return self.group(identity, where, depth - 1)

    def attributes(self, identity: Any, where: str) -> dict[str, Attribute]:
        from h5py import h5a

        count = h5a.get_num_attrs(identity)
        if count > MAX_ATTRIBUTES:
            raise RecordingError(
                f"{where}: expected at most {MAX_ATTRIBUTES} attributes, got {count}"
            )
        if not count:
            return {}
        names: list[bytes] = []
        h5a.iterate(identity, names.append)
        attributes = {_name(name, where): self.attribute(identity, name, where) for name in names}
        if not len(attributes) == len(names) == count:
            raise RecordingError(
                f"{where}: expected every attribute once, got one twice; the file is damaged"
            )
        return attributes

    def attribute(self, identity: Any, name: bytes, where: str) -> Attribute:
        from h5py import h5a, h5s, h5t

        attribute = h5a.open(identity, name)
        kind = attribute.get_type()
        if not kind.committed() and attribute.get_space().get_simple_extent_type() == h5s.SCALAR:
            if _is_text(kind):
                text = self.empty_text(kind, attribute.get_storage_size(), where)
                attribute.read(text, kind)
                return _text(text, where)
            if kind.equal(h5t.IEEE_F64LE):
                number = np.empty((), np.float64)
                attribute.read(number)
                return float(number)
            if kind.equal(h5t.STD_I64LE):
                integer = np.empty((), np.int64)
                attribute.read(integer)
                return int(integer)
        raise RecordingError(
            f"{where}, attribute {clean(name)}: expected a text or a number, got another type"
        )

    def value(self, identity: Any, where: str) -> Array | str:
        """Return the array or text of a dataset; raise RecordingError if it is not acceptable."""
        from h5py import h5s

        # Refuse storage in other files first: even the size of such a dataset is read from them.
        _refuse_storage(identity, where)
        kind, space = identity.get_type(), identity.get_space()
        if kind.committed():
            raise RecordingError(f"{where}: expected a type of its own, got a shared one")
        if _is_text(kind):
            if space.get_simple_extent_type() != h5s.SCALAR:
                raise RecordingError(f"{where}: expected one text, got several")
            text = self.empty_text(kind, identity.get_storage_size(), where)
            identity.read(h5s.ALL, h5s.ALL, text, kind)
            return _text(text, where)
        shape = space.get_simple_extent_dims()
        fixed = space.get_simple_extent_dims(True) == shape
        if space.get_simple_extent_type() != h5s.SIMPLE or not fixed:
            raise RecordingError(f"{where}: expected an array of fixed size, got other data")
        dtype = next((dtype for dtype in _DTYPES if kind.equal(_types()[dtype])), None)
        if dtype is None or len(shape) > 2:
            raise RecordingError(f"{where}: expected an array of numbers, got another type")
        size = math.prod(shape) * np.dtype(dtype).itemsize
        if size > self.arrays:
            raise RecordingError(
                f"{where}: expected at most {MAX_ARRAY_BYTES} bytes of arrays in the file, got "
                f"an array of {size} bytes beyond that"
            )
        self.arrays -= size
        _refuse_chunks(identity, where)
        values = np.empty(shape, dtype)
        if values.size:
            identity.read(h5s.ALL, h5s.ALL, values)
        return values

    def empty_text(self, kind: Any, stored: int, where: str) -> Any:
        """Return memory for a text, of a type and with a number of stored bytes."""
        size = kind.get_size()
        self.texts -= size
        if self.texts < 0:
            raise RecordingError(
                f"{where}: expected at most {MAX_JSON_BYTES} bytes of texts, got more"
            )
        if size != stored:
            raise RecordingError(f"{where}: expected a text of {size} bytes, got {stored}")
        return np.empty((), f"V{size}")


def _text(stored: Any, where: str) -> str:
    data = stored.tobytes()
    if data == b"\0":  # HDF5 has no texts of no bytes
        return ""
    if b"\0" in data:
        raise RecordingError(f"{where}: expected a text without the character NUL, got one with it")
    try:
        return str(data, "utf-8")
    except UnicodeDecodeError as err:
        raise RecordingError(f"{where}: expected text in UTF-8, got other bytes") from err


def _links(identity: Any, where: str, limit: int) -> list[bytes]:
    count = identity.get_num_objs()
    if count > limit:
        raise RecordingError(f"{where}: expected at most {limit} names, got {count}")
    names: list[bytes] = []
    identity.links.iterate(names.append)
    if len(set(names)) != len(names):
        raise RecordingError(
            f"{where}: expected every name once, got one twice; the file is damaged"
        )
    return sorted(names)


def _require_hard_link(parent: Any, link: bytes, where: str) -> None:
    from h5py import h5l

    if not parent.links.exists(link):
        raise RecordingError(f"{where}: expected an object in the file, got none")
    if parent.links.get_info(link).type != h5l.TYPE_HARD:
        raise RecordingError(
            f"{where}: expected an object in the file itself, got a link to another place"
        )


def _refuse_storage(identity: Any, where: str) -> None:
    """Raise RecordingError for a dataset with values in other files or with unknown filters.

    HDF5 opens other files when it reads such values, and for a view of several datasets even when
    it reads the size.

    Parameters
    ----------
    identity : h5py.h5d.DatasetID
    where : str
        Name of the file and dataset, for messages.
    """
    from h5py import h5d, h5z

    settings = identity.get_create_plist()
    if settings.get_layout() not in (h5d.COMPACT, h5d.CONTIGUOUS, h5d.CHUNKED):
        raise RecordingError(f"{where}: expected values, got a view of other datasets")
    if settings.get_external_count():
        raise RecordingError(f"{where}: expected values in the file, got those of another file")
    filters = tuple(settings.get_filter(n)[0] for n in range(settings.get_nfilters()))
    all_filters = (h5z.FILTER_SHUFFLE, h5z.FILTER_DEFLATE, h5z.FILTER_FLETCHER32)
    if filters not in ((), (h5z.FILTER_DEFLATE,), all_filters):
        raise RecordingError(f"{where}: expected gzip or no filter, got filters {filters[:8]}")


def _refuse_chunks(identity: Any, where: str) -> None:
    """Raise RecordingError for chunks that are too large, or larger than announced when unpacked.

    The HDF5 library unpacks without a limit, so a few bytes could fill the memory.

    Parameters
    ----------
    identity : h5py.h5d.DatasetID
    where : str
        Name of the file and dataset, for messages.
    """
    from h5py import h5d, h5z

    settings = identity.get_create_plist()
    if settings.get_layout() != h5d.CHUNKED:
        return
    filters = [settings.get_filter(n)[0] for n in range(settings.get_nfilters())]
    chunk, shape = settings.get_chunk(), identity.shape
    size = math.prod(chunk) * identity.get_type().get_size()
    limit = math.prod(-(-length // step) for length, step in zip(shape, chunk, strict=True))
    if size > MAX_CHUNK_BYTES or limit > MAX_CHUNKS:
        raise RecordingError(
            f"{where}: expected at most {MAX_CHUNKS} chunks of up to 1 MiB, got {limit} chunks of "
            f"{size} bytes"
        )
    count = identity.get_num_chunks()
    if count > limit:
        raise RecordingError(f"{where}: expected at most {limit} chunks, got {count}")
    if h5z.FILTER_DEFLATE not in filters:
        return
    packed = filters.index(h5z.FILTER_DEFLATE)
    for number in range(count):
        about = identity.get_chunk_info(number)
        if about.size > 2 * MAX_CHUNK_BYTES:
            raise RecordingError(f"{where}: expected chunks of at most 1 MiB, got a longer one")
        mask, data = identity.read_direct_chunk(about.chunk_offset)
        if mask >> packed & 1:
            continue
        try:
            # The decompressor ignores the checksum after the packed bytes.
            unpacked = zlib.decompressobj().decompress(data, size + 1)
        except zlib.error as err:
            raise RecordingError(f"{where}: expected packed values, got {err}") from err
        if len(unpacked) > size:
            raise RecordingError(f"{where}: expected chunks of {size} bytes, got a longer one")


def _is_text(kind: Any) -> bool:
    """Return whether a type is that of the texts that this program writes."""
    from h5py import h5t

    return (
        isinstance(kind, h5t.TypeStringID)
        and not kind.is_variable_str()
        and kind.get_strpad() == h5t.STR_NULLPAD
        and kind.get_cset() == h5t.CSET_UTF8
    )


def _name(name: bytes, where: str) -> str:
    try:
        return name.decode()
    except UnicodeDecodeError as err:
        raise RecordingError(f"{where}: expected names in UTF-8, got {name[:40]!r}") from err


@functools.cache
def _types() -> Mapping[str, Any]:
    """Return the HDF5 types of the arrays that this program writes, by name."""
    from h5py import h5t

    return {
        "<f8": h5t.IEEE_F64LE,
        "<i4": h5t.STD_I32LE,
        "|u1": h5t.STD_U8LE,
    }
