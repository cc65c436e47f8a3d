"""Small files that declare or unpack to far more than a program can hold."""

import json
import os
import struct
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py

GIB = 2**30
DATA = Path(__file__).parent / "data"


@dataclass(frozen=True)
class Attack:
    """Hostile file, and the commands that read it."""

    name: str
    make: Callable[[Path], Path]
    """Function that writes the file into a folder and returns its path."""
    commands: tuple[str, ...] = ("import",)
    """Commands of ``pfwd`` that must reject the file."""
    slow: bool = False
    """True if it takes seconds to make or to reject the file."""
    arguments: tuple[str, ...] = ()
    """Arguments after the file, with its folder as ``{folder}``."""


HEADER = b"# pfwd-traces = 1\n# plate_radius_m = 0.15\n"
NAMES = b"time_s,load_N,velocity_m_s@0.0\n"


def drop_file(folder: Path, change: Callable[[Any], None] | None = None) -> Path:
    path = folder / "drop.h5"
    path.write_bytes((DATA / "recording" / "drops" / "drop-000002.h5").read_bytes())
    if change is not None:
        with h5py.File(path, "r+") as file:
            change(file)
    return path


def _replacement(name: str, **options: Any) -> Callable[[Any], None]:
    def change(file: Any) -> None:
        del file[name]
        file.create_dataset(name, **options)

    return change


def a_gigabyte_of_time(folder: Path) -> Path:
    return drop_file(folder, _replacement("time", shape=(GIB // 8,), dtype="f8", chunks=(65_536,)))


def a_gigabyte_in_a_chunk(folder: Path) -> Path:
    """Make a chunk that declares 192 bytes and unpacks to a gigabyte."""

    def change(file: Any) -> None:
        del file["time"]
        dataset = file.create_dataset("time", (24,), "f8", chunks=(24,), compression="gzip")
        packer = zlib.compressobj(9)
        block = bytes(2**20)
        data = b"".join(packer.compress(block) for _ in range(1024)) + packer.flush()
        dataset.id.write_direct_chunk((0,), data)

    return drop_file(folder, change)


def a_text_of_two_gigabytes(folder: Path) -> Path:
    """Make a text with a declared length of 2 GiB in a sparse file."""
    path = drop_file(folder, lambda file: _text(file, "x" * 5000))
    data = bytearray(path.read_bytes())
    start = data.index(b"x" * 5000)
    at = data.rindex(b"GCOL", 0, start)
    length = 2 * GIB + 5000
    struct.pack_into("<Q", data, at + 8, length + 4096)
    struct.pack_into("<Q", data, start - 8, length)
    place = data.index(struct.pack("<IQ", 5000, at))
    struct.pack_into("<I", data, place, length)
    struct.pack_into("<Q", data, 40, len(data) + length)  # the end, in the superblock
    with path.open("wb") as stream:
        stream.write(data)
        stream.truncate(len(data) + length)
    return path


def _text(file: Any, text: str) -> None:
    del file["declared"]
    file["declared"] = text


def a_pipe_as_storage(folder: Path) -> Path:
    pipe = folder / "pipe"
    os.mkfifo(pipe)  # type: ignore[attr-defined, unused-ignore]
    external = [(str(pipe), 0, 192)]
    return drop_file(folder, _replacement("time", shape=(24,), dtype="f8", external=external))


def a_view_of_itself(folder: Path) -> Path:
    def change(file: Any) -> None:
        del file["time"]
        layout = h5py.VirtualLayout((GIB,), "f8")
        layout[:] = h5py.VirtualSource(".", "time", (GIB,))
        file.create_virtual_dataset("time", layout)

    return drop_file(folder, change)


def groups_without_end(folder: Path) -> Path:
    def change(file: Any) -> None:
        parent = file.create_group("more")
        for number in range(20_000):
            parent[str(number)] = h5py.SoftLink("/time")

    return drop_file(folder, change)


def attributes_without_end(folder: Path) -> Path:
    def change(file: Any) -> None:
        for number in range(5000):
            file["time"].attrs.create(str(number), 1.0)

    return drop_file(folder, change)


def packed(folder: Path, manifest: str) -> Path:
    """Make a survey file with a given manifest."""
    path = folder / "survey.pfwdz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("pfwd-survey.json", manifest)
    return path


def deep_lists(folder: Path) -> Path:
    return packed(folder, '{"files":' + "[" * 100_000)


def directory_without_end(folder: Path, members: int = 2_000_000) -> Path:
    """Make a survey file whose directory names its first member many times."""
    path = packed(folder, "{}")
    data = path.read_bytes()
    start, end = data.index(b"PK\x01\x02"), data.index(b"PK\x05\x06")
    entry = (
        data[start:end].replace(b"pfwd-survey.json", b"a").replace(b"\x10\0\0\0", b"\1\0\0\0", 1)
    )
    fields = list(struct.unpack("<4s4H2IH", data[end:]))
    fields[5:7] = [len(entry) * members, start]
    path.write_bytes(data[:start] + entry * members + struct.pack("<4s4H2IH", *fields))
    return path


def dotted_key(folder: Path) -> Path:
    path = folder / "dotted.csv"
    path.write_bytes(HEADER + b"# " + b"a." * 32_000 + b"a = 1\n" + NAMES)
    return path


def numbers_without_end(folder: Path) -> Path:
    path = folder / "numbers.csv"
    path.write_bytes(HEADER + NAMES + b"0,0,0\n" * 20_000_000)
    return path


def mapped(folder: Path, data: bytes, more: str = "") -> Path:
    (folder / "map.toml").write_text(
        'plate_radius_m = 0.15\n[time]\ncolumn = "t"\nunit = "s"\n[load]\ncolumn = "f"\n'
        'unit = "N"\n[[sensor]]\ncolumn = "v"\nunit = "m/s"\nquantity = "velocity"\n'
        "offset_m = 0.0\n" + more
    )
    path = folder / "log.txt"
    path.write_bytes(b"t,f,v\n" + data)
    return path


def mapped_numbers(folder: Path) -> Path:
    return mapped(folder, b"0,0,0\n" * 20_000_000)


def dotted_map(folder: Path) -> Path:
    return mapped(folder, b"", "[" + "a." * 400_000 + "a]\n")


def archive(folder: Path, members: dict[str, bytes], name: str = "p.dynz") -> Path:
    path = folder / name
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for member, data in members.items():
            file.writestr(member, data)
    return path


def json_of_lists(folder: Path) -> Path:
    return archive(folder, {"database.json": b"[" + b"[]," * 30_000_000 + b"[]]"})


def deep_json(folder: Path) -> Path:
    return archive(folder, {"database.json": b"[" * 1_000_000})


def xml_of(folder: Path, body: bytes) -> Path:
    return archive(folder, {"database.xml": b"<MDDataSet>" + body + b"</MDDataSet>"})


def xml_cells(folder: Path) -> Path:
    return xml_of(folder, b"<R><a>1</a><b>1</b></R>" * 2_700_000)


def xml_attributes(folder: Path) -> Path:
    names = b"".join(b' a%d=">"' % n for n in range(4_000_000))
    return xml_of(folder, b"<R" + names + b"/>")


def xml_laughs(folder: Path) -> Path:
    entities = '<!ENTITY a "ha">' + "".join(
        f'<!ENTITY {chr(98 + n)} "{f"&{chr(97 + n)};" * 10}">' for n in range(10)
    )
    text = f"<!DOCTYPE x [{entities}]><MDDataSet><R><c>&k;</c></R></MDDataSet>"
    return archive(folder, {"database.xml": text.encode()})


def xml_names(folder: Path) -> Path:
    name = b"n" * 100_000
    deep = (b"<" + name + b">") * 20 + b"1" + (b"</" + name + b">") * 20
    return xml_of(folder, b"<R>" + deep * 10 + b"</R>")


def large_directory(folder: Path) -> Path:
    """Make an archive with a second end of directory that declares 300 MB."""
    path = archive(folder, {"database.json": b"{}"})
    data = path.read_bytes()
    end = data.rindex(b"PK\x05\x06")
    entry = data[data.index(b"PK\x01\x02") : end]
    entries = entry * 1_500_000
    record = struct.pack(
        "<4sQHHIIQQQQ", b"PK\x06\x06", 44, 45, 45, 0, 0, 1_500_000, 1_500_000, len(entries), end
    )
    record = data[: end - len(entry)] + entries + record
    record = bytearray(record)
    start = end - len(entry)
    place = start + len(entries)
    struct.pack_into("<Q", record, place + 48, start)
    locator = struct.pack("<4sIQI", b"PK\x06\x07", 0, place, 1)
    path.write_bytes(bytes(record) + locator + data[end:])
    return path


def zeros_in_a_record(folder: Path) -> Path:
    """Make a journal whose drop unpacks to a thousand times its length."""
    import shutil

    from pfwd_device.recording.framing import RecordKind, encode_frame
    from tests.pfwd_device.recording.records import scan_bytes

    survey = folder / "survey"
    shutil.copytree(DATA / "recording", survey)
    journal = survey / "journal" / "0001.pfwdj"
    frames, _ = scan_bytes(journal.read_bytes())
    parts = []
    for frame in frames:
        payload = frame.payload
        if frame.kind == RecordKind.DROP:
            (length,) = struct.unpack_from("<I", payload)
            head = json.loads(payload[4 : 4 + length])
            samples = 60_000_000
            head["arrays"] = [
                {"name": "time", "dtype": "<f8", "shape": [samples]},
                {"name": "sensor 1", "dtype": "|u1", "shape": [8]},
            ]
            text = json.dumps(head).encode()
            packer = zlib.compressobj(9)
            block = bytes(2**20)
            data = b"".join(packer.compress(block) for _ in range(8 * samples // 2**20 + 1))
            payload = struct.pack("<I", len(text)) + text + data + packer.flush()
        parts.append(encode_frame(frame.kind, frame.identity, frame.sequence, payload))
    journal.write_bytes(b"".join(parts))
    (survey / "acknowledged.txt").unlink()
    for path in (survey / "drops").iterdir():
        path.unlink()
    return survey


READING = ("check", "import", "invert")

ATTACKS = (
    Attack("a gigabyte of time", a_gigabyte_of_time, READING),
    Attack("a gigabyte in a chunk", a_gigabyte_in_a_chunk, READING, slow=True),
    Attack("a text of two gigabytes", a_text_of_two_gigabytes, READING),
    Attack("a pipe as storage", a_pipe_as_storage, READING),
    Attack("a view of itself", a_view_of_itself, READING),
    Attack("groups without end", groups_without_end, READING, slow=True),
    Attack("attributes without end", attributes_without_end, READING, slow=True),
    Attack("deep lists", deep_lists, READING),
    Attack("a directory without end", directory_without_end, READING, slow=True),
    Attack("a dotted key", dotted_key, ("import", "invert")),
    Attack("numbers without end", numbers_without_end, slow=True),
    Attack("mapped numbers", mapped_numbers, slow=True, arguments=("--map", "{folder}/map.toml")),
    Attack("a dotted map", dotted_map, arguments=("--map", "{folder}/map.toml")),
    Attack("JSON of lists", json_of_lists, slow=True),
    Attack("deep JSON", deep_json),
    Attack("XML of cells", xml_cells, slow=True),
    Attack("XML of attributes", xml_attributes, slow=True),
    Attack("XML that laughs", xml_laughs),
    Attack("XML of long names", xml_names, slow=True),
    Attack("a directory without end", large_directory, slow=True),
    Attack("zeros in a record", zeros_in_a_record, ("invert",), slow=True),
)
