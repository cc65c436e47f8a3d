r"""Reading of zip archives from an unknown origin.

Sizes are limited, nothing is extracted to the disk, and names with ``/`` or ``\`` are accepted.
"""

import io
import zipfile

from pfwd.errors import TraceError, quote, refusal

MAX_MEMBER_BYTES = 64_000_000
"""Unpacked size of a member; a point takes about 100 kB, the largest known database a few MB."""

MAX_ARCHIVE_BYTES = 128_000_000
"""Unpacked size of all members that are read: over a thousand points of about 100 kB. They take
twice as much memory as numbers, and as much again as drops."""

MAX_DIRECTORY_BYTES = 4_000_000
"""Size of the list of members: about 40,000 of them, forty times those of a long day."""

_CHUNK_BYTES = 1 << 20


class BoundedReads(io.FileIO):
    """File that refuses very long reads: zipfile reads a list of members of any length at once.

    Parameters
    ----------
    file : str
        Path of the file.
    limit : int
        Largest number of bytes of a read.
    """

    def __init__(self, file: str, limit: int) -> None:
        super().__init__(file)
        self._limit = limit

    def read(self, size: int | None = -1, /) -> bytes:
        """Return at most `size` bytes; all up to the limit if it is None or negative."""
        if size is None or size < 0:  # the end of the archive, at most 65 kB
            size = self._limit
        if size > self._limit:
            raise ValueError(f"a list of members of {size} bytes")
        return super().read(size) or b""


class Archive:
    """Zip archive whose members are read by name.

    Parameters
    ----------
    file : str
        Path of the archive.

    Raises
    ------
    TraceError
        If the file is no zip archive, or cannot be read.
    """

    def __init__(self, file: str) -> None:
        self.file = file
        self._remaining_bytes = MAX_ARCHIVE_BYTES
        self._stream = BoundedReads(file, MAX_DIRECTORY_BYTES)
        try:
            self._zip = zipfile.ZipFile(self._stream)
        except Exception as err:  # zipfile documents no errors for damaged archives
            self._stream.close()
            hint = "it may be cut off: copy it again"
            reason = quote(str(err) or type(err).__name__)
            raise TraceError(refusal(file, "a readable zip archive", reason, hint)) from err
        # Some programs write backslashes into the names, on every system.
        self._members = {
            member.filename.replace("\\", "/").lower(): member
            for member in self._zip.infolist()
            if not member.filename.endswith(("/", "\\"))
        }

    def __enter__(self) -> "Archive":
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()
        self._stream.close()

    @property
    def names(self) -> list[str]:
        """Names of all members in lower case, with ``/`` between folders."""
        return list(self._members)

    def read(self, name: str) -> bytes:
        """Return the unpacked content of a member.

        Parameters
        ----------
        name : str
            One of `names`.

        Raises
        ------
        TraceError
            If the member is damaged, encrypted, packed in an unknown way, or too large.
        """
        member = self._members[name]
        where = f"{self.file}, {quote(name)[1:-1]}"
        if member.flag_bits & 1:
            hint = "save it unencrypted"
            raise TraceError(refusal(where, "a plain member", "an encrypted one", hint))
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise TraceError(refusal(where, "a member packed by deflate", "another method"))
        limit = min(MAX_MEMBER_BYTES, self._remaining_bytes)
        if member.file_size > limit:
            raise TraceError(refusal(where, f"at most {limit / 1e6:.0f} MB", "more"))
        try:
            with self._zip.open(member) as stream:
                # Never more than declared. In pieces, as every read of the stream is bounded.
                content = b"".join(iter(lambda: stream.read(_CHUNK_BYTES), b""))
        except Exception as err:  # zipfile documents no errors for damaged archives
            hint = "copy the file again"
            actual = f"damage: {quote(str(err))}"
            raise TraceError(refusal(where, "an intact member", actual, hint)) from err
        self._remaining_bytes -= len(content)
        return content
