"""Files of drops: whatever of them a reader could see changed is refused, with one line."""

import functools
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from pfwd_device import Channel, Drop
from pfwd_device.errors import RecordingError
from pfwd_device.recording import DropRecord, drop_file, hdf5_tree
from pfwd_device.recording.drop_file import (
    DIGEST,
    MAX_CALIBRATION_ATTRIBUTES,
    drop_file_bytes,
    drop_from_file_bytes,
    read_drop_file,
)
from pfwd_device.recording.hdf5_tree import opened, read_group
from pfwd_device.recording.payload import MAX_ARRAY_BYTES
from tests.hdf5_visible import visible
from tests.pfwd_device.recording.make_recording import values

SURVEY = bytes(range(16))

EVERYDAY_STEP = 1607
"""Every so many bits of a file are turned in the everyday run; a prime, so that all eight of a byte
come up."""


def described() -> DropRecord:
    """A drop with a rebound, and with what is repeated as attributes."""
    plain = values(2)
    channels = [
        {"name": "load", "role": "load", "offset": 0.0, "serial_number": "L 7"},
        {"name": "g1", "role": "geophone", "offset": 0.3, "counts_per_unit": 1.5e6},
    ]
    metadata = {**plain.metadata, "identity": {"serial_number": "7", "channels": channels}}
    return DropRecord(
        plain.point, plain.drop, plain.counts, plain.declared, metadata, plain.rebounds
    )


@pytest.fixture(scope="module")
def intact() -> bytes:
    return drop_file_bytes(described(), 2, SURVEY)


def refused_or_the_same(data: bytes, before: list[Any]) -> bool:
    """Return whether the file is refused with one line; otherwise its content is unchanged."""
    try:
        drop_from_file_bytes(data, "drop.h5")
    except RecordingError as err:
        text_of_error = str(err)
    else:
        assert visible(data) == before
        return False
    assert text_of_error.startswith("drop.h5")
    assert "\n" not in text_of_error
    return True


def with_bit(data: bytes, bit: int) -> bytes:
    turned = bytearray(data)
    turned[bit // 8] ^= 1 << bit % 8
    return bytes(turned)


@pytest.mark.timeout(7200)
@pytest.mark.parametrize("step", [EVERYDAY_STEP, pytest.param(1, marks=pytest.mark.slow)])
def test_single_bits_that_a_reader_sees_are_noticed(intact: bytes, step: int) -> None:
    before = visible(intact)
    items = [
        refused_or_the_same(with_bit(intact, bit), before)
        for bit in range(0, 8 * len(intact), step)
    ]
    assert sum(items) > 10


def changed(data: bytes, change: Callable[[Any], None]) -> bytes:
    """The file after `change` with h5py."""
    stream = io.BytesIO(data)
    with h5py.File(stream, "r+") as file:
        change(file)
    return stream.getvalue()


def objects(data: bytes) -> list[str]:
    with h5py.File(io.BytesIO(data), "r") as file:
        names = ["/"]
        file.visit(names.append)
    return names


def text(data: bytes, **options: Any) -> Any:
    """A text as the program stores it, or with other properties."""
    return np.array(data, h5py.string_dtype(options.get("set", "utf-8"), len(data)))


def test_every_attribute_that_is_changed_removed_or_added_is_refused(intact: bytes) -> None:
    def changed_value(value: Any) -> Any:
        return text(value + b"x") if isinstance(value, bytes) else -value - 1

    tried = 0
    for path in objects(intact):
        with h5py.File(io.BytesIO(intact), "r") as file:
            names = list(file[path].attrs)

        def add(file: Any, path: str = path) -> None:
            file[path].attrs["more"] = 1.0

        changes: list[Callable[[Any], None]] = [add]
        for name in names:

            def change(file: Any, path: str = path, name: str = name) -> None:
                file[path].attrs[name] = changed_value(file[path].attrs[name])

            def remove(file: Any, path: str = path, name: str = name) -> None:
                del file[path].attrs[name]

            def rename(file: Any, path: str = path, name: str = name) -> None:
                h5py.h5a.rename(file[path].id, name.encode(), name[:-1].encode() + b"_")

            def retype(file: Any, path: str = path, name: str = name) -> None:
                value = file[path].attrs[name]
                retyped = value.decode() if isinstance(value, bytes) else text(str(value).encode())
                file[path].attrs[name] = retyped

            changes += [change, remove, rename, retype]
        for make in changes:
            tried += 1
            with pytest.raises(RecordingError, match=r"^drop\.h5.*expected .*, got ") as caught:
                drop_from_file_bytes(changed(intact, make), "drop.h5")
            assert "\n" not in str(caught.value)
    assert tried > 150


def test_another_version_is_refused(intact: bytes) -> None:
    for changed_value, expected in (
        (1, "1"),
        (2, "2"),
        (4, "4"),
        (text(b"3"), "'3'"),
        (2.5, "2.5"),
    ):

        def odd(file: Any, changed_value: Any = changed_value) -> None:
            file.attrs["format_version"] = changed_value
            file.attrs["something"] = np.arange(3)

        with pytest.raises(RecordingError, match=f"expected format version 3 .*, got {expected}$"):
            drop_from_file_bytes(changed(intact, odd), "drop.h5")


def put(name: str, value: Any) -> Callable[[Any], None]:
    """Put a value in the place of an object, or what a function makes of the file."""

    def change(file: Any) -> None:
        new = value(file) if callable(value) else value
        if name in file:
            del file[name]
        if new is not None:
            file[name] = new

    return change


def array(**options: Any) -> Callable[[Any], None]:
    """Store the load with other options."""

    def change(file: Any) -> None:
        del file["load"]
        file.create_dataset("load", **{"data": np.zeros(24), **options})

    return change


def virtual(file: Any) -> None:
    layout = h5py.VirtualLayout(shape=(24,), dtype="f8")
    layout[:] = h5py.VirtualSource("elsewhere.h5", "load", shape=(24,))
    del file["load"]
    file.create_virtual_dataset("load", layout)


def committed(file: Any) -> None:
    file["kind"] = np.dtype("f8")
    array(dtype=file["kind"])(file)


def padded(padding: int) -> Callable[[Any], None]:
    def change(file: Any) -> None:
        kind = h5py.h5t.C_S1.copy()
        kind.set_size(3)
        kind.set_strpad(padding)
        kind.set_cset(h5py.h5t.CSET_UTF8)
        space = h5py.h5s.create(h5py.h5s.SCALAR)
        del file["declared"]
        text = h5py.h5d.create(file.id, b"declared", kind, space)
        text.write(h5py.h5s.ALL, h5py.h5s.ALL, np.array(b"{} ", "S3"), kind)

    return change


ELSEWHERE: dict[str, Callable[[Any], Any]] = {
    "external link": put("load", h5py.ExternalLink("a.h5", "load")),
    "soft link": put("load", h5py.SoftLink("/time")),
    "hard link": put("load", lambda file: file["time"]),
    "circle of groups": put("sensors/2", lambda file: file["sensors"]),
    "view of another file": virtual,
    "storage elsewhere": array(
        data=None, shape=(24,), dtype="f8", external=[("elsewhere.bin", 0, 192)]
    ),
    "shared type": committed,
    "references": lambda file: array(data=[file["time"].ref] * 24, dtype=h5py.ref_dtype)(file),
    "other filter": array(compression="lzf"),
    "growing array": array(maxshape=(None,)),
    "other number": array(data=np.zeros(24, "f4")),
    "several texts": put("declared", ["{}", "{}"]),
    "text of variable length": put("declared", "{}"),
    "text in ASCII": put("declared", text(b"{}", set="ascii")),
    "text with spaces": padded(h5py.h5t.STR_SPACEPAD),
    "text with an end": padded(h5py.h5t.STR_NULLTERM),
    "text with NUL": put("declared", text(b"{}\0")),
    "dataset for a group": put("sensors", np.zeros(3)),
    "group for a dataset": lambda file: (put("load", None)(file), file.create_group("load")),
    "empty attribute": lambda file: file.attrs.__setitem__("point", h5py.Empty("f8")),
    "array as attribute": lambda file: file.attrs.__setitem__("point", np.arange(3.0)),
}


@pytest.mark.parametrize("kind", ELSEWHERE)
def test_a_reference_to_another_file_is_refused_unread(
    kind: str, intact: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # names of other files are taken from here
    path = tmp_path / "drop.h5"
    path.write_bytes(changed(intact, ELSEWHERE[kind]))
    for name in ("a.h5", "elsewhere.h5"):
        with h5py.File(tmp_path / name, "w") as file:
            file["load"] = np.zeros(24)
    (tmp_path / "elsewhere.bin").write_bytes(bytes(192))
    with pytest.raises(RecordingError, match=r"drop\.h5.*expected .*, got ") as caught:
        read_drop_file(path)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_no_drop_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("no HDF5")
    with pytest.raises(RecordingError, match="an intact drop file, got damage"):
        read_drop_file(tmp_path / "text")
    with pytest.raises(RecordingError, match="expected a file, got a folder, device or pipe"):
        read_drop_file(tmp_path)
    with pytest.raises(RecordingError, match="expected a readable drop file"):
        read_drop_file(tmp_path / "none.h5")


def test_the_digest_is_made_as_it_is_documented(intact: bytes) -> None:
    """Computed once more by the words of the documentation, with h5py alone."""
    import hashlib

    def part(data: bytes) -> bytes:
        return len(data).to_bytes(8, "little") + data

    def attribute(name: str, value: Any) -> bytes:
        if isinstance(value, bytes):
            kind, data = b"text", bytes(value)
        else:
            kind, data = value.dtype.str.encode(), value.tobytes()
        return part(b"attribute") + part(name.encode()) + part(kind) + part(data)

    with h5py.File(io.BytesIO(intact), "r") as file:
        items = {"": file}
        file.visititems(lambda name, item: items.__setitem__(f"/{name}", item))
        content = b""
        for path in sorted(items, key=str.encode):
            item = items[path]
            kind = b"dataset" if isinstance(item, h5py.Dataset) else b"group"
            content += part(kind) + part(path.encode())
            for name in sorted(set(item.attrs) - {DIGEST}):
                content += attribute(name, item.attrs[name])
            if kind == b"dataset":
                value = item[()]
                shape = ",".join(map(str, item.shape)).encode()
                dtype = b"text" if isinstance(value, bytes) else item.dtype.str.encode()
                data = value if isinstance(value, bytes) else value.tobytes()
                content += part(b"value") + part(dtype) + part(shape) + part(data)
        assert hashlib.sha256(content).hexdigest() == file.attrs[DIGEST].decode()


def test_the_largest_drop_that_is_real_fits() -> None:
    # 8 channels and the load, 10 s at 50 kHz: times and loads, values, counts.
    samples = 10 * 50_000
    assert 2 * samples * (2 * 8 + 8 * 8 + 9 * 4) <= MAX_ARRAY_BYTES


def test_the_number_of_attributes_is_limited() -> None:
    facts = {f"fact {n}": float(n) for n in range(40)}
    metadata = {"identity": {"channels": [facts] * 100}}
    drop = Drop(1, np.arange(4.0), np.zeros(4), (Channel(0.0, "velocity", np.zeros(4)),))
    record = DropRecord("P", drop, np.zeros((4, 1), np.int32), {}, metadata)
    data = drop_file_bytes(record, 1, SURVEY)
    with h5py.File(io.BytesIO(data), "r") as file:
        assert len(file["counts"].attrs) == MAX_CALIBRATION_ATTRIBUTES + 1
    assert drop_from_file_bytes(data, "drop.h5")[0].metadata == metadata
    assert MAX_CALIBRATION_ATTRIBUTES < hdf5_tree.MAX_ATTRIBUTES


def test_what_is_read_of_a_file_is_limited(intact: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    with opened(intact) as file:
        tree = read_group(file, "drop.h5")
    sizes = {"arrays": 0, "texts": 0}
    groups: list[Any] = [tree]
    for item in groups:
        groups += getattr(item, "members", {}).values()
        value = getattr(item, "value", b"")
        texts = [text for text in (value, *item.attributes.values()) if isinstance(text, str)]
        sizes["texts"] += sum(len(text.encode()) for text in texts)
        sizes["arrays"] += value.nbytes if isinstance(value, np.ndarray) else 0
    for short in (None, "arrays", "texts"):
        limits = {name: size - (name == short) for name, size in sizes.items()}
        reader = functools.partial(hdf5_tree._Reader, **limits)
        with monkeypatch.context() as patch, opened(intact) as file:
            patch.setattr(hdf5_tree, "_Reader", reader)
            if short is None:
                read_group(file, "drop.h5")
                continue
            with pytest.raises(RecordingError, match="expected at most"):
                read_group(file, "drop.h5")


def test_text_that_is_not_utf_8_is_refused(intact: bytes) -> None:
    broken = intact.replace(b"T. \xc3\x9cnal", b"T. \xff\xffnal")
    assert broken != intact
    with pytest.raises(RecordingError, match="expected text in UTF-8, got other bytes"):
        drop_from_file_bytes(broken, "drop.h5")


def test_changed_names_are_refused(intact: bytes) -> None:
    start = 8 * intact.find(b"load\0")
    for bit, reason in ((0, "an object in the file"), (7, "names in UTF-8")):
        with pytest.raises(RecordingError, match=f"expected {reason}, got"):
            drop_from_file_bytes(with_bit(intact, start + bit), "drop.h5")


def test_values_that_are_not_packed_are_read(intact: bytes) -> None:
    def unpack(file: Any) -> None:
        file["load"].id.write_direct_chunk((0,), file["load"][:].tobytes(), filter_mask=0xF)

    assert visible(changed(intact, unpack)) == visible(intact)
    assert drop_from_file_bytes(changed(intact, unpack), "drop.h5")[1] == 2


def test_values_that_do_not_unpack_are_refused(intact: bytes) -> None:
    with h5py.File(io.BytesIO(intact), "r") as file:
        start = file["load"].id.get_chunk_info(0).byte_offset
    broken = bytearray(intact)
    broken[start] ^= 0xFF  # the first byte of what gzip wrote
    with pytest.raises(RecordingError, match="expected packed values, got"):
        drop_from_file_bytes(bytes(broken), "drop.h5")


def test_an_update_of_the_package_during_a_recording_changes_no_digest(
    monkeypatch: pytest.MonkeyPatch, make_drop: Callable[..., Drop]
) -> None:
    versions = iter(["1.2.0", None, "1.3.0"])
    monkeypatch.setattr("importlib.metadata.version", lambda _name: next(versions))
    record = DropRecord("A", make_drop(), None, {})
    drop_file.software_version.cache_clear()
    try:
        assert len({drop_file.drop_digest(record, 1) for _ in range(3)}) == 1
        assert drop_file.software_version() == "1.2.0"
        drop_file.software_version.cache_clear()
        assert drop_file.software_version() == "unknown"
    finally:
        drop_file.software_version.cache_clear()
