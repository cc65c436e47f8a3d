"""The operating system's files, as thin as can be, so that a test can put failing ones in place."""

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
"""What the system says when a disk, a quota or the longest file is full."""

_BINARY = getattr(os, "O_BINARY", 0)  # Windows would translate line ends otherwise
_NO_LINK = getattr(
    os, "O_NOFOLLOW", 0
)  # a survey from a stranger may hold links that lead out of it
_NOT_INHERITED = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NOINHERIT", 0)


Stamp = tuple[int, int] | None
"""Times (ns) of the last change of a file's content, and of what is known of it.

An equal stamp does not say that nobody wrote: the clock of a file system may stand still for 4 ms,
or 2 s. Another one does not say that somebody did. Content decides. None: the system does not say
it.
"""


class Storage:
    """Writes files so that a power cut is survived; nothing here is buffered.

    Every method may raise OSError where nothing else is said. The offsets are the caller's: no
    descriptor has a position that matters, so that what was torn can be written over.
    """

    def open(self, path: Path, *, create: bool = False) -> int:
        """A descriptor for reading and writing; `create`: the file must not exist yet."""
        flags = os.O_RDWR | _BINARY | _NOT_INHERITED | _NO_LINK
        if create:
            flags |= os.O_CREAT | os.O_EXCL
        return os.open(path, flags, 0o666)

    def close(self, descriptor: int) -> None:
        """Give the descriptor back."""
        os.close(descriptor)

    def pwrite(self, descriptor: int, data: memoryview, offset: int) -> int:
        """Bytes written, which may be fewer than there are."""
        if sys.platform != "win32":
            return os.pwrite(descriptor, data, offset)
        else:  # noqa: RET505 - only an else is left out of the checks for other platforms
            os.lseek(descriptor, offset, os.SEEK_SET)
            return os.write(descriptor, data)

    def write_at(self, descriptor: int, data: bytes, offset: int) -> None:
        """Write all of `data`, however short the single writes are."""
        rest = memoryview(data)
        while rest:
            written = self.pwrite(descriptor, rest, offset)
            if written <= 0:
                raise OSError(errno.ENOSPC, "the disk took no more bytes")
            rest = rest[written:]
            offset += written

    def sync(self, descriptor: int) -> None:
        """Return when content and length are on the disk."""
        if sys.platform == "darwin":  # there fsync stops at the drive's cache
            import fcntl

            fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)
        elif hasattr(os, "fdatasync"):
            os.fdatasync(descriptor)
        else:
            os.fsync(descriptor)

    def read_at(self, descriptor: int, length: int, offset: int) -> bytes:
        """What is at `offset`; fewer bytes than asked for where the file ends."""
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
        """Whether no other program has locked the file; it is locked until it is closed.

        On Windows nothing is locked and nothing needs to be: there a lock keeps readers out, and a
        file that is open, such as ``survey.lock``, can be neither deleted nor replaced.
        """
        if sys.platform == "win32":
            return True
        else:  # noqa: RET505 - only an else is left out of the checks for Windows
            import fcntl

            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as err:
                # Other errors: a file system without locks. What others write is noticed all the
                # same.
                return err.errno not in (errno.EACCES, errno.EAGAIN)
            return True

    def size(self, descriptor: int) -> int:
        """Length of the file, bytes."""
        return os.fstat(descriptor).st_size

    def names(self, descriptor: int) -> int:
        """How many names the file has: 0 when it was deleted, 2 when it was linked."""
        return os.fstat(descriptor).st_nlink

    def stamp(self, descriptor: int) -> Stamp:
        """What changes when anybody writes to the file, and hardly ever otherwise; never raises."""
        try:
            said = os.fstat(descriptor)
        except OSError:
            return None
        return said.st_mtime_ns, said.st_ctime_ns

    def stamp_own_write(self, descriptor: int) -> Stamp:
        """The stamp after a write of one's own, where it can be set one that no clock gives.

        The clock of a file system stands still for some ms: who writes within the same tick would
        leave the same time.
        """
        if os.utime in os.supports_fd:
            with contextlib.suppress(OSError):  # then a tick is what cannot be told apart
                said = os.fstat(descriptor)
                os.utime(descriptor, ns=(said.st_atime_ns, said.st_mtime_ns + 1))
        return self.stamp(descriptor)

    def misplaced(self, descriptor: int, path: Path, end: int) -> str | None:
        """Why the file at `path` is not the open one with `end` bytes; None when it is."""
        try:
            there = os.lstat(path)
        except OSError as err:
            if isinstance(err, FileNotFoundError):
                return f"{path.name} is gone"
            return f"{path.name} cannot be reached any more ({err.strerror or err})"
        mine = os.fstat(descriptor)
        if not os.path.samestat(mine, there):
            return f"{path.name} was replaced by another file"
        if mine.st_size < end:
            return f"{path.name} was cut from {end} to {mine.st_size} bytes"
        if mine.st_size > end:
            return f"{path.name} was written to by another program"
        return None

    def truncate(self, descriptor: int, size: int) -> None:
        """Cut the file at `size` bytes."""
        os.ftruncate(descriptor, size)

    def replace(self, source: Path, target: Path) -> None:
        """Rename within one folder; what was at `target` is gone."""
        os.replace(source, target)

    def unlink(self, path: Path) -> None:
        """Take a name away: of the reserve, of drafts and of what has a copy in ``damaged``."""
        os.unlink(path)

    def make_directory(self, path: Path) -> None:
        """Make one folder; one that exists is fine."""
        if not path.is_dir():
            try:
                os.mkdir(path)
            except FileExistsError:  # another program was faster
                if not path.is_dir():
                    raise

    def sync_directory(self, path: Path) -> None:
        """Return when names made or changed in the folder are on the disk."""
        if os.name == "nt":  # has no such call; NTFS journals names itself
            return
        descriptor = os.open(path, os.O_RDONLY | _NOT_INHERITED)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def free_bytes(self, path: Path) -> int:
        """Bytes that may still be written to the disk of `path`."""
        return shutil.disk_usage(path).free

    def make_folder(self, path: Path) -> None:
        """Make the folder and its parents, each on the disk before this returns."""
        missing = []
        while not path.is_dir():
            missing.append(path)
            if path.parent == path:
                break
            path = path.parent
        # The last one that is there may be of a run that ended before its name was on the disk.
        with contextlib.suppress(PermissionError):  # then it was not made by this program
            self.sync_directory(path.parent)
        for folder in reversed(missing):
            self.make_directory(folder)
            self.sync_directory(folder.parent)

    def write_file(self, path: Path, data: bytes) -> None:
        """Put a whole file in place at once: draft, on the disk, renamed, name on the disk."""
        draft = draft_of(path)
        self.write_draft(draft, data)
        self.replace(draft, path)
        self.sync_directory(path.parent)

    def write_draft(self, draft: Path, data: bytes) -> None:
        """Write a file that has not its final name yet, and wait until it is on the disk."""
        if draft.exists():  # of a run that was killed
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
    """Name of the file that becomes `path` once it is whole."""
    return path.with_name(f".{path.name}.tmp")


def is_full(err: OSError) -> bool:
    """Whether the error says that there is no room, rather than that the disk fails."""
    return err.errno in FULL_ERRORS
