"""What the records of a survey add up to: points, drops, files, and what is missing."""

import contextlib
import gc
import os
import re
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pfwd_device.errors import RecordingError
from pfwd_device.recording.agreement import (
    InconsistentRecords,
    VerifiedRecord,
    ledger_columns,
    verified_records,
)
from pfwd_device.recording.common_records import parse_common_file, parse_common_rebound
from pfwd_device.recording.framing import Kind
from pfwd_device.recording.journal import Located, Stretch, read_record, scan_journal
from pfwd_device.recording.layout import FORMAT_VERSION, PEAKS_FORMAT_VERSION, Layout
from pfwd_device.recording.ledger import (
    Entry,
    LedgerText,
    about_drop,
    ledger_data,
    read_about,
    read_ledger,
)
from pfwd_device.recording.payload import Payload, payload_data
from pfwd_device.recording.record import point_name

EDITS = ("note", "target", "discard", "restore", "position", "name", "operator", "declared")
"""What can be said of a point or drop later; nothing that was recorded changes."""

LARGEST_NUMBER = 10**9
"""No survey has as many drops, records of as many kinds, or a millionth of as many records."""

_DROP, _REBOUND, _FILES, _CLOSE = map(int, (Kind.DROP, Kind.REBOUND, Kind.FILE, Kind.CLOSE))
"""Numbers alone: a survey has many records, and a member of an enumeration takes longer."""

_FILE = re.compile(r"(drops|results|captures)/\w[\w.-]*", re.ASCII)

_NEEDED = {
    Kind.SURVEY: ("created_utc", "software", "format_version"),
    Kind.POINT: ("name", "order", "declared"),
    Kind.DROP: ("number", "point", "drop", "key", "restored_from"),
    Kind.REBOUND: ("number",),
    Kind.EDIT: ("what", "value", "point", "number", "time_utc"),
    Kind.EVENT: ("event", "damage", "settled"),
    Kind.FILE: ("path", "size", "sha256", "number"),
}


@dataclass(slots=True)
class DropEntry:
    """A drop of the journal."""

    number: int
    """Survey-wide."""
    point: str
    drop: int
    """Within the point."""
    key: str | None
    entry: Entry
    rebounds: list[Entry]
    restored_from: int | None
    """Sequence number of the record that was damaged."""


@dataclass(slots=True)
class FileEntry:
    """A published file."""

    path: str
    size: int
    sha256: str
    number: int | None
    """Survey-wide number of the drop."""
    entry: Entry


FileStates = tuple[tuple[str, int, int, int, int, int], ...]
"""Of every file name, device, number, size (bytes), and times of the last changes (ns)."""


class _Numbers:
    """Which numbers are taken, without a look at every drop for each new one."""

    def __init__(self) -> None:
        self.largest = 0
        """Survey-wide."""
        self._of_point: dict[str, Counter[int]] = {}
        """How many drops have a number; in a journal of another program it may be several."""
        self._largest: dict[str, int] = {}
        """Within the point; found anew where it is missing."""

    def is_taken(self, point: str, drop: int) -> bool:
        """Whether a drop of the point has this number."""
        return point in self._of_point and self._of_point[point][drop] > 0

    def largest_of(self, point: str) -> int:
        """The largest number of the point's drops."""
        if point not in self._largest:
            self._largest[point] = max(self._of_point.get(point, ()), default=0)
        return self._largest[point]

    def add(self, drop: DropEntry, replaced: DropEntry | None) -> None:
        """Take a drop in, which may have been recorded under this number before."""
        self.largest = max(self.largest, drop.number)
        if replaced is not None:
            if (replaced.point, replaced.drop) == (drop.point, drop.drop):
                return
            numbers = self._of_point[replaced.point]
            numbers[replaced.drop] -= 1
            if not numbers[replaced.drop]:
                del numbers[replaced.drop]
            self._largest.pop(replaced.point, None)
        self._of_point.setdefault(drop.point, Counter())[drop.drop] += 1
        if drop.point in self._largest:
            self._largest[drop.point] = max(self._largest[drop.point], drop.drop)


@dataclass(slots=True)
class Index:
    """All that is known of a survey without its arrays."""

    survey: bytes | None = None
    info: dict[str, Any] = field(default_factory=dict)
    points: dict[str, dict[str, Any]] = field(default_factory=dict)
    drops: dict[int, DropEntry] = field(default_factory=dict)
    keys: dict[str, int] = field(default_factory=dict)
    """Survey-wide number of a drop by what identifies it on the instrument."""
    keys_known: bool = True
    """Whether `keys` holds those of all drops; see :func:`complete_keys`."""
    rebounds: dict[int, list[Entry]] = field(default_factory=dict)
    files: dict[str, FileEntry] = field(default_factory=dict)
    edits: list[dict[str, Any]] = field(default_factory=list)
    events: list[Entry] = field(default_factory=list)
    checks: list[Entry] = field(default_factory=list)
    entries: dict[int, Entry] = field(default_factory=dict)
    """Whole records by sequence number."""
    lost: dict[int, Entry] = field(default_factory=dict)
    """Acknowledged records that the journal does not hold any more."""
    gaps: list[int] = field(default_factory=list)
    """Sequence numbers that neither the journal nor the ledger knows."""
    unacknowledged: list[int] = field(default_factory=list)
    """Whole records without a line in the ledger."""
    damage: list[Stretch] = field(default_factory=list)
    strange: list[tuple[Entry, str]] = field(default_factory=list)
    """Records that are whole but no part of this survey, and why."""
    settled: set[int] = field(default_factory=set)
    """Lost records that recovery replaced in full."""
    known_damage: set[tuple[int, int, int, int]] = field(default_factory=set)
    """Segment, offset, length and CRC-32 of stretches that recovery has dealt with."""
    ledger: LedgerText = field(default_factory=lambda: LedgerText(None, (), ()))
    closed: bool = False
    """The last record says that the survey was closed."""
    _numbers: _Numbers = field(default_factory=_Numbers)

    @property
    def lost_drops(self) -> dict[int, tuple[str, int]]:
        """Point and number of acknowledged drops whose record is lost, by survey-wide number."""
        found = {}
        for entry in self.lost.values():
            about = read_about(entry.about) if entry.kind == Kind.DROP else None
            if about is not None and about[0] not in self.drops:
                found[about[0]] = about[1:]
        return found

    def next_drop(self, point: str) -> int:
        """The number that the next drop of the point gets."""
        lost = [drop for name, drop in self.lost_drops.values() if name == point]
        return max([self._numbers.largest_of(point), *lost]) + 1

    def is_taken(self, point: str, drop: int) -> bool:
        """Whether the journal holds a drop with this number within the point."""
        return self._numbers.is_taken(point, drop)

    def next_number(self) -> int:
        """The survey-wide number that the next drop gets."""
        return max([self._numbers.largest, *self.lost_drops]) + 1

    def add(self, entry: Entry, data: Mapping[str, Any]) -> None:
        """Take a record in; RecordingError when its data are not those of its kind."""
        try:
            self._add(entry, data)
        except (KeyError, TypeError, ValueError, AttributeError) as err:
            raise RecordingError(f"record {entry.sequence}: unexpected data, {err!r}") from err
        self._added(entry)

    def add_file(self, entry: Entry, facts: tuple[str, int, str, int | None]) -> None:
        """As :meth:`add`, for the record of a file that is written as usual."""
        self.files[facts[0]] = FileEntry(*facts, entry)
        self._added(entry)

    def add_rebound(self, entry: Entry, number: int) -> None:
        """As :meth:`add`, for the record of a rebound of the drop with this number."""
        self.rebounds.setdefault(number, []).append(entry)
        self._added(entry)

    def _added(self, entry: Entry) -> None:
        self.entries[entry.sequence] = entry
        self.closed = entry.kind == _CLOSE

    def relocate(self, moved: Mapping[int, Entry]) -> None:
        """Take in the new places of records, by sequence number."""

        def now(entry: Entry) -> Entry:
            return moved.get(entry.sequence, entry)

        self.entries = {number: now(entry) for number, entry in self.entries.items()}
        for drop in self.drops.values():
            drop.entry = now(drop.entry)
        for listed in self.files.values():
            listed.entry = now(listed.entry)
        # A drop's own list of rebounds is one of these.
        for entries in (self.events, self.checks, *self.rebounds.values()):
            entries[:] = map(now, entries)

    def _add(self, entry: Entry, data: Mapping[str, Any]) -> None:
        match entry.kind:
            case Kind.SURVEY:
                self.info = dict(data)
            case Kind.POINT:
                _types(data, name=str, order=int, declared=dict)
                _check_name(data["name"])
                self.points[data["name"]] = dict(data)
            case Kind.DROP:
                self._add_drop(entry, data)
            case Kind.REBOUND:
                _types(data, number=int)
                self.rebounds.setdefault(data["number"], []).append(entry)
            case Kind.EDIT:
                _types(data, what=str)
                self.edits.append(dict(data))
            case Kind.EVENT:
                _types(data, event=str)
                self.events.append(entry)
                if data["event"] == "recovery":
                    self.settled.update(data.get("settled") or ())
                    self.known_damage.update(tuple(known) for known in data.get("damage") or ())
            case Kind.CHECK:
                self.checks.append(entry)
            case Kind.FILE:
                _types(data, path=str, size=int, sha256=str)
                if _FILE.fullmatch(data["path"]) is None:
                    raise ValueError("a path that leads out of the survey")
                self.files[data["path"]] = FileEntry(
                    data["path"], data["size"], data["sha256"], data.get("number"), entry
                )

    def _add_drop(self, entry: Entry, data: Mapping[str, Any]) -> None:
        _types(data, number=int, point=str, drop=int)
        _check_name(data["point"])
        if not (0 < data["number"] < LARGEST_NUMBER and 0 < data["drop"] < LARGEST_NUMBER):
            raise ValueError("a number that no drop has")
        key = data.get("key")
        drop = DropEntry(
            data["number"],
            data["point"],
            data["drop"],
            key if isinstance(key, str) else None,
            entry,
            # A drop restored from its file comes after its rebounds.
            self.rebounds.setdefault(data["number"], []),
            data.get("restored_from"),
        )
        self._numbers.add(drop, self.drops.get(drop.number))
        self.drops[drop.number] = drop
        if drop.key is not None:
            self.keys[drop.key] = drop.number
        if drop.restored_from is not None:
            self.settled.add(int(drop.restored_from))


class _Found(NamedTuple):
    entry: Entry
    identity: bytes
    data: dict[str, Any]


def build_index(layout: Layout) -> Index:
    """Read ledger and journal.

    The ledger first: what it names was in the journal before, also while another program writes.

    Raises
    ------
    RecordingError
        If a file cannot be read at all; damage is in the index.
    """
    ledger = read_ledger(layout.ledger)
    index = Index(ledger=ledger)
    acknowledged = {entry.sequence: entry for entry in ledger.entries}
    chosen: dict[int, _Found] = {}
    found = _scan(layout, index)
    index.survey = _identity(ledger, found)
    for record in found:
        entry = record.entry
        if entry.kind > LARGEST_NUMBER or not 0 < entry.sequence < 10**6 * LARGEST_NUMBER:
            index.strange.append((entry, "a record with numbers that no survey has"))
            continue
        if record.identity != index.survey:
            index.strange.append((entry, "a record of another survey"))
            continue
        earlier = chosen.get(entry.sequence)
        line = acknowledged.get(entry.sequence)
        # Written again after a failed sync: the ledger tells which copy counts, else the later.
        if earlier is None or line is None or not _same_place(earlier.entry, line):
            chosen[entry.sequence] = record
    for sequence in sorted(chosen):
        record = chosen[sequence]
        if record.entry.kind == Kind.SURVEY:
            _check_version(layout, record.data)
        try:
            index.add(record.entry, record.data)
        except RecordingError as err:
            index.strange.append((record.entry, str(err)))
    index.lost = {
        number: entry for number, entry in acknowledged.items() if number not in index.entries
    }
    index.unacknowledged = [number for number in index.entries if number not in acknowledged]
    known = index.entries.keys() | index.lost.keys()
    if len(known) < max(known, default=0):
        index.gaps = missing_numbers(known)
    return index


def file_states(layout: Layout) -> FileStates:
    """What changes in ledger and journal when somebody writes to them; raises OSError."""
    paths = [layout.ledger, *map(layout.segment, layout.segments())]
    found = []
    for path in paths:
        said = os.lstat(path)
        found.append(
            (path.name, said.st_dev, said.st_ino, said.st_size, said.st_mtime_ns, said.st_ctime_ns)
        )
    return tuple(found)


def read_index(layout: Layout) -> Index:
    """As :func:`build_index`, for reading: every byte is compared with its checksum all the same.

    Where ledger and journal agree about every record, the ledger's lines say of drops what their
    records say: number, point and number within it, under a checksum of their own that covers the
    record's. The JSON of a drop is the longest of all and is not taken apart for that; its key is
    left out here. Anything else than agreement, and :func:`build_index` looks at everything.

    Raises
    ------
    RecordingError
        As :func:`build_index`.
    """
    try:
        with no_collections():
            found = _agreed_index(layout)
    except RecordingError:
        found = None  # whatever it is, it is found again
    return build_index(layout) if found is None else found


@contextlib.contextmanager
def no_collections() -> Iterator[None]:
    """Python does not look for cycles meanwhile.

    An index has several 100,000 tuples and none, as have the rows of a table.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def complete_keys(layout: Layout, index: Index) -> None:
    """Take in what :func:`read_index` left out: the keys of the drops.

    Raises
    ------
    RecordingError
        If the record of a drop cannot be read any more.
    """
    if index.keys_known:
        return
    for drop in index.drops.values():
        if drop.key is None:
            frame = read_record(layout, drop.entry.segment, drop.entry.offset)
            key = payload_data(frame.payload).get("key")
            if isinstance(key, str):
                drop.key = key
                index.keys[key] = drop.number
    index.keys_known = True


def _agreed_index(layout: Layout) -> Index | None:
    """What ledger and journal say when they agree; None or RecordingError when they do not."""
    try:
        data = ledger_data(layout.ledger) or b""
        columns = ledger_columns(data)
        ledger = LedgerText(columns.survey, columns.entries, (), data=data)
        index = Index(ledger=ledger, survey=columns.survey, keys_known=False)
        for record in verified_records(layout, columns):
            if isinstance(record, VerifiedRecord):
                _take_agreed(layout, index, *record)
            else:
                _take_next(layout, index, record)
    except (InconsistentRecords, OSError):
        return None
    return index


def _take_agreed(layout: Layout, index: Index, entry: Entry, payload: memoryview) -> None:
    """Take in a record that ledger and journal name alike."""
    kind = entry.kind
    if kind == _DROP:
        about = read_about(entry.about)
        if about is None:
            raise InconsistentRecords
        index.add(entry, {"number": about[0], "point": about[1], "drop": about[2]})
        return
    if entry.about != "-":
        raise InconsistentRecords
    if kind == _FILES and (facts := parse_common_file(payload)) is not None:
        index.add_file(entry, facts)
    elif kind == _REBOUND and (number := parse_common_rebound(payload)) is not None:
        index.add_rebound(entry, number)
    else:
        data = _wanted(kind, payload)
        if kind == Kind.SURVEY:
            _check_version(layout, data)
        index.add(entry, data)


def _take_next(layout: Layout, index: Index, item: Located) -> None:
    """Take in a record that the ledger does not name yet: another program is writing."""
    frame = item.frame
    if frame.sequence != len(index.entries) + 1 or frame.identity != index.survey:
        raise InconsistentRecords
    data = _wanted(frame.kind, frame.payload)
    if frame.kind == Kind.SURVEY:
        _check_version(layout, data)
    index.unacknowledged.append(frame.sequence)
    index.add(_entry(item, about_of(frame.kind, data)), data)


def _check_version(layout: Layout, data: Mapping[str, Any]) -> None:
    version = data.get("format_version")
    if version not in (FORMAT_VERSION, PEAKS_FORMAT_VERSION):
        raise RecordingError(
            f"{layout.folder}: expected a survey of format version {FORMAT_VERSION} or "
            f"{PEAKS_FORMAT_VERSION}, got {str(version)[:20]}; a newer version of this program "
            "reads it"
        )


def missing_numbers(known: set[int] | Any, most: int = 1000) -> list[int]:
    """The first numbers from 1 that are missing below the largest one."""
    gaps: list[int] = []
    expected = 1
    for number in sorted(known):
        gaps.extend(range(expected, min(number, expected + most - len(gaps))))
        if len(gaps) >= most:
            break
        expected = number + 1
    return gaps


def damage_key(layout: Layout, stretch: Stretch) -> tuple[int, int, int, int]:
    """Segment, offset, length and CRC-32 of a damaged stretch."""
    crc = 0
    with layout.segment(stretch.segment).open("rb") as stream:
        stream.seek(stretch.damage.offset)
        rest = stretch.damage.length
        while rest and (chunk := stream.read(min(rest, 2**20))):
            crc = zlib.crc32(chunk, crc)
            rest -= len(chunk)
    return (stretch.segment, stretch.damage.offset, stretch.damage.length, crc)


def _scan(layout: Layout, index: Index) -> list[_Found]:
    found = []
    for item in scan_journal(layout):
        if isinstance(item, Stretch):
            index.damage.append(item)
            continue
        try:
            found.append(_reduced(item))
        except RecordingError as err:
            index.strange.append((_entry(item, "-"), str(err)))
    return found


def _reduced(item: Located) -> _Found:
    """What the index needs of a record, without metadata and arrays."""
    frame = item.frame
    data = _wanted(frame.kind, frame.payload)
    return _Found(_entry(item, about_of(frame.kind, data)), frame.identity, data)


def _wanted(kind: int, payload: Payload) -> dict[str, Any]:
    wanted = _NEEDED.get(kind)  # type: ignore[call-overload]
    if wanted is None:
        return {}
    data = payload_data(payload)
    return {key: data[key] for key in wanted if key in data}


def about_of(kind: int, data: Mapping[str, Any]) -> str:
    """What the ledger says of a record beside its place."""
    if kind == Kind.DROP:
        number, point, drop = data.get("number"), data.get("point"), data.get("drop")
        if type(number) is int and isinstance(point, str) and type(drop) is int:
            return about_drop(number, point, drop)
    return "-"


def _entry(item: Located, about: str) -> Entry:
    frame = item.frame
    return Entry(
        frame.sequence, frame.kind, item.segment, frame.offset, frame.length, frame.check, about
    )


def _identity(ledger: LedgerText, found: list[_Found]) -> bytes | None:
    if ledger.survey is not None:
        return ledger.survey
    counts = Counter(record.identity for record in found)
    return counts.most_common(1)[0][0] if counts else None


def _same_place(one: Entry, other: Entry) -> bool:
    return (one.segment, one.offset, one.check) == (other.segment, other.offset, other.check)


def _check_name(name: str) -> None:
    if point_name(name) != name:
        raise ValueError("a name that no point has")


def _types(data: Mapping[str, Any], **wanted: type) -> None:
    for key, expected in wanted.items():
        if type(data[key]) is not expected:
            raise TypeError(f"{key} is no {expected.__name__}")
