"""Index of a survey: its points, drops, files and lost records, without the traces.

The journal contains all records of a survey: points, drops, rebounds, edits, events and files. The
ledger is a text file with a line for each record that reached the disk. A record has a sequence
number. A drop has a survey-wide number and a number within its point.
"""

import contextlib
import gc
import itertools
import os
import re
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pfwd_device.errors import RecordingError
from pfwd_device.recording.files import chunks
from pfwd_device.recording.framing import Damage, Frame, RecordKind
from pfwd_device.recording.journal import read_record, scan_journal
from pfwd_device.recording.layout import FORMAT_VERSION, Layout
from pfwd_device.recording.ledger import (
    Entry,
    LedgerText,
    about_drop,
    read_ledger,
)
from pfwd_device.recording.payload import payload_data
from pfwd_device.recording.record import point_name

_OF_OPERATOR = ("note", "target", "discard", "restore", "position", "name", "operator", "declared")
EDITS = (*_OF_OPERATOR, "rate_deviation")
"""Kinds of edits of a point or drop; they change nothing that was recorded."""

NUMBER_LIMIT = 10**9
"""Limit of the numbers of drops and of kinds of record; record numbers may be a million times
larger. A larger number means damage."""

_MAX_GAPS = 1000
"""Number of missing record numbers that are listed; a crafted journal may have billions."""

_PUBLISHED_PATH = re.compile(r"(drops|results|captures)/\w[\w.-]*", re.ASCII)

_INDEXED_KEYS = {
    RecordKind.SURVEY: ("created_utc", "software", "format_version"),
    RecordKind.POINT: ("name", "order", "declared"),
    RecordKind.DROP: ("number", "point", "drop", "key", "restored_from", "peaks"),
    RecordKind.REBOUND: ("number",),
    RecordKind.EDIT: ("what", "value", "point", "number", "time_utc"),
    RecordKind.EVENT: ("event", "damage", "settled"),
    RecordKind.FILE: ("path", "size", "sha256", "number"),
}


@dataclass(slots=True)
class DropEntry:
    """Drop in the journal of a survey."""

    number: int
    """Number within the survey."""
    point: str
    """Name of the test point."""
    drop: int
    """Number within the point."""
    key: str | None
    """Text that identifies the drop on its instrument; None: without one, or not read yet."""
    entry: Entry
    """Place of its record in the journal."""
    rebounds: list[Entry]
    """Places of the records of its rebounds."""
    restored_from: int | None
    """Sequence number of the damaged record that it replaces; None for an original record."""

    @property
    def places(self) -> list[tuple[int, int]]:
        """Segment and position, bytes, of the records of the drop and of its rebounds."""
        return [(entry.segment, entry.offset) for entry in (self.entry, *self.rebounds)]


@dataclass(slots=True)
class FileEntry:
    """File of a drop, a result or a raw capture, as it is listed in the journal."""

    path: str
    """Path within the folder of the survey."""
    size: int
    """Size, bytes."""
    sha256: str
    """SHA-256 of the content, hexadecimal digits."""
    number: int | None
    """Survey-wide number of its drop; None for a capture."""
    entry: Entry
    """Place of the record that lists the file."""


FileStates = tuple[tuple[str, int, int, int, int, int], ...]
"""Name, device, inode, size (bytes) and times of the last changes (ns) of each file of ledger and
journal. If they are unchanged, so are the files."""


@dataclass(slots=True)
class Index:
    """Content of a survey without the traces of its drops."""

    survey: bytes | None = None
    """Identity of the survey, 16 bytes; None if it is lost."""
    info: dict[str, Any] = field(default_factory=dict)
    """Record of the survey: time and program of its creation, format version."""
    points: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Records of the test points by name."""
    drops: dict[int, DropEntry] = field(default_factory=dict)
    """Drops by survey-wide number."""
    keys: dict[str, int] = field(default_factory=dict)
    """Survey-wide number of a drop by its key, the text that identifies it on its instrument."""
    drops_by_peaks: dict[str, list[int]] = field(default_factory=dict)
    """Survey-wide numbers of the drops with the same recorded peaks, by the text of these."""
    has_all_keys: bool = True
    """True if `keys` and `drops_by_peaks` contain all drops; see :func:`complete_keys`."""
    rebounds: dict[int, list[Entry]] = field(default_factory=dict)
    """Records of rebounds by the survey-wide number of their drop."""
    files: dict[str, FileEntry] = field(default_factory=dict)
    """Listed files by path within the survey."""
    edits: list[dict[str, Any]] = field(default_factory=list)
    """Later changes by the user, in order."""
    events: list[Entry] = field(default_factory=list)
    """Records of events such as gaps and recoveries."""
    checks: list[Entry] = field(default_factory=list)
    """Records of checks of the zero or the span of a channel."""
    entries: dict[int, Entry] = field(default_factory=dict)
    """Undamaged records by sequence number."""
    elsewhere: dict[int, Layout] = field(default_factory=dict)
    """Paths of the spare folder for the records that are only there, by sequence number."""
    lost: dict[int, Entry] = field(default_factory=dict)
    """Records that the ledger lists and the journal no longer contains, by sequence number."""
    gaps: list[int] = field(default_factory=list)
    """Sequence numbers that neither journal nor ledger contains."""
    unacknowledged: list[int] = field(default_factory=list)
    """Sequence numbers of undamaged records without a line in the ledger."""
    damage: list[tuple[int, Damage]] = field(default_factory=list)
    """Damaged parts of the journal with the numbers of their files (segments)."""
    strange: list[tuple[Entry, str]] = field(default_factory=list)
    """Undamaged records that do not belong to this survey, and the reason."""
    settled: set[int] = field(default_factory=set)
    """Sequence numbers of lost records that a recovery has replaced completely."""
    handled_damage: set[tuple[int, int, int, int]] = field(default_factory=set)
    """Segment, offset, length and CRC-32 of damaged parts that recovery has handled."""
    ledger: LedgerText = field(default_factory=lambda: LedgerText(None, (), ()))
    closed: bool = False
    """True if the last record closes the survey."""
    _largest_number: int = 0
    """Largest survey-wide number that a record of a drop has."""
    _used: set[tuple[str, int]] = field(default_factory=set)
    """Point and number within it of each record of a drop, also of a replaced one."""
    _largest_drop: dict[str, int] = field(default_factory=dict)
    """Largest number within each point that a record has."""

    @property
    def lost_drops(self) -> dict[int, tuple[str, int]]:
        """Lost drops: point and number within it, by survey-wide number."""
        lost = {}
        for entry in self.lost.values():
            if (drop := entry.drop) is not None and drop[0] not in self.drops:
                lost[drop[0]] = drop[1:]
        return lost

    def next_drop(self, point: str) -> int:
        """Return the number within the point for its next drop, from 1."""
        lost = [drop for name, drop in self.lost_drops.values() if name == point]
        return max([self._largest_drop.get(point, 0), *lost]) + 1

    def is_used(self, point: str, drop: int) -> bool:
        """Return True if the journal contains a drop with this number within the point."""
        return (point, drop) in self._used

    def next_number(self) -> int:
        """Return the survey-wide number for the next drop, from 1."""
        return max([self._largest_number, *self.lost_drops]) + 1

    def add(self, entry: Entry, data: Mapping[str, Any]) -> None:
        """Add a record of the journal to the index.

        Parameters
        ----------
        entry : Entry
            Kind and place of the record.
        data : mapping
            Data of the record.

        Raises
        ------
        RecordingError
            If the data do not fit the kind of the record.
        """
        try:
            self._add(entry, data)
        except (KeyError, TypeError, ValueError, AttributeError) as err:
            raise RecordingError(f"record {entry.sequence}: unexpected data, {err!r}") from err
        self.entries[entry.sequence] = entry
        self.closed = entry.kind == RecordKind.CLOSE

    def with_peaks(self, peaks: Any) -> list[int]:
        """Return the entry of `drops_by_peaks` for recorded peaks; an empty list without any."""
        if not isinstance(peaks, dict):
            return []
        return self.drops_by_peaks.setdefault(str(sorted(peaks.items())), [])

    def relocate(self, moved: Mapping[int, Entry], layout: Layout) -> None:
        """Store the places of records that were written to another folder.

        Parameters
        ----------
        moved : mapping of int to Entry
            New places by sequence number.
        layout : Layout
            Paths of that folder.
        """
        self.elsewhere.update(dict.fromkeys(moved, layout))
        if self.entries.keys().isdisjoint(moved):
            return

        def now(entry: Entry) -> Entry:
            return moved.get(entry.sequence, entry)

        self.entries = {number: now(entry) for number, entry in self.entries.items()}
        for drop in self.drops.values():
            drop.entry = now(drop.entry)
        # The lists of rebounds of the drops are the same objects as those in `rebounds`.
        for entries in (self.events, self.checks, *self.rebounds.values()):
            entries[:] = map(now, entries)

    def read(self, layout: Layout, entry: Entry) -> Frame:
        """Read a record of the survey with these paths, or from the folder that has it elsewhere.

        Raises
        ------
        RecordingError
            If the place has no undamaged record, or another one.
        """
        frame = read_record(self.elsewhere.get(entry.sequence, layout), entry.segment, entry.offset)
        if (frame.sequence, frame.check) != (entry.sequence, entry.check):
            raise RecordingError(f"expected record {entry.sequence}, got {frame.sequence}")
        return frame

    def _add(self, entry: Entry, data: Mapping[str, Any]) -> None:
        match entry.kind:
            case RecordKind.SURVEY:
                self.info = dict(data)
            case RecordKind.POINT:
                _types(data, name=str, order=int, declared=dict)
                _check_name(data["name"])
                self.points[data["name"]] = dict(data)
            case RecordKind.DROP:
                self._add_drop(entry, data)
            case RecordKind.REBOUND:
                _types(data, number=int)
                self.rebounds.setdefault(data["number"], []).append(entry)
            case RecordKind.EDIT:
                _types(data, what=str)
                self.edits.append(dict(data))
            case RecordKind.EVENT:
                _types(data, event=str)
                self.events.append(entry)
                if data["event"] == "recovery":
                    self.settled.update(data.get("settled") or ())
                    self.handled_damage.update(tuple(key) for key in data.get("damage") or ())
            case RecordKind.CHECK:
                self.checks.append(entry)
            case RecordKind.FILE:
                _types(data, path=str, size=int, sha256=str)
                if _PUBLISHED_PATH.fullmatch(data["path"]) is None:
                    raise ValueError("path: expected a path inside the folder of the survey")
                self.files[data["path"]] = FileEntry(
                    data["path"], data["size"], data["sha256"], data.get("number"), entry
                )

    def _add_drop(self, entry: Entry, data: Mapping[str, Any]) -> None:
        _types(data, number=int, point=str, drop=int)
        _check_name(data["point"])
        if not (0 < data["number"] < NUMBER_LIMIT and 0 < data["drop"] < NUMBER_LIMIT):
            raise ValueError(f"number of a drop: expected 1 to {NUMBER_LIMIT - 1}")
        key = data.get("key")
        drop = DropEntry(
            data["number"],
            data["point"],
            data["drop"],
            key if isinstance(key, str) else None,
            entry,
            # The records of its rebounds may precede a drop that was restored from its file.
            self.rebounds.setdefault(data["number"], []),
            data.get("restored_from"),
        )
        self._largest_number = max(self._largest_number, drop.number)
        self._used.add((drop.point, drop.drop))
        self._largest_drop[drop.point] = max(self._largest_drop.get(drop.point, 0), drop.drop)
        self.drops[drop.number] = drop
        if drop.key is not None:
            self.keys[drop.key] = drop.number
        self.with_peaks(data.get("peaks")).append(drop.number)
        if drop.restored_from is not None:
            self.settled.add(int(drop.restored_from))


class _ParsedRecord(NamedTuple):
    entry: Entry
    identity: bytes
    data: dict[str, Any]


def build_index(layout: Layout, *, parse_drops: bool = True) -> Index:
    """Return the index of a survey from its ledger and the content of each record of its journal.

    The ledger is read first. So the journal contains its records, even while another program
    writes the survey. Damage is part of the index.

    Parameters
    ----------
    layout : Layout
        Paths of the survey.
    parse_drops : bool
        False: the JSON of a drop, the longest of all, is not parsed if the ledger has its numbers
        and its point. Its key is then missing; see :func:`complete_keys`.

    Raises
    ------
    RecordingError
        If a file cannot be read at all, or the survey has another format version.
    """
    ledger = read_ledger(layout.ledger)
    index = Index(ledger=ledger, has_all_keys=parse_drops)
    acknowledged = {entry.sequence: entry for entry in ledger.entries}
    chosen: dict[int, _ParsedRecord] = {}
    records = _scan(layout, index, {} if parse_drops else acknowledged)
    index.survey = _identity(ledger, records)
    for record in records:
        entry = record.entry
        if entry.kind > NUMBER_LIMIT or not 0 < entry.sequence < 10**6 * NUMBER_LIMIT:
            index.strange.append((entry, "a record with impossible numbers"))
            continue
        if record.identity != index.survey:
            index.strange.append((entry, "a record of another survey"))
            continue
        earlier = chosen.get(entry.sequence)
        line = acknowledged.get(entry.sequence)
        # A record may be written twice after a failed sync. The copy that the ledger lists counts,
        # and otherwise the later one.
        if earlier is None or line is None or not _same_place(earlier.entry, line):
            chosen[entry.sequence] = record
    for sequence in sorted(chosen):
        record = chosen[sequence]
        if record.entry.kind == RecordKind.SURVEY:
            version = record.data.get("format_version")
            if version != FORMAT_VERSION:
                raise RecordingError(
                    f"{layout.folder}: expected a survey of format version {FORMAT_VERSION}, got "
                    f"{str(version)[:20]}"
                )
        try:
            index.add(record.entry, record.data)
        except RecordingError as err:
            index.strange.append((record.entry, str(err)))
    index.lost = {
        number: entry for number, entry in acknowledged.items() if number not in index.entries
    }
    index.unacknowledged = [number for number in index.entries if number not in acknowledged]
    numbers = index.entries.keys() | index.lost.keys()
    if len(numbers) < max(numbers, default=0):
        missing = (number for number in range(1, max(numbers)) if number not in numbers)
        index.gaps = list(itertools.islice(missing, _MAX_GAPS))
    return index


def file_states(layout: Layout) -> FileStates:
    """Return sizes and times of all files with records of a survey.

    Every write changes them, so equal states mean that nothing was written.

    Raises
    ------
    OSError
        If a file does not exist or cannot be accessed.
    """
    paths = [layout.ledger, *map(layout.segment, layout.segments())]
    states = []
    for path in paths:
        status = os.lstat(path)
        states.append(
            (
                path.name,
                status.st_dev,
                status.st_ino,
                status.st_size,
                status.st_mtime_ns,
                status.st_ctime_ns,
            )
        )
    return tuple(states)


def read_index(layout: Layout) -> Index:
    """Return the index of a survey as :func:`build_index` does, in less time.

    All bytes are compared with their checksums. The JSON of drops is parsed only if the survey is
    damaged.

    Raises
    ------
    RecordingError
        If a file cannot be read at all, or the survey has another format version.
    """
    with no_collections():
        index = build_index(layout, parse_drops=False)
        damaged = index.damage or index.lost or index.gaps or index.strange or index.ledger.damaged
        return build_index(layout) if damaged else index


@contextlib.contextmanager
def no_collections() -> Iterator[None]:
    """Suspend Python's search for reference cycles within a ``with`` block, to save time.

    The search takes long for an index, which has several 100,000 tuples and no cycle.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def complete_keys(layout: Layout, index: Index) -> None:
    """Add the keys and peaks of the drops to an index, which :func:`read_index` does not read.

    A key is the text that identifies a drop on its instrument.

    Raises
    ------
    RecordingError
        If the record of a drop can no longer be read.
    """
    if index.has_all_keys:
        return
    for drop in index.drops.values():
        if drop.key is None:
            data = payload_data(index.read(layout, drop.entry).payload)
            index.with_peaks(data.get("peaks")).append(drop.number)
            key = data.get("key")
            if isinstance(key, str):
                drop.key = key
                index.keys[key] = drop.number
    index.has_all_keys = True


def damage_key(layout: Layout, segment: int, damage: Damage) -> tuple[int, int, int, int]:
    """Return the values that identify a damaged part of the journal.

    They are the number of the file, the position and the length (bytes), and the CRC-32 of the
    damaged bytes.
    """
    crc = 0
    for chunk in chunks(layout.segment(segment), damage.offset, damage.length):
        crc = zlib.crc32(chunk, crc)
    return segment, damage.offset, damage.length, crc


def _scan(layout: Layout, index: Index, lines: Mapping[int, Entry]) -> list[_ParsedRecord]:
    """Return the records of the journal; drops in these lines of the ledger are not parsed."""
    records = []
    for segment, frame in scan_journal(layout):
        if isinstance(frame, Damage):
            index.damage.append((segment, frame))
            continue
        line = lines.get(frame.sequence) if frame.kind == RecordKind.DROP else None
        about = None if line is None else line.drop
        if line is not None and about is not None and line == _entry(segment, frame, line.about):
            data: dict[str, Any] = dict(zip(("number", "point", "drop"), about, strict=True))
            records.append(_ParsedRecord(line, frame.identity, data))
            continue
        try:
            data = _indexed_data(frame.kind, frame.payload)
            entry = _entry(segment, frame, about_of(frame.kind, data))
            records.append(_ParsedRecord(entry, frame.identity, data))
        except RecordingError as err:
            index.strange.append((_entry(segment, frame, "-"), str(err)))
    return records


def _indexed_data(kind: int, payload: bytes) -> dict[str, Any]:
    keys = _INDEXED_KEYS.get(kind)  # type: ignore[call-overload]
    if keys is None:
        return {}
    data = payload_data(payload)
    return {key: data[key] for key in keys if key in data}


def about_of(kind: int, data: Mapping[str, Any]) -> str:
    """Return the description of a record for its line in the ledger (list of saved records).

    That of a drop has its numbers and its point; any other record has "-".
    """
    if kind == RecordKind.DROP:
        number, point, drop = data.get("number"), data.get("point"), data.get("drop")
        if type(number) is int and isinstance(point, str) and type(drop) is int:
            return about_drop(number, point, drop)
    return "-"


def _entry(segment: int, frame: Frame, about: str) -> Entry:
    return Entry(
        frame.sequence, frame.kind, segment, frame.offset, frame.length, frame.check, about
    )


def _identity(ledger: LedgerText, records: list[_ParsedRecord]) -> bytes | None:
    if ledger.survey is not None:
        return ledger.survey
    counts = Counter(record.identity for record in records)
    return counts.most_common(1)[0][0] if counts else None


def _same_place(a: Entry, b: Entry) -> bool:
    return (a.segment, a.offset, a.check) == (b.segment, b.offset, b.check)


def _check_name(name: str) -> None:
    if point_name(name) != name:
        raise ValueError("name of a point: expected one without control characters")


def _types(data: Mapping[str, Any], **keys: type) -> None:
    for key, expected in keys.items():
        if type(data[key]) is not expected:
            raise TypeError(f"{key}: expected {expected.__name__}, got {type(data[key]).__name__}")
