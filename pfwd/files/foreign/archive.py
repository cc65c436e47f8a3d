"""A zip archive that cannot do harm: bounded sizes, names with either slash, nothing extracted."""

import io
import zipfile
from pathlib import Path

from pfwd.errors import TraceError, quote, refusal

LARGEST_MEMBER = 64_000_000
"""Bytes, unpacked; a point takes some 100 kB and the largest database seen a few MB."""

LARGEST_TOTAL = 128_000_000
"""Bytes, unpacked, of all that is read of an archive: over a thousand points of some 100 kB. They
take twice as much as numbers and once more as drops."""

LARGEST_DIRECTORY = 4_000_000
"""Bytes of the list of members: some 40 000 of them, forty times what a long day makes."""

_END, _END_SIZE, _LONGEST_END = b"PK\x05\x06", 22, 22 + 65_535
_LARGE_END, _LARGE_END_SIZE = b"PK\x06\x07", 20
_CHUNK = 1 << 20


class Archive:
    """Members of a zip archive by name, ``/`` between folders, read into memory and checked.

    Parameters
    ----------
    file : str

    Raises
    ------
    TraceError
        If it is no archive, or one that cannot be read.
    """

    def __init__(self, file: str) -> None:
        self.file = file
        self._left = LARGEST_TOTAL
        try:
            _check_directory(file)
            self._zip = zipfile.ZipFile(file)
        except TraceError:
            raise
        except Exception as err:  # what zipfile raises on damage is not documented
            raise TraceError(_no_archive(file, err)) from err
        # Some programs write a backslash into the names, on every system.
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
        """Names of all members, in small letters."""
        return list(self._members)

    def read(self, name: str) -> bytes:
        """A member, unpacked.

        Raises
        ------
        TraceError
            If it is damaged, encrypted, packed in an unknown way, or too large.
        """
        member = self._members[name]
        where = f"{self.file}, {quote(name)[1:-1]}"
        if member.flag_bits & 1:
            raise TraceError(refusal(where, "a plain member", "an encrypted one", "save it anew"))
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise TraceError(refusal(where, "a member packed by deflate", "another method"))
        limit = min(LARGEST_MEMBER, self._left)
        if member.file_size > limit:
            raise TraceError(refusal(where, f"at most {limit / 1e6:.0f} MB", "more"))
        found, size = io.BytesIO(), 0
        try:
            with self._zip.open(member) as stream:
                # In pieces: what is announced need not be what comes.
                while chunk := stream.read(_CHUNK):
                    size += len(chunk)
                    if size > limit:
                        raise TraceError(refusal(where, f"at most {limit / 1e6:.0f} MB", "more"))
                    found.write(chunk)
        except TraceError:
            raise
        except Exception as err:  # as above
            raise TraceError(
                refusal(where, "a whole member", f"damage: {quote(str(err))}")
            ) from err
        self._left -= size
        return found.getvalue()


def _check_directory(file: str) -> None:
    """Refuse a list of members that would fill the memory before the first is looked at."""
    size = Path(file).stat().st_size
    with open(file, "rb") as stream:
        stream.seek(max(0, size - _LONGEST_END))
        tail = stream.read(_LONGEST_END)
    at = tail.rfind(_END)
    if at < 0 or at + _END_SIZE > len(tail):
        hint = "it was cut off: copy it again" if size else ""
        raise TraceError(refusal(file, "a zip archive", "a file without the end of one", hint))
    if tail[max(0, at - _LARGE_END_SIZE) : at].startswith(_LARGE_END):
        # Its list of members is elsewhere, and as long as it likes.
        raise TraceError(refusal(file, "an archive of less than 4 GB", "a zip64 archive"))
    length = int.from_bytes(tail[at + 12 : at + 16], "little")
    if length > LARGEST_DIRECTORY:
        raise TraceError(refusal(file, "a usual number of members", f"{length} bytes of names"))


def _no_archive(file: str, err: Exception) -> str:
    reason = getattr(err, "strerror", None) or str(err) or type(err).__name__
    return refusal(
        file, "a readable zip archive", quote(reason), "it may be cut off: copy it again"
    )
