r"""Reading of zip archives from an unknown origin.

Sizes are limited, nothing is extracted to the disk, and names with ``/`` or ``\`` are accepted.
"""

import io
import zipfile
from pathlib import Path

from pfwd.errors import TraceError, quote, refusal

MAX_MEMBER_BYTES = 64_000_000
"""Unpacked size of a member; a point takes about 100 kB, the largest known database a few MB."""

MAX_ARCHIVE_BYTES = 128_000_000
"""Unpacked size of all members that are read: over a thousand points of about 100 kB. They take
twice as much memory as numbers, and as much again as drops."""

MAX_DIRECTORY_BYTES = 4_000_000
"""Size of the list of members: about 40,000 of them, forty times those of a long day."""

_END, _END_SIZE, _MAX_END_SIZE = b"PK\x05\x06", 22, 22 + 65_535
_ZIP64_END, _ZIP64_END_SIZE = b"PK\x06\x07", 20
_CHUNK_BYTES = 1 << 20


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
        try:
            _check_directory(file)
            self._zip = zipfile.ZipFile(file)
        except TraceError:
            raise
        except Exception as err:  # zipfile documents no errors for damaged archives
            reason = getattr(err, "strerror", None) or str(err) or type(err).__name__
            hint = "it may be cut off: copy it again"
            raise TraceError(refusal(file, "a readable zip archive", quote(reason), hint)) from err
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
            raise TraceError(
                refusal(where, "a plain member", "an encrypted one", "save it unencrypted")
            )
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise TraceError(refusal(where, "a member packed by deflate", "another method"))
        limit = min(MAX_MEMBER_BYTES, self._remaining_bytes)
        if member.file_size > limit:
            raise TraceError(refusal(where, f"at most {limit / 1e6:.0f} MB", "more"))
        content, size = io.BytesIO(), 0
        try:
            with self._zip.open(member) as stream:
                # In pieces: the real size may exceed the declared one.
                while chunk := stream.read(_CHUNK_BYTES):
                    size += len(chunk)
                    if size > limit:
                        raise TraceError(refusal(where, f"at most {limit / 1e6:.0f} MB", "more"))
                    content.write(chunk)
        except TraceError:
            raise
        except Exception as err:  # zipfile documents no errors for damaged archives
            hint = "copy the file again"
            raise TraceError(
                refusal(where, "an intact member", f"damage: {quote(str(err))}", hint)
            ) from err
        self._remaining_bytes -= size
        return content.getvalue()


def _check_directory(file: str) -> None:
    """Refuse an archive whose list of members would fill the memory."""
    size = Path(file).stat().st_size
    with open(file, "rb") as stream:
        stream.seek(max(0, size - _MAX_END_SIZE))
        tail = stream.read(_MAX_END_SIZE)
    at = tail.rfind(_END)
    if at < 0 or at + _END_SIZE > len(tail):
        hint = "it was cut off: copy it again" if size else ""
        raise TraceError(refusal(file, "a zip archive", "a file without the end of one", hint))
    if tail[max(0, at - _ZIP64_END_SIZE) : at].startswith(_ZIP64_END):
        # The list of members of zip64 is elsewhere, and may be of any length.
        raise TraceError(refusal(file, "an archive of less than 4 GB", "a zip64 archive"))
    length = int.from_bytes(tail[at + 12 : at + 16], "little")
    if length > MAX_DIRECTORY_BYTES:
        expected = f"a list of members of at most {MAX_DIRECTORY_BYTES} bytes"
        raise TraceError(refusal(file, expected, str(length), "import parts of the project"))
