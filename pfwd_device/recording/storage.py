"""Thin layer over the files of the operating system, which tests replace by failing ones."""

import contextlib
import errno
import os
import shutil
import sys
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


Stamp = tuple[int, int] | None
"""Times (ns) of the last change of a file's content and of its metadata; None if unknown.

An equal stamp does not prove that nothing was written: the clock of a file system may stand still
for 4 ms, or for 2 s. Another stamp does not prove that something was written. The content decides.
"""


class Storage:
    """Writing of files that survive a power cut, without buffers.

    Unless stated otherwise every method may raise OSError. The caller passes all offsets, and no
    descriptor has a position, so that an incomplete write can be repeated.
    """

    def open(self, path: Path, *, create: bool = False) -> int:
        """Open a file for reading and writing; with `create` the file must not exist yet."""
        flags = os.O_RDWR | _BINARY | _NOT_INHERITED | _NO_FOLLOW
        if create:
            flags |= os.O_CREAT | os.O_EXCL
        return os.open(path, flags, 0o666)

    def close(self, descriptor: int) -> None:
        """Close a descriptor."""
        os.close(descriptor)

    def pwrite(self, descriptor: int, data: memoryview, offset: int) -> int:
        """Write at an offset; return the number of written bytes, perhaps fewer than all."""
        if sys.platform != "win32":
            return os.pwrite(descriptor, data, offset)
        else:  # noqa: RET505 - only an else is left out of the checks for other platforms
            os.lseek(descriptor, offset, os.SEEK_SET)
            return os.write(descriptor, data)

    def write_at(self, descriptor: int, data: bytes, offset: int) -> None:
        """Write all of `data`, with further writes after an incomplete one."""
        rest = memoryview(data)
        while rest:
            written = self.pwrite(descriptor, rest, offset)
            if written <= 0:
                raise OSError(errno.ENOSPC, "the disk took no more bytes")
            rest = rest[written:]
            offset += written

    def sync(self, descriptor: int) -> None:
        """Wait until content and length are on the disk."""
        if sys.platform == "darwin":  # fsync of macOS only reaches the drive's cache
            import fcntl

            fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)
        elif hasattr(os, "fdatasync"):
            os.fdatasync(descriptor)
        else:
            os.fsync(descriptor)

    def read_at(self, descriptor: int, length: int, offset: int) -> bytes:
        """Read at `offset`; return fewer than `length` bytes at the end of the file."""
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

        On Windows no lock is needed: a lock would exclude readers, and an open file, such as
        ``survey.lock``, can be neither deleted nor replaced.
        """
        if sys.platform == "win32":
            return True
        else:  # noqa: RET505 - only an else is left out of the checks for Windows
            import fcntl

            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as err:
                # Other errors: a file system without locks. Writes of other programs are detected
                # nevertheless.
                return err.errno not in (errno.EACCES, errno.EAGAIN)
            return True

    def size(self, descriptor: int) -> int:
        """Return the length of the file, bytes."""
        return os.fstat(descriptor).st_size

    def names(self, descriptor: int) -> int:
        """Return the number of names of the file: 0 after a deletion, 2 after a link was made."""
        return os.fstat(descriptor).st_nlink

    def stamp(self, descriptor: int) -> Stamp:
        """Return the stamp of the file, which changes with each write; never raise."""
        try:
            status = os.fstat(descriptor)
        except OSError:
            return None
        return status.st_mtime_ns, status.st_ctime_ns

    def stamp_after_write(self, descriptor: int) -> Stamp:
        """Return the stamp after a write of this program, with a time that no clock gives.

        The clock of a file system stands still for some ms: a write of another program within the
        same tick would leave the same time. Not all systems can set the time.
        """
        if os.utime in os.supports_fd:
            with contextlib.suppress(OSError):  # writes within one tick then have equal stamps
                status = os.fstat(descriptor)
                os.utime(descriptor, ns=(status.st_atime_ns, status.st_mtime_ns + 1))
        return self.stamp(descriptor)

    def misplaced(self, descriptor: int, path: Path, end: int) -> str | None:
        """Return why the file at `path` is not the open one with `end` bytes; None if it is."""
        try:
            present = os.lstat(path)
        except OSError as err:
            if isinstance(err, FileNotFoundError):
                return f"{path.name} is gone"
            return f"{path.name} cannot be reached any more ({err.strerror or err})"
        opened = os.fstat(descriptor)
        if not os.path.samestat(opened, present):
            return f"{path.name} was replaced by another file"
        if opened.st_size < end:
            return f"{path.name} was cut from {end} to {opened.st_size} bytes"
        if opened.st_size > end:
            return f"{path.name} was written to by another program"
        return None

    def truncate(self, descriptor: int, size: int) -> None:
        """Cut the file to `size` bytes."""
        os.ftruncate(descriptor, size)

    def replace(self, source: Path, target: Path) -> None:
        """Rename within one folder; a file at `target` is replaced."""
        os.replace(source, target)

    def unlink(self, path: Path) -> None:
        """Delete a file: the reserve, a draft, or a file with a copy in ``damaged``."""
        os.unlink(path)

    def make_directory(self, path: Path) -> None:
        """Create one folder, unless it exists."""
        if not path.is_dir():
            try:
                os.mkdir(path)
            except FileExistsError:  # another program was faster
                if not path.is_dir():
                    raise

    def sync_directory(self, path: Path) -> None:
        """Wait until new and changed names in the folder are on the disk."""
        if os.name == "nt":  # Windows has no such call; NTFS has a journal of names
            return
        descriptor = os.open(path, os.O_RDONLY | _NOT_INHERITED)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def free_bytes(self, path: Path) -> int:
        """Return the free space on the disk of `path`, bytes."""
        return shutil.disk_usage(path).free

    def make_folder(self, path: Path) -> None:
        """Create the folder and its parents, and wait until each is on the disk."""
        missing = []
        while not path.is_dir():
            missing.append(path)
            if path.parent == path:
                break
            path = path.parent
        # A former run may have ended before the name of the last existing folder was on the disk.
        with contextlib.suppress(PermissionError):  # a folder of another user
            self.sync_directory(path.parent)
        for folder in reversed(missing):
            self.make_directory(folder)
            self.sync_directory(folder.parent)

    def write_file(self, path: Path, data: bytes) -> None:
        """Replace a file atomically: write a draft, sync, rename, sync the name."""
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


def draft_of(path: Path) -> Path:
    """Return the temporary name of a file that becomes `path` when it is complete."""
    return path.with_name(f".{path.name}.tmp")


def has_content(path: Path, data: bytes) -> bool:
    """Return True if a file has exactly these bytes; a file of another size is not read."""
    try:
        return path.stat().st_size == len(data) and path.read_bytes() == data
    except FileNotFoundError:
        return False


def is_full(err: OSError) -> bool:
    """Return True if the error means that there is no room."""
    return err.errno in FULL_ERRORS
