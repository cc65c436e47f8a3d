"""Raw captures: files with every byte between instrument and computer, with direction and time.

A capture can be replayed. Its records have the form of :mod:`pfwd_device.recording.framing`. The
first record is the header (JSON), each following one contains bytes: ``u64 monotonic nanoseconds |
u64 nanoseconds since 1970 UTC | u8 direction (0 from, 1 to the instrument, 2 message) | bytes``. A
message precedes its bytes to the instrument; it has the form of the binary protocol for every
instrument. A capture is written every second. Killing the program loses the bytes of the last
second, but no recorded drop.
"""

import contextlib
import os
import struct
import threading
import time
import uuid
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pfwd_device.errors import RecordingError
from pfwd_device.recording.framing import Damage, RecordKind, encode_frame, scan
from pfwd_device.recording.payload import encode_payload, payload_data
from pfwd_device.recording.storage import Storage

CAPTURE_VERSION = 1

FLUSH_INTERVAL_S = 1.0
"""Time between two writes to the file, s."""

FLUSH_BYTES = 2**20
"""Number of waiting bytes from which they are written without delay."""

Direction = Literal["from", "to", "message"]

_PREFIX = struct.Struct("<QQB")
_DIRECTIONS: tuple[Direction, ...] = ("from", "to", "message")


@dataclass(frozen=True, slots=True)
class CapturedBytes:
    """Bytes of a capture that were received or sent together."""

    monotonic_ns: int
    """Monotonic clock of the host, ns; only differences have a meaning."""
    utc_ns: int
    """Time since 1970, UTC, by the clock of the host, ns."""
    direction: Direction
    """Direction: from or to the instrument, or a message whose bytes to the instrument follow."""
    data: bytes


class CaptureWriter:
    """Writer of a raw capture. If the disk fails, only the capture ends, not the measurement.

    Parameters
    ----------
    path : Path
        File of the capture, which must not exist yet.
    header : mapping
        Description of the capture as JSON values: url, dialect, identity, setup.
    storage : Storage, optional
        Access to the files; by default that of the system.

    Raises
    ------
    RecordingError
        If the file cannot be created.
    """

    def __init__(
        self, path: Path, header: Mapping[str, Any], *, storage: Storage | None = None
    ) -> None:
        self.path = path
        self.failure: str | None = None
        """Reason why the capture has ended; None while it is written."""
        self._storage = storage or Storage()
        self._identity = uuid.uuid4().bytes
        self._sequence = 1
        self._waiting = bytearray()
        self._end = 0
        self._timer: threading.Timer | None = None
        self._lock = threading.Lock()
        header_data = {"format_version": CAPTURE_VERSION, **header}
        self._frame(RecordKind.CAPTURE, encode_payload(header_data))
        self._descriptor: int | None = None
        try:
            self._storage.make_folder(path.parent)
            self._descriptor = self._storage.open(path, create=True)
            self._storage.sync_directory(path.parent)
            self._flush()
        except OSError as err:
            self._shut()
            raise RecordingError(f"{path}: expected a new file, got {err}") from err

    def write(
        self,
        direction: Direction,
        data: bytes,
        monotonic_ns: int | None = None,
        utc_ns: int | None = None,
    ) -> None:
        """Add bytes to the capture; they are written to the file within a second.

        Parameters
        ----------
        direction : "from", "to" or "message"
            From or to the instrument, or a message whose bytes to the instrument follow.
        data : bytes
        monotonic_ns, utc_ns : int or None, ns
            Monotonic clock of the host and time since 1970; None: the present times.
        """
        monotonic_ns = time.monotonic_ns() if monotonic_ns is None else monotonic_ns
        utc_ns = time.time_ns() if utc_ns is None else utc_ns
        now = _PREFIX.pack(monotonic_ns, max(utc_ns, 0), _DIRECTIONS.index(direction))
        with self._lock:
            if self._descriptor is None:
                return
            self._frame(RecordKind.BYTES, now + bytes(data))
            if len(self._waiting) >= FLUSH_BYTES:
                self._try_to_flush()
            elif self._timer is None:
                # A timer writes the bytes even if no further call follows.
                self._timer = threading.Timer(FLUSH_INTERVAL_S, self.flush)
                self._timer.daemon = True
                self._timer.start()

    def flush(self) -> None:
        """Write the waiting bytes to the file now."""
        with self._lock:
            self._try_to_flush()

    def close(self) -> None:
        """Write the waiting bytes and end the capture."""
        with self._lock:
            self._try_to_flush()
            if self._descriptor is not None:
                try:
                    self._storage.sync(self._descriptor)
                except OSError as err:
                    self.failure = str(err)
            self._shut()

    def _frame(self, kind: int, payload: bytes) -> None:
        self._waiting += encode_frame(kind, self._identity, self._sequence, payload)
        self._sequence += 1

    def _try_to_flush(self) -> None:
        timer, self._timer = self._timer, None
        if timer is not None:
            timer.cancel()
        if self._descriptor is None:
            return
        try:
            self._flush()
        except OSError as err:
            self.failure = err.strerror or str(err)
            with contextlib.suppress(OSError):
                self._storage.truncate(self._descriptor, self._end)
            self._shut()

    def _flush(self) -> None:
        assert self._descriptor is not None
        data = bytes(self._waiting)
        self._storage.write_at(self._descriptor, data, self._end)
        self._end += len(data)
        self._waiting.clear()

    def _shut(self) -> None:
        if self._descriptor is not None:
            descriptor, self._descriptor = self._descriptor, None
            with contextlib.suppress(OSError):
                self._storage.close(descriptor)


class CaptureReader:
    """Reader of a raw capture, an iterable of `CapturedBytes`.

    Damaged parts of the file are skipped and listed in `damage`.

    Parameters
    ----------
    path : path
        File of the capture.

    Raises
    ------
    RecordingError
        If the file cannot be read, or has another format version.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.header: dict[str, Any] = {}
        """Description of the capture; empty if its record is damaged."""
        self.damage: list[str] = []
        """Descriptions of the damaged parts, complete after an iteration to the end."""
        items = self._items()
        first = next(items, None)
        items.close()
        if isinstance(first, dict):
            self.header = first
            if (version := first.get("format_version")) != CAPTURE_VERSION:
                raise RecordingError(
                    f"{self.path}: expected format version {CAPTURE_VERSION} of a capture, got "
                    f"{version!r:.40}"
                )
        self.damage.clear()

    def __iter__(self) -> Iterator[CapturedBytes]:
        self.damage.clear()
        for item in self._items():
            if isinstance(item, CapturedBytes):
                yield item

    def _items(self) -> Generator[dict[str, Any] | CapturedBytes, None, None]:
        sequence = 0
        try:
            with self.path.open("rb") as stream:
                for part in scan(stream):
                    if isinstance(part, Damage):
                        end = " at the end" if part.at_end else ""
                        self.damage.append(f"byte {part.offset}: {part.length} bytes{end}")
                        continue
                    if part.sequence != sequence + 1:
                        self.damage.append(f"byte {part.offset}: records are missing before it")
                    sequence = part.sequence
                    item = decode_capture(part.kind, part.payload)
                    if item is None:
                        self.damage.append(f"byte {part.offset}: no record of a capture")
                    else:
                        yield item
        except OSError as err:
            raise RecordingError(f"{self.path}: expected a capture, got {err}") from err


def decode_capture(kind: int, payload: bytes) -> dict[str, Any] | CapturedBytes | None:
    """Return the content of a record of a capture: its header or transferred bytes.

    None if the record is damaged or does not belong to a capture.

    Parameters
    ----------
    kind : int
        Kind of the record, one of `RecordKind`.
    payload : bytes
        Content of the record.
    """
    if kind == RecordKind.CAPTURE:
        try:
            return payload_data(payload)
        except RecordingError:
            return None
    if kind != RecordKind.BYTES or len(payload) < _PREFIX.size:
        return None
    monotonic, utc, direction = _PREFIX.unpack_from(payload)
    if direction >= len(_DIRECTIONS):
        return None
    return CapturedBytes(monotonic, utc, _DIRECTIONS[direction], payload[_PREFIX.size :])
