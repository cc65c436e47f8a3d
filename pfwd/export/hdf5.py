"""Plain export of a survey as one HDF5 file, for other programs; this program does not read it.

docs/files.md describes the layout. h5py is imported by the functions that need it, because its
import is slow.
"""

import io
import os
from dataclasses import fields
from datetime import UTC, datetime
from typing import Any

import numpy as np

from pfwd.errors import SurveyError
from pfwd.export.output import new_file
from pfwd.export.rows import Order
from pfwd.files.photos import photos_of
from pfwd_device.recording import Survey, SurveyDrop, SurveyPoint
from pfwd_device.recording.drop_file import SURVEY_FORMAT, software_version, write_drop
from pfwd_device.recording.hdf5_tree import Dataset, write_attributes, write_dataset
from pfwd_device.recording.payload import encode_json

EXPORT_VERSION = 3

_CHUNK_BYTES = 1 << 20


def write_h5(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write a survey into one HDF5 file for other programs.

    Parameters
    ----------
    order : Order
    path : path of the file

    Returns
    -------
    list of str
        Empty, because nothing is omitted.
    """
    import h5py

    with new_file(path, force=order.force) as draft, _NotingFile(draft, "w+b") as stream:
        try:
            with h5py.File(stream, "w") as file:
                _write(file, order.content)
        except (RuntimeError, ValueError, OSError, SystemError) as err:
            raise stream.error or SurveyError(f"{path}: the export failed: {err}") from err
        if stream.error is not None:
            raise stream.error
    return []


class _NotingFile(io.FileIO):
    """File that notes the first error of a write: HDF5 may report success on a full disk."""

    error: OSError | None = None

    def write(self, data: Any, /) -> int:
        try:
            return super().write(data)
        except OSError as err:
            self.error = self.error or err
            raise


def _write(file: Any, content: Survey) -> None:
    groups, results = file.create_group("drops"), file.create_group("results")
    for drop in content.drops:
        name = f"{drop.number:06d}"
        identity = bytes.fromhex(content.survey_id)
        write_drop(groups.create_group(name), drop.read(), drop.number, identity)
        for index, result in enumerate(drop.read_results(), start=1):
            _write_json(results.require_group(name), str(index), result)
    photos = [
        (p.name, photo) for p in content.points for photo in photos_of(content.folder, p.name)
    ]
    entries = {
        "info": content.info,
        "points": [_entry(p, drops=[drop.number for drop in p.drops]) for p in content.points],
        "drops": [_entry(d, key=d.key, diagnosis=d.read_diagnosis(dict)) for d in content.drops],
        "events": content.events,
        "checks": content.checks,
        "damage": content.damage,
        "photos": [{"point": point, "name": photo.name} for point, photo in photos],
    }
    _write_json(file, "survey", entries)
    for number, (_, photo) in enumerate(photos, start=1):
        _write_bytes(file, f"photos/{number:06d}", photo)
    for capture in content.captures:
        _write_bytes(file, f"captures/{capture.name}", capture)
    write_attributes(
        file,
        {
            "format": SURVEY_FORMAT,
            "format_version": EXPORT_VERSION,
            "pfwd_version": software_version(),
            "survey_id": content.survey_id,
            "exported_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        },
    )


def _entry(item: SurveyPoint | SurveyDrop, **more: Any) -> dict[str, Any]:
    """Return the fields of a point or drop, with further values."""
    names = [f.name for f in fields(item) if f.name not in ("drops", "source") and f.repr]
    return {name: getattr(item, name) for name in names} | more


def _write_json(group: Any, name: str, content: Any) -> None:
    write_dataset(group, name, Dataset(encode_json(content), {"units": "JSON"}))


def _write_bytes(file: Any, name: str, path: os.PathLike[str]) -> None:
    """Write the content of a file as a dataset, piece by piece: a capture may fill the memory."""
    size = os.stat(path).st_size
    chunks = {"chunks": (min(size, _CHUNK_BYTES),), "compression": "gzip"} if size else {}
    dataset = file.create_dataset(name, shape=(size,), dtype=np.uint8, **chunks)
    with open(path, "rb") as stream:
        for at in range(0, size, _CHUNK_BYTES):
            data = stream.read(min(_CHUNK_BYTES, size - at))
            dataset[at : at + len(data)] = np.frombuffer(data, np.uint8)
    write_attributes(dataset, {"units": "bytes"})
