"""What a reader sees of an HDF5 file: looked at before it is read, bounded, written, its digest.

An HDF5 file may point outside (links, storage and datasets of other files), promise more than there
is memory, or have bytes whose change nobody notices. Here a file is opened through a stream that
refuses long reads, every object is looked at before anything is read through it, and only what
this program writes is taken: hard links, numbers of 8, 32 and 64 bits, texts, its own filters.
h5py is imported by the functions that need it; recording does without.
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
from pfwd_device.recording.hdf5_texts import StoredTexts
from pfwd_device.recording.payload import LARGEST_ARRAYS, LARGEST_JSON, Array
from pfwd_device.text import clean

LARGEST_READ = LARGEST_JSON + 2**20
"""Bytes that HDF5 may ask for at once. A text is read in one piece together with what HDF5 stores
beside it, so this is the longest text; arrays come in chunks that are smaller."""

READS_OF_A_FILE = 16
"""How often a file may be read over before something in it is taken to lead in circles."""

FREE_READS = 2**20
"""Bytes that any file may be read for besides, however small it is."""

LARGEST_CHUNK = 2**20
"""Bytes, unpacked; those of a drop have 512 KiB, those of a capture 1 MiB."""

MOST_CHUNKS = 4096
"""Of a dataset; an array of the largest size has 512."""

MOST_MEMBERS = 2048
"""Of a group; a drop has at most 1024 sensors and as many rebounds."""

MOST_ATTRIBUTES = 4096
"""Of an object; counts of 64 channels with 32 facts each have 2048. HDF5 takes the square of their
number in time."""

DEEPEST = 4
"""Groups within each other; a drop has three, such as ``sensors/1/values``."""

_CHUNK = 65_536
_DTYPES = ("<f8", "<i4", "|u1")
_LENGTH = struct.Struct("<Q")

Attribute = str | int | float


@dataclass(frozen=True, eq=False, slots=True)
class Dataset:
    """An array or a text with its attributes."""

    value: Array | str
    attributes: Mapping[str, Attribute] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, slots=True)
class Group:
    """Groups and datasets by name, with the attributes of the group."""

    members: Mapping[str, "Group | Dataset"] = field(default_factory=dict)
    attributes: Mapping[str, Attribute] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Place:
    """A file, group or dataset that is open to be read, and not looked at yet."""

    item: Any
    """Of h5py."""
    texts: StoredTexts
    """Of the file."""


@contextlib.contextmanager
def opened(source: str | os.PathLike[str] | bytes) -> Iterator[Place]:
    """An HDF5 file opened for reading through a stream that refuses what is too long.

    Parameters
    ----------
    source : path of a file, or the bytes of one

    Raises
    ------
    RecordingError
        If it is a pipe, a device or a folder, which may wait for ever.
    OSError
        If it cannot be opened, or is no HDF5.
    """
    import h5py

    with contextlib.ExitStack() as stack:
        if isinstance(source, bytes):
            stream: BinaryIO = io.BytesIO(source)
        else:
            if not stat.S_ISREG(os.stat(source).st_mode):
                raise RecordingError("expected a file, got a folder, device or pipe")
            stream = stack.enter_context(open(source, "rb"))
        file = stack.enter_context(h5py.File(_BoundedStream(stream), "r"))
        yield Place(file, StoredTexts(stream, LARGEST_READ))


class _BoundedStream(io.RawIOBase):
    """Passes reads on; refuses single ones that are too long, and files that are read for ever."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._left = READS_OF_A_FILE * stream.seek(0, io.SEEK_END) + FREE_READS

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
        self._left -= size
        if size > LARGEST_READ:
            raise RecordingError(
                f"expected parts of at most {LARGEST_READ} bytes, got one of {size}"
            )
        if self._left < 0:
            raise RecordingError("expected a file that ends, got one that leads in circles")
        return self._stream.readinto(buffer)  # type: ignore[attr-defined, no-any-return]


@dataclass(slots=True)
class Allowance:
    """What may still be read of a file."""

    arrays: int = LARGEST_ARRAYS
    """Bytes of arrays."""
    texts: int = LARGEST_JSON
    """Bytes of texts, those of attributes with them."""
    seen: set[int] = field(default_factory=set)
    """Addresses of objects that were met: each has one place."""


def read_group(group: Place, where: str, allowance: Allowance | None = None) -> Group:
    """All that a reader sees in an HDF5 file or one of its groups.

    Parameters
    ----------
    group : Place
    where : str
        For messages.
    allowance : Allowance, optional
        How much may be read; less is left of it afterwards.

    Raises
    ------
    RecordingError
        If there is anything that this program does not write, or more than it writes.
    """
    reader = _Reader(group.texts, allowance or Allowance())
    return reader.group(group.item.id, where, DEEPEST)


def read_dataset(group: Place, name: str, where: str) -> Dataset:
    """A dataset at a path within a group, with its attributes; else as `read_group`."""
    folder, _, last = name.rpartition("/")
    parent = find(group, folder, where) if folder else group
    if parent is None:
        raise RecordingError(f"{where}, {name}: expected it in the file, got nothing")
    reader = _Reader(group.texts, Allowance())
    found = reader.member(parent.item.id, last.encode(), f"{where}, {name}", 0)
    if not isinstance(found, Dataset):
        raise RecordingError(f"{where}, {name}: expected a dataset, got a group")
    return found


def read_attributes(place: Place, where: str) -> dict[str, Attribute]:
    """The attributes of an object; parameters and errors as for `read_group`."""
    return _Reader(place.texts, Allowance()).attributes(place.item.id, where)


def read_attribute(place: Place, name: str, where: str) -> Attribute | None:
    """One attribute of an object, or None where there is none of the name."""
    from h5py import h5a

    if not h5a.exists(place.item.id, name.encode()):
        return None
    reader = _Reader(place.texts, Allowance())
    stored = reader.stored(place.item.id)
    return reader.attribute(place.item.id, name.encode(), stored, where)


def find(group: Place, path: str, where: str) -> Place | None:
    """What stands at a path within a group, opened but not read; None: nothing.

    Raises
    ------
    RecordingError
        If the path leads through a link to another place.
    """
    item = group.item
    for part in path.split("/"):
        if not item.id.links.exists(part.encode()):
            return None
        _refuse_other_link(item.id, part.encode(), f"{where}, {clean(part)}")
        item = item[part]
    return Place(item, group.texts)


def member_names(group: Place, where: str, most: int = MOST_MEMBERS) -> list[str]:
    """Names in a group, sorted; parameters and errors as for `read_group`."""
    return [_name(name, where) for name in _links(group.item.id, where, most)]


def digest(group: Group) -> str:
    """SHA-256 of a group: names, structure, types, values.

    Of every object, sorted by path, come the parts ``group`` or ``dataset`` and the path, then of
    each attribute, sorted by name, ``attribute``, name, type and value, and of a dataset
    ``value``, type, shape (lengths in decimals with commas between them) and bytes. Types are
    ``text`` (UTF-8), ``<i8``, ``<f8``, ``<i4`` and ``|u1``. Each part is preceded by its length
    in bytes as an unsigned little-endian number of 64 bits.
    """
    found = hashlib.sha256()

    def put(*parts: bytes) -> None:
        found.update(b"".join(_LENGTH.pack(len(part)) + part for part in parts))

    for path, item in sorted(_walk("", group)):
        put(b"group" if isinstance(item, Group) else b"dataset", path)
        for name, said in sorted(item.attributes.items()):
            put(b"attribute", name.encode(), *_attribute_parts(said))
        value = item.value if isinstance(item, Dataset) else None
        if isinstance(value, str):
            put(b"value", b"text", b"", value.encode())
        elif value is not None:
            dtype = value.dtype.newbyteorder("<")
            array = np.ascontiguousarray(value, dtype)
            put(b"value", dtype.str.encode(), ",".join(map(str, value.shape)).encode())
            found.update(_LENGTH.pack(array.nbytes))
            found.update(array.data.cast("B") if array.size else b"")
    return found.hexdigest()


def write_group(target: Any, group: Group) -> None:
    """Write a group into an HDF5 file or group, which is empty."""
    write_attributes(target, group.attributes)
    for name, item in group.members.items():
        if isinstance(item, Group):
            write_group(target.create_group(name), item)
        else:
            write_dataset(target, name, item)


def write_dataset(target: Any, name: str, dataset: Dataset) -> None:
    """Write a dataset into an HDF5 file or group: arrays chunked, packed, with checksums."""
    values = dataset.value
    options: dict[str, Any] = {}
    if not isinstance(values, str) and values.size:  # HDF5 has no chunks of nothing
        rows = max(1, _CHUNK // max(1, math.prod(values.shape[1:])))
        options = {
            "chunks": (min(values.shape[0], rows), *values.shape[1:]),
            "compression": "gzip",
            "compression_opts": 1,
            "shuffle": True,
            "fletcher32": True,
        }
    write_attributes(target.create_dataset(name, data=values, **options), dataset.attributes)


def write_attributes(target: Any, attributes: Mapping[str, Attribute]) -> None:
    """Give attributes to an open HDF5 object."""
    for name, value in attributes.items():
        target.attrs[name] = np.int64(value) if isinstance(value, int) else value


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


@dataclass(frozen=True, slots=True)
class _Reader:
    """Reads the objects of a file as long as it is allowed to."""

    texts: StoredTexts
    allowance: Allowance

    def group(self, identity: Any, where: str, depth: int) -> Group:
        attributes = self.attributes(identity, where)
        members = {}
        for link in _links(identity, where, MOST_MEMBERS):
            name = _name(link, where)
            members[name] = self.member(identity, link, f"{where}, {clean(name)}", depth)
        return Group(members, attributes)

    def member(self, parent: Any, link: bytes, where: str, depth: int) -> Group | Dataset:
        """What a link leads to; `depth`: how many groups may stand within each other."""
        from h5py import h5d, h5g, h5o

        _refuse_other_link(parent, link, where)
        identity = h5o.open(parent, link)
        about = h5o.get_info(identity)
        if about.rc != 1 or about.addr in self.allowance.seen:
            raise RecordingError(
                f"{where}: expected an object with one place, got one with several"
            )
        self.allowance.seen.add(about.addr)
        if isinstance(identity, h5d.DatasetID):
            return Dataset(self.value(identity, where), self.attributes(identity, where))
        if not isinstance(identity, h5g.GroupID) or depth <= 1:
            raise RecordingError(f"{where}: expected a dataset, got another object")
        return self.group(identity, where, depth - 1)

    def attributes(self, identity: Any, where: str) -> dict[str, Attribute]:
        from h5py import h5a

        count = h5a.get_num_attrs(identity)
        if count > MOST_ATTRIBUTES:
            raise RecordingError(
                f"{where}: expected at most {MOST_ATTRIBUTES} attributes, got {count}"
            )
        if not count:
            return {}
        names: list[bytes] = []
        h5a.iterate(identity, names.append)
        stored = self.stored(identity)
        found = {
            _name(name, where): self.attribute(identity, name, stored, where) for name in names
        }
        if len(found) != len(names) or len(stored) != len(names):
            raise RecordingError(f"{where}: expected every attribute once, got one twice")
        return found

    def stored(self, identity: Any) -> dict[bytes, bytes]:
        """The attributes as they stand in the file, by name."""
        from h5py import h5o

        return self.texts.of_attributes(h5o.get_info(identity).addr)

    def attribute(
        self, identity: Any, name: bytes, stored: Mapping[bytes, bytes], where: str
    ) -> Attribute:
        from h5py import h5a, h5s, h5t

        attribute = h5a.open(identity, name)
        kind = attribute.get_type()
        if not kind.committed() and attribute.get_space().get_simple_extent_type() == h5s.SCALAR:
            if _is_text(kind):
                return self.text(self.texts.text(stored.get(name, b"")), where)
            if kind.equal(h5t.IEEE_F64LE):
                number = np.empty((), np.float64)
                attribute.read(number)
                return float(number)
            if kind.equal(h5t.STD_I64LE):
                whole = np.empty((), np.int64)
                attribute.read(whole)
                return int(whole)
        raise RecordingError(
            f"{where}, attribute {clean(name)}: expected a text or a number, got another thing"
        )

    def value(self, identity: Any, where: str) -> Array | str:
        """The array or text of a dataset."""
        from h5py import h5s

        # What leads out of the file is looked for first: the size of such a dataset is asked
        # outside.
        refuse_storage(identity, where)
        kind, space = identity.get_type(), identity.get_space()
        if kind.committed():
            raise RecordingError(f"{where}: expected a type of its own, got a shared one")
        if _is_text(kind):
            offset = identity.get_offset()
            if space.get_simple_extent_type() != h5s.SCALAR or offset is None:
                raise RecordingError(f"{where}: expected one text, got several")
            return self.text(self.texts.at(offset), where)
        shape = space.get_simple_extent_dims()
        fixed = space.get_simple_extent_dims(True) == shape
        if space.get_simple_extent_type() != h5s.SIMPLE or not fixed:
            raise RecordingError(f"{where}: expected an array of fixed size, got another thing")
        dtype = next((dtype for dtype in _DTYPES if kind.equal(_types()[dtype])), None)
        if dtype is None or len(shape) > 2:
            raise RecordingError(f"{where}: expected an array of numbers, got another type")
        size = math.prod(shape) * np.dtype(dtype).itemsize
        if size > self.allowance.arrays:
            raise RecordingError(
                f"{where}: expected at most {LARGEST_ARRAYS} bytes of arrays, got {size} in this"
            )
        self.allowance.arrays -= size
        refuse_chunks(identity, where)
        values = np.empty(shape, dtype)
        if values.size:
            identity.read(h5s.ALL, h5s.ALL, values)
        return values

    def text(self, data: bytes, where: str) -> str:
        self.allowance.texts -= len(data)
        if self.allowance.texts < 0:
            raise RecordingError(
                f"{where}: expected at most {LARGEST_JSON} bytes of texts, got more"
            )
        try:
            return data.decode()
        except UnicodeDecodeError as err:
            raise RecordingError(f"{where}: expected text in UTF-8, got other bytes") from err


def _links(identity: Any, where: str, most: int) -> list[bytes]:
    count = identity.get_num_objs()
    if count > most:
        raise RecordingError(f"{where}: expected at most {most} names, got {count}")
    names: list[bytes] = []
    identity.links.iterate(names.append)
    if len(set(names)) != len(names):
        raise RecordingError(f"{where}: expected every name once, got one twice")
    return sorted(names)


def _refuse_other_link(parent: Any, link: bytes, where: str) -> None:
    from h5py import h5l

    if not parent.links.exists(link):
        raise RecordingError(f"{where}: expected it in the file, got nothing")
    if parent.links.get_info(link).type != h5l.TYPE_HARD:
        raise RecordingError(
            f"{where}: expected what the file itself holds, got a link to another place"
        )


def refuse_storage(identity: Any, where: str) -> None:
    """Refuse a dataset whose values are elsewhere, or are not packed as this program packs them.

    HDF5 opens other files when values are read, and where datasets are joined to a view even when
    its size is asked for.
    """
    from h5py import h5d, h5z

    settings = identity.get_create_plist()
    if settings.get_layout() not in (h5d.COMPACT, h5d.CONTIGUOUS, h5d.CHUNKED):
        raise RecordingError(f"{where}: expected values, got a view of other datasets")
    if settings.get_external_count():
        raise RecordingError(f"{where}: expected values in the file, got those of another file")
    filters = tuple(settings.get_filter(n)[0] for n in range(settings.get_nfilters()))
    usual = (h5z.FILTER_SHUFFLE, h5z.FILTER_DEFLATE, h5z.FILTER_FLETCHER32)
    if filters not in ((), (h5z.FILTER_DEFLATE,), usual):
        raise RecordingError(f"{where}: expected gzip or nothing, got filters {filters[:8]}")


def refuse_chunks(identity: Any, where: str) -> None:
    """Refuse chunks that are larger than ours, or unpack to more than they say.

    HDF5 unpacks whatever is there, however long it becomes.
    """
    from h5py import h5d, h5z

    settings = identity.get_create_plist()
    if settings.get_layout() != h5d.CHUNKED:
        return
    filters = [settings.get_filter(n)[0] for n in range(settings.get_nfilters())]
    chunk, shape = settings.get_chunk(), identity.shape
    size = math.prod(chunk) * identity.get_type().get_size()
    most = math.prod(-(-length // step) for length, step in zip(shape, chunk, strict=True))
    if size > LARGEST_CHUNK or most > MOST_CHUNKS:
        raise RecordingError(f"{where}: expected chunks of at most 1 MiB, got others")
    count = identity.get_num_chunks()
    if count > most:
        raise RecordingError(f"{where}: expected {most} chunks, got {count}")
    if h5z.FILTER_DEFLATE not in filters:
        return
    packed = filters.index(h5z.FILTER_DEFLATE)
    for number in range(count):
        about = identity.get_chunk_info(number)
        if about.size > 2 * LARGEST_CHUNK:
            raise RecordingError(f"{where}: expected chunks of at most 1 MiB, got a longer one")
        mask, data = identity.read_direct_chunk(about.chunk_offset)
        if mask >> packed & 1:
            continue
        try:
            # The checksum behind the packed bytes is left over.
            unpacked = zlib.decompressobj().decompress(data, size + 1)
        except zlib.error as err:
            raise RecordingError(f"{where}: expected packed values, got {err}") from err
        if len(unpacked) > size:
            raise RecordingError(f"{where}: expected chunks of {size} bytes, got a longer one")


def _is_text(kind: Any) -> bool:
    from h5py import h5t

    # HDF5 calls types equal that differ in their character set.
    return bool(kind.equal(_types()["text"]) and kind.get_cset() == h5t.CSET_UTF8)


def _name(name: bytes, where: str) -> str:
    try:
        return name.decode()
    except UnicodeDecodeError as err:
        raise RecordingError(f"{where}: expected names in UTF-8, got {name[:40]!r}") from err


@functools.cache
def _types() -> Mapping[str, Any]:
    """The types that this program writes into arrays and texts."""
    import h5py
    from h5py import h5t

    return {
        "<f8": h5t.IEEE_F64LE,
        "<i4": h5t.STD_I32LE,
        "|u1": h5t.STD_U8LE,
        "text": h5t.py_create(h5py.string_dtype(), logical=True),
    }
