"""Files of laboratory programs, written without the libraries that read them."""

import struct
import wave
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Table = NDArray[np.float64]
"""Channels (n, k)."""


def write_wav(path: Path, rate: float, names: list[str], table: Table) -> None:
    """Write 24 bits by the standard library; values are fractions of the full scale."""
    counts = np.ascontiguousarray(np.rint(table * 2**23), "<i4")
    data = counts.view(np.uint8).reshape(*counts.shape, 4)[:, :, :3].tobytes()
    with wave.open(str(path), "wb") as stream:
        stream.setnchannels(table.shape[1])
        stream.setsampwidth(3)
        stream.setframerate(round(rate))
        stream.writeframes(data)


def write_matlab(path: Path, rate: float, names: list[str], table: Table) -> None:
    """Write level 5 of the format by hand: a vector of doubles for each channel, and the time."""
    head = b"MATLAB 5.0 MAT-file, by hand".ljust(124) + struct.pack("<H2s", 0x0100, b"IM")
    data = head
    columns = {"time": np.arange(len(table)) / rate} | dict(zip(names, table.T, strict=True))
    for name, values in columns.items():
        element = _matlab_part(6, struct.pack("<II", 6, 0))
        element += _matlab_part(5, struct.pack("<ii", len(values), 1))
        element += _matlab_part(1, name.encode()) + _matlab_part(9, values.astype("<f8").tobytes())
        data += struct.pack("<II", 14, len(element)) + element
    path.write_bytes(data)


def _matlab_part(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def write_matlab_hdf5(path: Path, rate: float, names: list[str], table: Table) -> None:
    import hdf5storage

    columns = {"time": np.arange(len(table)) / rate} | dict(zip(names, table.T, strict=True))
    values = {name: column.reshape(-1, 1) for name, column in columns.items()}
    hdf5storage.savemat(str(path), values, format="7.3", appendmat=False)


def write_tdms(path: Path, rate: float, names: list[str], table: Table) -> None:
    """Write one segment by hand, from the maker's description of the format."""
    objects = [_tdms_text("/") + struct.pack("<II", 0xFFFFFFFF, 0)]
    objects.append(_tdms_text("/'drop'") + struct.pack("<II", 0xFFFFFFFF, 0))
    for name in names:
        index = struct.pack("<IIIQ", 20, 10, 1, len(table))
        properties = _tdms_text("wf_increment") + struct.pack("<Id", 10, 1 / rate)
        properties += _tdms_text("unit_string") + struct.pack("<I", 0x20) + _tdms_text("V")
        objects.append(_tdms_text(f"/'drop'/'{name}'") + index + struct.pack("<I", 2) + properties)
    meta = struct.pack("<I", len(objects)) + b"".join(objects)
    raw = b"".join(column.astype("<f8").tobytes() for column in table.T)
    lead = b"TDSm" + struct.pack("<IIQQ", 0b1110, 4713, len(meta) + len(raw), len(meta))
    path.write_bytes(lead + meta + raw)


def _tdms_text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def write_seg2(path: Path, rate: float, names: list[str], table: Table) -> None:
    """Write the format of the Society of Exploration Geophysicists (1990) by hand."""
    count = len(names)
    file_texts = _seg2_texts({"ACQUISITION_DATE": "26/11/2026", "ACQUISITION_TIME": "10:00:00"})
    head = struct.pack("<HHHH", 0x3A55, 1, 4 * count, count)
    head += struct.pack("<B2sB2s18x", 1, b"\0\0", 1, b"\n\0")
    place = len(head) + 4 * count + len(file_texts)
    blocks, places = [], []
    for number, column in enumerate(table.T, start=1):
        texts = _seg2_texts({"SAMPLE_INTERVAL": f"{1 / rate:.9f}", "CHANNEL_NUMBER": f"{number}"})
        data = column.astype("<f4").tobytes()
        size = 32 + len(texts)
        block = struct.pack("<HHIIB19x", 0x4422, size, len(data), len(column), 4) + texts + data
        places.append(place)
        place += len(block)
        blocks.append(block)
    path.write_bytes(head + struct.pack(f"<{count}I", *places) + file_texts + b"".join(blocks))


def _seg2_texts(texts: dict[str, str]) -> bytes:
    data = b""
    for key, value in texts.items():
        text = f"{key} {value}".encode() + b"\0"
        data += struct.pack("<H", len(text) + 2) + text
    data += struct.pack("<H", 0)
    return data + bytes(-len(data) % 4)


def write_miniseed(path: Path, rate: float, names: list[str], table: Table) -> None:
    from pymseed import MS3TraceList

    traces = MS3TraceList()
    for name, column in zip(names, table.T, strict=True):
        traces.add_data(
            sourceid=f"FDSN:XX_PFWD__{'_'.join(name[:3].upper())}",
            data_samples=column.astype(np.float64).tolist(),
            sample_type="d",
            sample_rate=rate,
            starttime_str="2026-11-26T10:00:00Z",
        )
    traces.to_file(str(path), overwrite=True, format_version=2)


WRITERS: dict[str, Callable[[Path, float, list[str], Table], None]] = {
    "wav": write_wav,
    "mat": write_matlab,
    "mat73": write_matlab_hdf5,
    "tdms": write_tdms,
    "sg2": write_seg2,
    "mseed": write_miniseed,
}
"""Functions that write a file of each format, by its usual suffix."""
