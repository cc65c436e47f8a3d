"""Content of an HDF5 file as h5py shows it, independent of the reader of the project."""

import io
from typing import Any

import h5py
import numpy as np


def visible(data: bytes) -> list[Any]:
    """Return links, types, shapes, values and attributes of all objects as plain values."""
    with h5py.File(io.BytesIO(data), "r") as file:
        return list(_of_group("", file))


def _of_group(path: str, group: Any) -> Any:
    yield from _attributes(path, group)
    for name in sorted(group.keys()):
        link = group.get(name, getlink=True)
        yield path, name, type(link).__name__
        if not isinstance(link, h5py.HardLink):
            continue
        item = group[name]
        if isinstance(item, h5py.Group):
            yield from _of_group(f"{path}/{name}", item)
        elif isinstance(item, h5py.Dataset):
            yield f"{path}/{name}", *_type(item.dtype), item.shape, item.maxshape, _plain(item[()])
            yield from _attributes(f"{path}/{name}", item)
        else:
            yield path, name, type(item).__name__


def _attributes(path: str, item: Any) -> Any:
    for name in sorted(item.attrs.keys()):
        identity = item.attrs.get_id(name)
        yield path, name, *_type(identity.dtype), identity.shape, _plain(item.attrs[name])


def _type(dtype: Any) -> tuple[str, str]:
    return str(dtype), str(h5py.check_string_dtype(dtype))


def _plain(value: Any) -> Any:
    return value if isinstance(value, str | bytes) else np.asarray(value).tobytes()
