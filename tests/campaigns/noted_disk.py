"""Disk that notes its calls, and its possible contents after each of them."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pfwd_device.recording import Storage

SECTOR = 512
"""Number of bytes that are written together or not at all."""

WRITTEN_SHARES = (0.1, 0.5, 0.9)
"""Fractions of the unsynced sectors that are written before a power cut."""

Operation = tuple[Any, ...]
Fault = Callable[[str, int], OSError | int | None]


class NotingStorage(Storage):
    """Storage of the files below `root` that notes every call; `fault` may make a call fail.

    `fault` receives the name of the call and its number from 0. An OSError that it returns is
    raised; a number that it returns for ``write`` limits the written bytes.
    """

    def __init__(self, root: Path, fault: Fault | None = None) -> None:
        self.root = root
        self.notes: list[Operation] = []
        self.calls = 0
        self._fault = fault
        self._paths: dict[int, Path] = {}
        self._lock = threading.RLock()

    def mark(self, number: int) -> None:
        """Note that the drop with this number has been acknowledged."""
        with self._lock:
            self.notes.append(("acknowledged", number))

    def open(self, path: Path, *, create: bool = False) -> int:
        with self._lock:
            self._may_fail("open")
            descriptor = super().open(path, create=create)
            self._paths[descriptor] = path
            if create:
                self._note("create", path)
            return descriptor

    def pwrite(self, descriptor: int, data: memoryview, offset: int) -> int:
        with self._lock:
            limit = self._may_fail("write")
            written = super().pwrite(descriptor, data if limit is None else data[:limit], offset)
            self._note("write", self._paths[descriptor], offset, bytes(data[:written]))
            return written

    def sync(self, descriptor: int) -> None:
        with self._lock:
            self._may_fail("sync")
            self._note("sync", self._paths[descriptor])

    def truncate(self, descriptor: int, size: int) -> None:
        with self._lock:
            self._may_fail("truncate")
            super().truncate(descriptor, size)
            self._note("truncate", self._paths[descriptor], size)

    def replace(self, source: Path, target: Path) -> None:
        with self._lock:
            self._may_fail("replace")
            super().replace(source, target)
            self.notes.append(("replace", self._name(source), self._name(target)))

    def unlink(self, path: Path) -> None:
        with self._lock:
            self._may_fail("unlink")
            super().unlink(path)
            self._note("unlink", path)

    def make_directory(self, path: Path) -> None:
        with self._lock:
            self._may_fail("make_directory")
            if not path.is_dir():
                super().make_directory(path)
                self._note("make_directory", path)

    def sync_directory(self, path: Path) -> None:
        with self._lock:
            self._may_fail("sync_directory")
            if path not in self.root.parents:  # these are not watched
                self._note("sync_directory", path)

    def _may_fail(self, call: str) -> int | None:
        fault = self._fault(call, self.calls) if self._fault else None
        self.calls += 1
        if isinstance(fault, OSError):
            raise fault
        return fault

    def _note(self, what: str, path: Path, *details: Any) -> None:
        self.notes.append((what, self._name(path), *details))

    def _name(self, path: Path) -> str:
        return path.relative_to(self.root).as_posix() if path != self.root else ""


class NoSync(NotingStorage):
    """Planted bug: content is never synced."""

    def sync(self, descriptor: int) -> None:
        """Do nothing."""


class NoDirectorySync(NotingStorage):
    """Planted bug: names are never synced."""

    def sync_directory(self, path: Path) -> None:
        """Do nothing."""


@dataclass
class _Inode:
    current: bytearray = field(default_factory=bytearray)
    durable: bytes = b""


State = dict[str, bytes | None]
"""Content by path; None for folders."""


class Disk:
    """Possible contents of a disk after a series of calls."""

    def __init__(self, before: State | None = None) -> None:
        self._names: dict[str, _Inode | None] = {
            name: None if content is None else _Inode(bytearray(content), content)
            for name, content in (before or {}).items()
        }
        self._durable = dict(self._names)
        self._pending: list[tuple[str, dict[str, _Inode | None], list[str]]] = []

    def follow(self, note: Operation) -> None:
        """Apply a call."""
        what, path, *details = note
        if what in ("create", "make_directory"):
            inode = _Inode() if what == "create" else None
            self._change(_parent(path), {path: inode}, [])
        elif what == "replace":
            target = str(details[0])
            self._change(_parent(target), {target: self._names[path]}, [path])
        elif what == "unlink":
            self._change(_parent(path), {}, [path])
        elif what == "sync_directory":
            for folder, added, removed in self._pending:
                if folder == path:
                    _apply(self._durable, added, removed)
            self._pending = [entry for entry in self._pending if entry[0] != path]
        elif what != "acknowledged":
            self._content(what, self._names[path], details)

    def killed(self) -> State:
        """Return the content of the disk if the program is killed now."""
        return {
            name: None if inode is None else bytes(inode.current)
            for name, inode in self._names.items()
        }

    def power_cut(self, rng: np.random.Generator) -> State:
        """Return a possible content of the disk after a power cut."""
        names = dict(self._durable)
        for _, added, removed in self._pending[: rng.integers(len(self._pending) + 1)]:
            _apply(names, added, removed)
        share = float(rng.choice(WRITTEN_SHARES))
        state: State = {}
        for name, inode in sorted(names.items()):
            parent = _parent(name)
            if parent and parent not in state:
                continue  # its folder was not written
            state[name] = None if inode is None else _torn(inode, share, rng)
        return state

    def _change(self, folder: str, added: dict[str, _Inode | None], removed: list[str]) -> None:
        _apply(self._names, added, removed)
        self._pending.append((folder, added, removed))

    def _content(self, what: str, inode: _Inode | None, details: list[Any]) -> None:
        assert inode is not None
        if what == "write":
            offset, data = details
            inode.current.extend(bytes(max(0, offset - len(inode.current))))
            inode.current[offset : offset + len(data)] = data
        elif what == "truncate":
            del inode.current[details[0] :]
        elif what == "sync":
            inode.durable = bytes(inode.current)


def take(folder: Path) -> State:
    """Return the files below a folder."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


def put(state: State, folder: Path) -> None:
    """Write the files of a state into an empty folder."""
    for name, content in sorted(state.items()):
        if content is None:
            (folder / name).mkdir()
        else:
            (folder / name).write_bytes(content)


def _apply(
    names: dict[str, _Inode | None], added: dict[str, _Inode | None], removed: list[str]
) -> None:
    for name in removed:
        names.pop(name, None)
    names.update(added)


def _parent(path: str) -> str:
    return path.rpartition("/")[0]


def _torn(inode: _Inode, share: float, rng: np.random.Generator) -> bytes:
    """Return the written part of a file: all that was synced, and some of the other sectors."""
    current, durable = inode.current, inode.durable
    if current == durable:
        return durable
    content = bytearray(durable)
    if len(current) < len(durable) and rng.random() < share:
        del content[len(current) :]
    for start in range(0, len(current), SECTOR):
        sector = current[start : start + SECTOR]
        if sector != durable[start : start + len(sector)] and rng.random() < share:
            content.extend(bytes(max(0, start - len(content))))
            content[start : start + len(sector)] = sector
    return bytes(content)
