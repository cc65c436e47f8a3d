"""HDF5 file of one drop: writing, reading and verification of its content.

The file is built in memory and written by :class:`~pfwd_device.recording.storage.Storage`: on a
full disk HDF5 itself may report success or end the program. h5py is imported by the functions that
need it; recording works without it.

The attribute ``visible_sha256`` is a digest of everything else that is visible in the file
(:func:`~pfwd_device.recording.hdf5_tree.digest`). A drop of which only peaks were recorded has the
group ``peaks`` in place of traces.
"""

import functools
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from pfwd_device.drop import Drop, Peaks
from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_payload import MAX_SENSORS, Parts, drop_from_parts
from pfwd_device.recording.hdf5_tree import (
    Attribute,
    Dataset,
    Group,
    digest,
    opened,
    read_attribute,
    read_group,
    write_group,
)
from pfwd_device.recording.payload import Array, decode_json, encode_json
from pfwd_device.recording.record import DropRecord
from pfwd_device.text import clean

SURVEY_FORMAT = "pfwd-survey"
"""Attribute ``format`` of a plain export of a survey, which this program does not read."""

FILE_VERSION = 3
"""Format version of drop files."""

DIGEST = "visible_sha256"
"""Name of the attribute with the digest of everything else in the file."""

MAX_DROP_FILE_BYTES = 192 * 2**20
"""Largest drop file, bytes: the largest arrays and the longest texts. A usual drop takes 100 kB."""

MAX_CALIBRATION_ATTRIBUTES = 2048
"""Largest number of attributes with the calibration of the channels: 64 channels with 32 each.
Further values are only in the JSON text ``metadata``."""


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


class ExportedSurveyError(RecordingError):
    """The file is no drop file, but a plain export of a survey."""


def drop_digest(record: DropRecord, number: int, survey: bytes = b"") -> str:
    """Return the SHA-256 that the file of a drop has, as hexadecimal digits.

    Parameters
    ----------
    record : DropRecord
    number : int
        Number of the drop within its survey.
    survey : bytes
        Identity of the survey, 16 bytes.
    """
    return digest(_tree(record, number, survey))


def drop_file_bytes(record: DropRecord, number: int, survey: bytes) -> bytes:
    """Return the bytes of the HDF5 file of a drop.

    Parameters
    ----------
    record : DropRecord
    number : int
        Number of the drop within its survey.
    survey : bytes
        Identity of the survey, 16 bytes.
    """
    import h5py

    # The name is never used: the file exists in memory only.
    with h5py.File("drop.h5", "w", driver="core", backing_store=False) as file:
        write_drop(file, record, number, survey)
        file.flush()
        return bytes(file.id.get_file_image())


def read_drop_file(path: str | os.PathLike[str]) -> DropRecord:
    """Return the drop in the HDF5 file of a survey, bit by bit as it was saved.

    Parameters
    ----------
    path : path
        File in the folder ``drops`` of a survey.

    Raises
    ------
    RecordingError
        If the file is damaged, has another format, or its content was changed.
    """
    return read_drop_file_parts(path)[0]


def read_drop_file_parts(path: str | os.PathLike[str]) -> tuple[DropRecord, int, bytes]:
    """Return the drop in an HDF5 file, its number within the survey, and the survey's identity.

    The errors are those of `read_drop_file`.
    """
    try:
        if os.stat(path).st_size > MAX_DROP_FILE_BYTES:
            limit = f"{MAX_DROP_FILE_BYTES // 2**20} MiB"
            raise RecordingError(
                f"{path}: expected a drop file of at most {limit}, got a larger file, such as an "
                "export (pfwd export --format h5), which is not read; use the folder of the "
                "survey, or export it as one file (.pfwdz)"
            )
    except OSError as err:
        raise RecordingError(f"{path}: expected a readable drop file, got {err}") from err
    return _opened_drop(path, str(path))


def drop_from_file_bytes(data: bytes, where: str) -> tuple[DropRecord, int, bytes]:
    """Return the drop in the bytes of an HDF5 file, its number, and the identity of its survey.

    Parameters
    ----------
    data : bytes
        Content of the file.
    where : str
        Origin of the bytes, for messages.
    """
    return _opened_drop(data, where)


def _opened_drop(
    source: str | os.PathLike[str] | bytes, where: str
) -> tuple[DropRecord, int, bytes]:
    try:
        with opened(source) as file:
            return _read_drop(file, where)
    except RecordingError as err:
        if str(err).startswith(where):
            raise
        raise RecordingError(f"{where}: {err}") from err
    except Exception as err:  # h5py raises undocumented errors on damage: OSError to SystemError
        raise RecordingError(f"{where}: expected an intact drop file, got damage: {err}") from err


def write_drop(group: Any, record: DropRecord, number: int, survey: bytes) -> None:
    """Write a drop into an HDF5 file or one of its groups.

    Parameters
    ----------
    group : h5py.Group
        Open group without content.
    record : DropRecord
    number : int
        Number of the drop within its survey.
    survey : bytes
        Identity of the survey, 16 bytes.
    """
    tree = _tree(record, number, survey)
    write_group(group, Group(tree.members, {**tree.attributes, DIGEST: digest(tree)}))


def _read_drop(file: Any, where: str) -> tuple[DropRecord, int, bytes]:
    """Read the drop of an open HDF5 file and compare it with its digest."""
    if read_attribute(file, "format", where) == SURVEY_FORMAT:
        raise ExportedSurveyError(
            f"{where}: this is an export for other programs (pfwd export --format h5), which is "
            "not read; use the folder of the survey, or export it as one file (.pfwdz)"
        )
    version = read_attribute(file, "format_version", where)
    if version != FILE_VERSION:
        raise RecordingError(
            f"{where}: expected format version {FILE_VERSION} of a drop file, got {version!r:.40}"
        )
    tree = read_group(file, where)
    attributes = dict(tree.attributes)
    if attributes.pop(DIGEST, None) != digest(Group(tree.members, attributes)):
        raise RecordingError(f"{where}: expected the content that was written, got changed content")
    record = drop_from_parts(*_parts(tree))
    return record, int(attributes["number"]), bytes.fromhex(str(attributes["survey_id"]))


def _tree(record: DropRecord, number: int, survey: bytes) -> Group:
    """Return the content of the file of a drop, without its digest."""
    drop = record.drop
    members = _traces(drop) if drop.only_peaks is None else _peaks(drop.only_peaks)
    if record.counts is not None:
        calibration = _calibration(record.metadata)
        members["counts"] = Dataset(record.counts, {"units": "counts", **calibration})
    rebounds = {}
    for index, rebound in enumerate(record.rebounds, start=1):
        about: dict[str, Attribute] = {
            "delay_s": float(rebound.delay),
            "peak_load_N": float(rebound.peak_load),
            "first_sample": int(rebound.first_sample),
        }
        counts = Dataset(rebound.counts, {"units": "counts", **about})
        rebounds[str(index)] = Group({"counts": counts}, about)
    if rebounds:
        members["rebounds"] = Group(rebounds)
    for name, mapping in (("declared", record.declared), ("metadata", record.metadata)):
        members[name] = Dataset(encode_json(mapping), {"units": "JSON"})
    attributes: dict[str, Attribute] = {
        "format_version": FILE_VERSION,
        "pfwd_version": software_version(),
        "survey_id": survey.hex(),
        "point": record.point,
        "drop": int(drop.number),
        "number": int(number),
        **_plain_attributes(record),
    }
    return Group(members, attributes)


def _traces(drop: Drop) -> dict[str, Group | Dataset]:
    members: dict[str, Group | Dataset] = {
        "time": Dataset(drop.time, {"units": "s"}),
        "load": Dataset(drop.load, {"units": "N"}),
    }
    sensors = {}
    for index, channel in enumerate(drop.channels, start=1):
        about: dict[str, Attribute] = {
            "offset": float(channel.offset),
            "offset_units": "m",
            "quantity": channel.quantity.value,
        }
        values = Dataset(channel.values, {"units": channel.quantity.unit, **about})
        sensors[str(index)] = Group({"values": values}, about)
    if sensors:
        members["sensors"] = Group(sensors)
    return members


def _peaks(peaks: Peaks) -> dict[str, Group | Dataset]:
    offsets = np.array([offset for offset, _ in peaks.displacements])
    displacements = np.array([peak for _, peak in peaks.displacements])
    return {
        "peaks": Group(
            {
                "load": Dataset(np.array([peaks.load]), {"units": "N"}),
                "offsets": Dataset(offsets, {"units": "m"}),
                "displacements": Dataset(displacements, {"units": "m"}),
            }
        )
    }


def _parts(tree: Group) -> Parts:
    """Return the data and the arrays of a drop as its record in the journal has them."""
    sensors, rebounds = _groups(tree, "sensors"), _groups(tree, "rebounds")
    arrays = {
        name: _array(tree, name) for name in ("time", "load", "counts") if name in tree.members
    }
    arrays |= {f"sensor {n}": _array(group, "values") for n, group in enumerate(sensors, start=1)}
    arrays |= {f"rebound {n}": _array(group, "counts") for n, group in enumerate(rebounds, start=1)}
    data: dict[str, Any] = {
        "point": tree.attributes["point"],
        "drop": tree.attributes["drop"],
        "declared": _json_object(tree, "declared"),
        "metadata": _json_object(tree, "metadata"),
        "sensors": [[group.attributes[key] for key in ("offset", "quantity")] for group in sensors],
        "rebounds": [
            {
                "delay": group.attributes["delay_s"],
                "peak_load": group.attributes["peak_load_N"],
                "first_sample": group.attributes["first_sample"],
            }
            for group in rebounds
        ],
    }
    if isinstance(peaks := tree.members.get("peaks"), Group):
        (load,) = _array(peaks, "load").tolist()
        displacements = _array(peaks, "displacements").tolist()
        data["only_peaks"] = {"load": load, "displacements": displacements}
        data["sensors"] = [[offset, None] for offset in _array(peaks, "offsets").tolist()]
    return data, arrays


def _groups(tree: Group, name: str) -> list[Group]:
    """Return the groups ``1``, ``2`` ... of a group, which may be missing."""
    parent = tree.members.get(name, Group())
    if not isinstance(parent, Group):
        raise RecordingError(f"{name}: expected a group, got a dataset")
    groups = []
    for index in range(1, len(parent.members) + 1):
        member = parent.members[str(index)]
        if not isinstance(member, Group):
            raise RecordingError(f"{name}/{index}: expected a group, got a dataset")
        groups.append(member)
    return groups


def _array(tree: Group, name: str) -> Array:
    member = tree.members[name]
    if not isinstance(member, Dataset) or isinstance(member.value, str):
        raise RecordingError(f"{name}: expected an array, got a group or a text")
    return member.value


def _json_object(tree: Group, name: str) -> dict[str, Any]:
    member = tree.members[name]
    if not isinstance(member, Dataset) or not isinstance(member.value, str):
        raise RecordingError(f"{name}: expected a JSON text, got a group or an array")
    mapping = decode_json(member.value)
    if not isinstance(mapping, dict):
        raise RecordingError(f"{name}: expected a JSON object, got {type(mapping).__name__}")
    return mapping


def _plain_attributes(record: DropRecord) -> dict[str, Attribute]:
    """Return declared values of a drop as attributes that other programs can read easily.

    The JSON texts ``declared`` and ``metadata`` contain all values.
    """
    values = {**record.metadata, **record.declared}
    attributes: dict[str, Attribute] = {}
    for name in _ATTRIBUTES:
        value = values.get(name)
        number = _as_float(value)
        if number is not None:
            attributes[name] = number
        elif isinstance(value, str):
            attributes[name] = clean(value, limit=4096)
        elif name == "notes" and isinstance(value, list):
            attributes[name] = clean("; ".join(map(str, value)), limit=4096)
    position = values.get("position")
    if isinstance(position, Mapping):
        for key in ("latitude", "longitude", "altitude_m"):
            number = _as_float(position.get(key))
            if number is not None:
                attributes.setdefault(key, number)
    return attributes


def _calibration(metadata: Mapping[str, Any]) -> dict[str, Attribute]:
    """Return the calibration of each channel as attributes ``channel_1_sensitivity`` and so on."""
    identity = metadata.get("identity")
    channels = identity.get("channels") if isinstance(identity, Mapping) else None
    attributes: dict[str, Attribute] = {}
    if not isinstance(channels, list):
        return attributes
    for index, channel in enumerate(channels[:MAX_SENSORS], start=1):
        if not isinstance(channel, Mapping):
            continue
        for key, value in list(channel.items())[:32]:
            name = clean(f"channel_{index}_{key}")
            number = _as_float(value)
            if len(attributes) == MAX_CALIBRATION_ATTRIBUTES and name not in attributes:
                return attributes
            if number is not None:
                attributes[name] = number
            elif isinstance(value, str):
                attributes[name] = clean(value, limit=256)
    return attributes


def _as_float(value: object) -> float | None:
    try:
        return float(value) if isinstance(value, int | float) else None
    except OverflowError:  # an integer of hundreds of digits, which the JSON text contains
        return None


@functools.cache  # the package may be replaced during a recording
def software_version() -> str:
    """Return the version of this program, such as "1.2.0"; "unknown" if it is not installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("pfwd") or "unknown"  # None while it is being installed
    except PackageNotFoundError:
        return "unknown"
