"""One drop as an HDF5 file that explains itself: written, compared and read.

The file is built in memory and written by :class:`~pfwd_device.recording.storage.Storage`: HDF5
itself, when it meets a full disk, may report success or end the program. h5py is imported by the
functions that need it; recording does without.
"""

import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pfwd_device.drop import Channel, Drop
from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_payload import MOST_REBOUNDS, MOST_SENSORS, drop_parts
from pfwd_device.recording.layout import FORMAT_VERSION
from pfwd_device.recording.payload import Array, content_digest, decode_json, encode_json
from pfwd_device.recording.record import DropRecord, Rebound
from pfwd_device.text import clean

LARGEST_FILE = 2**30
"""Bytes; a drop takes about 100 kB, so a larger file is something else."""

_UNITS = {"velocity": "m/s", "displacement": "m"}
_CHUNK = 65_536

_ATTRIBUTES = (
    "plate_radius_m",
    "plate_mass_kg",
    "poisson_ratio",
    "bedrock_depth_m",
    "density_kg_m3",
    "device",
    "site",
    "operator",
    "latitude",
    "longitude",
    "notes",
    "time_utc",
    "key",
)


def drop_digest(record: DropRecord, number: int) -> str:
    """SHA-256 of everything that is kept of the drop."""
    data, arrays = drop_parts(record)
    return content_digest(data | {"number": number}, arrays)


def drop_file_bytes(record: DropRecord, number: int, survey: bytes) -> bytes:
    """The HDF5 file of a drop, in memory.

    Parameters
    ----------
    record : DropRecord
    number : int
        Survey-wide number of the drop.
    survey : bytes
        Identity of the survey.
    """
    import h5py

    # Built in memory; the name is never opened.
    with h5py.File("drop.h5", "w", driver="core", backing_store=False) as file:
        _write(file, record, number, survey)
        file.flush()
        return bytes(file.id.get_file_image())


def read_drop_file(path: str | Path) -> DropRecord:
    """The drop that a file of a survey holds, bit by bit as it was saved.

    Raises
    ------
    RecordingError
        If the file is damaged, is none of this format, or its content is not what was written.
    """
    return read_drop_file_parts(Path(path))[0]


def read_drop_file_parts(path: Path) -> tuple[DropRecord, int, bytes]:
    """Drop, survey-wide number and identity of the survey of a file; raises as the above."""
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise RecordingError(f"{path}: expected the file of a drop, came one of over 1 GiB")
        return drop_from_file_bytes(path.read_bytes(), str(path))
    except OSError as err:
        raise RecordingError(f"{path}: expected a readable drop file, came {err}") from err


def drop_from_file_bytes(data: bytes, where: str) -> tuple[DropRecord, int, bytes]:
    """As :func:`read_drop_file_parts`, of a file's bytes."""
    import h5py

    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            version = int(file.attrs["format_version"])
            if version != FORMAT_VERSION:
                raise RecordingError(
                    f"{where}: expected format version {FORMAT_VERSION}, came {version}; "
                    "a newer version of this program reads it"
                )
            record, number = _read(file)
            survey = bytes.fromhex(str(file.attrs["survey_id"]))
            digest = str(file.attrs["content_sha256"])
    except RecordingError:
        raise
    except Exception as err:  # what h5py raises on damage is not documented: OSError to SystemError
        raise RecordingError(f"{where}: expected the file of a drop, came damage: {err}") from err
    if drop_digest(record, number) != digest:
        raise RecordingError(f"{where}: expected the content that was written, came another")
    return record, number, survey


def write_drop(group: Any, record: DropRecord, number: int, survey: bytes) -> None:
    """Write a drop into an HDF5 file or one of its groups; parameters as for `drop_file_bytes`."""
    _write(group, record, number, survey)


def read_drop(group: Any, where: str) -> tuple[DropRecord, int]:
    """Drop and survey-wide number of what `write_drop` wrote, compared with its digest.

    Parameters
    ----------
    group : an open HDF5 file or one of its groups
    where : str
        For messages.

    Raises
    ------
    RecordingError
        If it is none, or its content is not what was written.
    """
    try:
        record, number = _read(group)
        digest = str(group.attrs["content_sha256"])
    except RecordingError:
        raise
    except Exception as err:  # what h5py raises on damage is not documented: OSError to SystemError
        raise RecordingError(f"{where}: expected a drop, came damage: {err}") from err
    if drop_digest(record, number) != digest:
        raise RecordingError(f"{where}: expected the content that was written, came another")
    return record, number


def _write(file: Any, record: DropRecord, number: int, survey: bytes) -> None:
    drop = record.drop
    root = file.attrs
    root["format_version"] = FORMAT_VERSION
    root["pfwd_version"] = software_version()
    root["survey_id"] = survey.hex()
    root["point"] = record.point
    root["drop"] = drop.number
    root["number"] = number
    root["content_sha256"] = drop_digest(record, number)
    for name, value in _plain_attributes(record).items():
        root[name] = value
    _dataset(file, "time", drop.time, "s")
    _dataset(file, "load", drop.load, "N")
    for index, channel in enumerate(drop.channels, start=1):
        group = file.create_group(f"sensors/{index}")
        values = _dataset(group, "values", channel.values, _UNITS[channel.quantity])
        for attributes in (group.attrs, values.attrs):
            attributes["offset"] = channel.offset
            attributes["offset_units"] = "m"
            attributes["quantity"] = channel.quantity
    if record.counts is not None:
        _dataset(file, "counts", record.counts, "counts")
    for index, rebound in enumerate(record.rebounds, start=1):
        group = file.create_group(f"rebounds/{index}")
        counts = _dataset(group, "counts", rebound.counts, "counts")
        for attributes in (group.attrs, counts.attrs):
            attributes["delay_s"] = rebound.delay
            attributes["peak_load_N"] = rebound.peak_load
            attributes["first_sample"] = rebound.first_sample
    _text(file, "declared", record.declared)
    _text(file, "metadata", record.metadata)
    _calibration(file, record.metadata)


def _read(file: Any) -> tuple[DropRecord, int]:
    sensors = file.get("sensors", {})
    rebounds = file.get("rebounds", {})
    if len(sensors) > MOST_SENSORS or len(rebounds) > MOST_REBOUNDS:
        raise RecordingError(f"expected at most {MOST_SENSORS} sensors and rebounds, came more")
    channels = []
    for index in range(1, len(sensors) + 1):
        attributes = sensors[str(index)].attrs
        quantity: Any = str(attributes["quantity"])
        values = _values(sensors[f"{index}/values"])
        channels.append(Channel(float(attributes["offset"]), quantity, values))
    bounces = []
    for index in range(1, len(rebounds) + 1):
        attributes = rebounds[str(index)].attrs
        bounces.append(
            Rebound(
                float(attributes["delay_s"]),
                float(attributes["peak_load_N"]),
                int(attributes["first_sample"]),
                _values(rebounds[f"{index}/counts"]),
            )
        )
    drop = Drop(
        int(file.attrs["drop"]), _values(file["time"]), _values(file["load"]), tuple(channels)
    )
    record = DropRecord(
        point=str(file.attrs["point"]),
        drop=drop,
        counts=_values(file["counts"]) if "counts" in file else None,
        declared=decode_json(file["declared"][()]),
        metadata=decode_json(file["metadata"][()]),
        rebounds=tuple(bounces),
    )
    return record, int(file.attrs["number"])


def _dataset(group: Any, name: str, values: Array, units: str) -> Any:
    options: dict[str, Any] = {}
    if values.size:  # HDF5 has no chunks of nothing
        first = max(1, min(values.shape[0], _CHUNK // max(1, math.prod(values.shape[1:]))))
        options = {
            "chunks": (first, *values.shape[1:]),
            "compression": "gzip",
            "compression_opts": 1,
            "shuffle": True,
            "fletcher32": True,
        }
    dataset = group.create_dataset(name, data=values, **options)
    dataset.attrs["units"] = units
    return dataset


def _text(file: Any, name: str, data: Mapping[str, Any]) -> None:
    dataset = file.create_dataset(name, data=encode_json(data))
    dataset.attrs["units"] = "JSON"


def _values(dataset: Any) -> Array:
    if dataset.size * dataset.dtype.itemsize > LARGEST_FILE:
        raise RecordingError(f"{dataset.name}: expected a recorded trace, came a larger array")
    return np.asarray(dataset[()])


def _plain_attributes(record: DropRecord) -> dict[str, Any]:
    """What a reader without this program looks for; the whole is in the JSON texts."""
    known = {**record.metadata, **record.declared}
    found: dict[str, Any] = {}
    for name in _ATTRIBUTES:
        value = known.get(name)
        number = _as_float(value)
        if number is not None:
            found[name] = number
        elif isinstance(value, str):
            found[name] = clean(value, limit=4096)
        elif name == "notes" and isinstance(value, list):
            found[name] = clean("; ".join(map(str, value)), limit=4096)
    position = known.get("position")
    if isinstance(position, Mapping):
        for key in ("latitude", "longitude", "altitude_m"):
            number = _as_float(position.get(key))
            if number is not None:
                found.setdefault(key, number)
    return found


def _calibration(file: Any, metadata: Mapping[str, Any]) -> None:
    """Identity and calibration of each channel as attributes ``channel_1_...`` of the counts."""
    identity = metadata.get("identity")
    channels = identity.get("channels") if isinstance(identity, Mapping) else None
    if "counts" not in file or not isinstance(channels, list):
        return
    for index, channel in enumerate(channels[:MOST_SENSORS], start=1):
        if not isinstance(channel, Mapping):
            continue
        for key, value in list(channel.items())[:32]:
            name = clean(f"channel_{index}_{key}")
            number = _as_float(value)
            if number is not None:
                file["counts"].attrs[name] = number
            elif isinstance(value, str):
                file["counts"].attrs[name] = clean(value, limit=256)


def _as_float(value: object) -> float | None:
    try:
        return float(value) if isinstance(value, int | float) else None
    except OverflowError:  # an integer of hundreds of digits, which the JSON text keeps
        return None


def software_version() -> str:
    """Version of this program."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("pfwd")
    except PackageNotFoundError:
        return "unknown"
