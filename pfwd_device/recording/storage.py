"""Access to files through the operating system; tests replace it to simulate failing disks."""

import contextlib
import errno
import os
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path

FULL_ERRORS = frozenset(
    number
    for name in ("ENOSPC", "EDQUOT", "EFBIG")
    if (number := getattr(errno, name, None)) is not None
)
"""Error numbers of the system for a full disk, a full quota or a file that is too long."""

_BINARY = getattr(os, "O_BINARY", 0)  # without it Windows translates line ends
_NO_FOLLOW = getattr(
    os, "O_NOFOLLOW", 0
)  # a survey from a stranger may hold links that lead out of it
_NOT_INHERITED = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NOINHERIT", 0)


LOCK_PAUSE_S = 0.02
"""Time between two attempts to lock a file, s."""

LOCK_TEST_S = 0.1
"""Longest time for which another program that only tests a lock holds it, s."""

MAX_TRUSTED_WRITE_S = 0.005
"""Duration of a write of this program after which the file is read again, because another program
may have written to it meanwhile, s."""

REPLACE_RETRY_S = 1.0
"""Time for which a file is renamed again on Windows while another program has it open, s. A virus
scanner reads each new file for a moment."""

IN_USE = "open in another program; close it there or name another file"
"""Reason of an error on Windows, whose own one is a lack of rights."""

_NO_FULL_SYNC = frozenset({errno.ENOTSUP, errno.EINVAL, errno.ENOTTY})
"""Error numbers of macOS for a disk without F_FULLFSYNC, such as a network share."""

Stamp = tuple[int, int] | None
"""Times (ns) of the last change of a file's content and of its metadata; None if unknown.

An equal stamp does not prove that nothing was written: the clock of a file system may advance in
steps of 4 ms, or of 2 s. A different stamp does not prove that something was written. So after a
change of the stamp the content is compared.
"""


class Storage:
    """Unbuffered access to files, which lets the caller wait until data are on the disk.

    Unless stated otherwise every method may raise OSError. Files are identified by descriptors of
    the system. The caller passes all offsets (bytes), so that an incomplete write can be repeated.
    """

    def open(self, path: Path, *, create: bool = False) -> int:
        """Open a file for reading and writing and return its descriptor.

        With `create` the file is created and must not exist yet.
        """
        flags = os.O_RDWR | _BINARY | _NOT_INHERITED | _NO_FOLLOW
        if create:
            flags |= os.O_CREAT | os.O_EXCL
        return os.open(path, flags, 0o666)

    def close(self, descriptor: int) -> None:
        """Close an open file."""
        os.close(descriptor)

    def pwrite(self, descriptor: int, data: memoryview, offset: int) -> int:
        """Write bytes at an offset; return the number of written bytes, which may be smaller."""
        if sys.platform != "win32":
            return os.pwrite(descriptor, data, offset)
        else:  # noqa: RET505 - only an else is left out of the checks for other platforms
            os.lseek(descriptor, offset, os.SEEK_SET)
            return os.write(descriptor, data)

    def write_at(self, descriptor: int, data: bytes, offset: int) -> None:
        """Write all bytes at an offset, if necessary by several writes."""
        rest = memoryview(data)
        while rest:
            written = self.pwrite(descriptor, rest, offset)
            if written <= 0:
                raise OSError(errno.ENOSPC, "the disk accepted no more bytes")
            rest = rest[written:]
            offset += written

    def sync(self, descriptor: int) -> None:
        """Wait until content and length of a file are on the disk."""
        if hasattr(os, "fdatasync"):  # not on Windows and macOS
            os.fdatasync(descriptor)
        else:
            flush_to_disk(descriptor)

    def read_at(self, descriptor: int, length: int, offset: int) -> bytes:
        """Return `length` bytes from an offset; fewer at the end of the file."""
        parts = []
        while length > 0:
            if sys.platform != "win32":
                part = os.pread(descriptor, length, offset)
            else:
                os.lseek(descriptor, offset, os.SEEK_SET)
                part = os.read(descriptor, length)
            if not part:
                break
            parts.append(part)
            length -= len(part)
            offset += len(part)
        return b"".join(parts)

    def lock(self, descriptor: int) -> bool:
        """Lock a file until it is closed; return False if another program has locked it.

        On Windows no lock is taken. It would exclude readers, and it is not needed, because an open
        file such as ``survey.lock`` can be neither deleted nor replaced.
        """
        if sys.platform == "win32":
            return True
        else:  # noqa: RET505 - only an else is left out of the checks for Windows
            import fcntl

            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as err:
                # Any other error means a file system without locks. Writes of other programs are
                # detected by their effects then.
                return err.errno not in (errno.EACCES, errno.EAGAIN)
            return True

    def wait_for_lock(self, descriptor: int, timeout: float) -> bool:
        """Lock a file as :meth:`lock` does; wait for another program at most `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while not self.lock(descriptor):
            if time.monotonic() >= deadline:
                return False
            time.sleep(LOCK_PAUSE_S)
        return True

    def size(self, descriptor: int) -> int:
        """Return the length of a file, bytes."""
        return os.fstat(descriptor).st_size

    def names(self, descriptor: int) -> int:
        """Return the number of names of a file, 2 with an additional link."""
        return os.fstat(descriptor).st_nlink

    def stamp(self, descriptor: int) -> Stamp:
        """Return the times of the last changes of a file, a `Stamp`; None instead of an error."""
        try:
            status = os.fstat(descriptor)
        except OSError:
            return None
        return status.st_mtime_ns, status.st_ctime_ns

    def stamp_after_write(self, descriptor: int) -> Stamp:
        """Return the times of the last changes after a write of this program, and make them unique.

        The clock of a file system advances in steps of some ms, so a later write of another program
        within the same step would leave the same time. Therefore the time of the file is set 1 ns
        later, on systems that can set it.
        """
        if os.utime in os.supports_fd:
            with contextlib.suppress(OSError):  # without it only such a write remains undetected
                status = os.fstat(descriptor)
                os.utime(descriptor, ns=(status.st_atime_ns, status.st_mtime_ns + 1))
        return self.stamp(descriptor)

    def truncate(self, descriptor: int, size: int) -> None:
        """Cut a file to `size` bytes."""
        os.ftruncate(descriptor, size)

    def replace(self, source: Path, target: Path) -> None:
        """Rename a file within its folder; an existing file `target` is replaced."""
        replace_file(source, target)

    def unlink(self, path: Path) -> None:
        """Delete a file."""
        os.unlink(path)

    def make_directory(self, path: Path) -> None:
        """Create one folder, unless it exists."""
        if not path.is_dir():
            try:
                os.mkdir(path)
            except FileExistsError:  # another program has just created it
                if not path.is_dir():
                    raise

    def sync_directory(self, path: Path) -> None:
        """Wait until new and changed names in a folder are on the disk."""
        if os.name == "nt":  # Windows has no such call, and its file system records names safely
            return
        descriptor = os.open(path, os.O_RDONLY | _NOT_INHERITED)
        try:
            flush_to_disk(descriptor)
        finally:
            os.close(descriptor)

    def free_bytes(self, path: Path) -> int:
        """Return the free space on the disk of `path`, bytes."""
        return shutil.disk_usage(path).free

    def make_folder(self, path: Path) -> None:
        """Create a folder with its parents, and wait until each of them is on the disk."""
        missing = []
        while not path.is_dir():
            missing.append(path)
            if path.parent == path:
                break
            path = path.parent
        # A run that was killed may have created this folder without waiting for the disk.
        with contextlib.suppress(PermissionError):  # a folder of another user
            self.sync_directory(path.parent)
        for folder in reversed(missing):
            self.make_directory(folder)
            self.sync_directory(folder.parent)

    def write_file(self, path: Path, data: bytes) -> None:
        """Write a file so that after a power cut either the old or the new content exists.

        The content is written under a temporary name, which is renamed when it is on the disk.
        """
        draft = draft_of(path)
        self.write_draft(draft, data)
        self.replace(draft, path)
        self.sync_directory(path.parent)

    def write_draft(self, draft: Path, data: bytes) -> None:
        """Write a file under a temporary name, and wait until it is on the disk."""
        if draft.exists():  # left by a run that was killed
            self.unlink(draft)
        descriptor = self.open(draft, create=True)
        try:
            self.write_at(descriptor, data, 0)
            self.sync(descriptor)
        except OSError:
            self.close(descriptor)
            self.unlink(draft)
            raise
        self.close(descriptor)


class OpenFile:
    """File that this program writes at its end, and that no other program should change.

    Parameters
    ----------
    storage : Storage
        Access to the files.
    path : Path
        Path of the file.
    descriptor : int
        Descriptor of the file, which is open for reading and writing.
    """

    def __init__(self, storage: Storage, path: Path, descriptor: int) -> None:
        self.path = path
        self.descriptor = descriptor
        self.end = storage.size(descriptor)
        """Length according to this program, bytes."""
        self._storage = storage
        self._stamp = storage.stamp(descriptor)

    def write(self, data: bytes) -> None:
        """Write bytes at `end`, which the caller advances when they are on the disk."""
        began = time.monotonic()
        unchanged = self._storage.stamp(self.descriptor) == self._stamp
        self._storage.write_at(self.descriptor, data, self.end)
        # Before the sync: a write of another program during the sync changes the stamp again.
        stamp = self._storage.stamp_after_write(self.descriptor)
        # This stamp would hide a write of another program before it or meanwhile.
        is_quick = time.monotonic() - began < MAX_TRUSTED_WRITE_S
        self._stamp = stamp if unchanged and is_quick else None

    def cut(self) -> None:
        """Cut the file to the length `end`."""
        self._stamp = None
        self._storage.truncate(self.descriptor, self.end)

    def problem(self, compare: Callable[[], str | None]) -> str | None:
        """Return a message if the file was deleted, replaced or changed by others; else None.

        Parameters
        ----------
        compare : callable
            Function that compares the content and returns a message if it was changed. It is called
            if the times of the file have changed since the last write or comparison.
        """
        name = self.path.name
        try:
            present = os.lstat(self.path)
        except FileNotFoundError:
            return f"{name} was deleted"
        except OSError as err:
            return f"{name} can no longer be accessed ({err.strerror or err})"
        opened = os.fstat(self.descriptor)
        if not os.path.samestat(opened, present):
            return f"{name} was replaced by another file"
        if opened.st_size < self.end:
            return f"{name} was cut from {self.end} to {opened.st_size} bytes"
        if opened.st_size > self.end:
            return f"{name} was written to by another program"
        stamp = self._storage.stamp(self.descriptor)
        if stamp is not None and stamp == self._stamp:
            return None
        damage = compare()
        if damage is None:
            self._stamp = stamp
            return None
        return f"{name} was overwritten by another program{damage}"

    def close(self) -> None:
        """Close the file; all of its content was synced."""
        with contextlib.suppress(OSError):
            self._storage.close(self.descriptor)


def draft_of(path: Path) -> Path:
    """Return the temporary path at which a file is written before it is renamed to `path`."""
    return path.with_name(f".{path.name}.tmp")


def flush_to_disk(descriptor: int) -> None:
    """Wait until an open file or folder is on the disk."""
    if sys.platform == "darwin":  # fsync of macOS only reaches the drive's cache
        import fcntl

        try:
            fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)
            return
        except OSError as err:
            if err.errno not in _NO_FULL_SYNC:
                raise
    os.fsync(descriptor)


def replace_file(source: Path, target: Path) -> None:
    """Rename a file; an existing file `target` is replaced.

    Raises
    ------
    OSError
        If it fails; on Windows with the reason `IN_USE` if another program has the target open.
    """
    until = time.monotonic() + REPLACE_RETRY_S
    while True:
        try:
            os.replace(source, target)
            return
        except PermissionError as err:
            if os.name != "nt":
                raise
            if time.monotonic() > until:
                place = target if target.exists() else source
                if not os.access(place, os.W_OK):
                    raise
                raise PermissionError(err.errno, IN_USE, os.fspath(place)) from err
        time.sleep(LOCK_PAUSE_S)


def has_content(path: Path, data: bytes) -> bool:
    """Return True if a file has exactly these bytes; a file of another size is not read."""
    try:
        return path.stat().st_size == len(data) and path.read_bytes() == data
    except FileNotFoundError:
        return False


def is_full(err: OSError) -> bool:
    """Return True if an error means a full disk, a full quota or a file that is too long."""
    return err.errno in FULL_ERRORS
