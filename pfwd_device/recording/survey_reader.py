"""Reading of a survey without a lock, even while another program writes it.

The journal of a survey contains all records; each drop also has an HDF5 file.
"""

import contextlib
import hashlib
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_payload import (
    DropFacts,
    drop_from_parts,
    facts_of,
    is_trace,
    rebound_from_payload,
    recorded_peaks,
    with_rebounds,
)
from pfwd_device.recording.files import file_facts
from pfwd_device.recording.framing import Frame
from pfwd_device.recording.index import (
    DropEntry,
    FileEntry,
    FileStates,
    Index,
    file_states,
    no_collections,
    read_index,
)
from pfwd_device.recording.layout import Layout, find_survey
from pfwd_device.recording.ledger import Entry
from pfwd_device.recording.payload import (
    Array,
    decode_json,
    decode_payload,
    payload_data,
)
from pfwd_device.recording.record import DropRecord, ReboundRecord
from pfwd_device.recording.recovery import lost_texts
from pfwd_device.text import clean

Result = Mapping[str, Any]
_T = TypeVar("_T")

_MAX_NOTE_LENGTH = 4096


@dataclass(slots=True)
class SurveyDrop:
    """Drop of a survey with its later edits; its traces and results are read on request."""

    number: int
    """Survey-wide number, from 1."""
    point: str
    """Name of the test point."""
    drop: int
    """Number within the point, from 1."""
    discarded: bool
    """True if the user has discarded the drop."""
    notes: tuple[str, ...]
    """Notes of the user, in order."""
    position: Any
    """Position after the last edit; None: as recorded."""
    target: Any
    """Target value after the last edit; None: as recorded."""
    edits: tuple[dict[str, Any], ...]
    """All edits, in order."""
    source: str
    """Source of the record: "journal", or "file" if the journal is damaged there."""
    _survey: "Survey" = field(repr=False)

    @property
    def _entry(self) -> DropEntry | None:
        """Entry of the drop in the index; None if the journal has no record of it."""
        return self._survey._index.drops.get(self.number)

    @property
    def key(self) -> str | None:
        """Text that identifies the drop on its instrument; None without one."""
        survey, entry = self._survey, self._entry
        key: object = None if entry is None else entry.key
        if entry is not None and key is None:
            try:
                key = payload_data(survey._frame(entry).payload).get("key")
            except RecordingError:
                entry = None  # damaged since the survey was opened
        if entry is None:
            record = survey._from_file(self.number)
            key = None if record is None else record.metadata.get("key")
        return key if isinstance(key, str) else None

    @property
    def results(self) -> tuple[Path, ...]:
        """Files with stored results: trials first, the valid result last."""
        return tuple(self._survey.folder / path for path in self._result_paths())

    @property
    def result_count(self) -> int:
        """Number of stored results, without reading them."""
        return len(self._survey._results.get(self.number, ()))

    @property
    def file(self) -> Path | None:
        """HDF5 file of the drop; None if it has not been made."""
        name = self._survey._layout.drop_file_name(self.number)
        return self._survey.folder / name if name in self._survey._index.files else None

    def read(self) -> DropRecord:
        """Read the complete record of the drop with all its rebounds.

        Raises
        ------
        RecordingError
            If there is no undamaged record of it.
        """
        return self._survey.read_drop(self.number)

    def read_traces(self) -> DropRecord:
        """Read the record without rebounds and without raw counts; errors as in :meth:`read`."""
        survey, entry = self._survey, self._entry
        if entry is not None:
            with contextlib.suppress(RecordingError):  # damaged since the survey was opened
                payload = survey._frame(entry).payload
                return _traces(entry, *decode_payload(payload, is_trace))
        return replace(self.read(), counts=None, rebounds=())

    def read_facts(self) -> DropFacts:
        """Read declarations and recorded peaks, or the traces where no peaks are recorded.

        It is the fastest access to the values of a row in a table; errors as in :meth:`read`.
        """
        entry = self._entry
        if entry is not None:
            with contextlib.suppress(RecordingError):  # damaged since the survey was opened
                payload = self._survey._frame(entry).payload
                data = payload_data(payload)
                peaks = recorded_peaks(data)
                declared, metadata = data.get("declared"), data.get("metadata")
                if peaks and isinstance(declared, dict) and isinstance(metadata, dict):
                    _require_drop(entry, data.get("number"), data.get("point"), data.get("drop"))
                    return DropFacts(declared, metadata, peaks, None)
                return facts_of(_traces(entry, *decode_payload(payload, is_trace)))
        return facts_of(self.read_traces())

    def read_results(self) -> tuple[Result, ...]:
        """Read the stored results: trials first, the valid result last.

        Raises
        ------
        RecordingError
            If the file of a result is damaged.
        """
        return tuple(self._survey._read_result(path, dict) for path in self._result_paths())

    def readable_results(self, decode: Callable[[Result], _T]) -> Iterator[_T]:
        """Yield the undamaged stored results: the valid result first, trials last.

        Parameters
        ----------
        decode : callable
            Returns a result from its JSON; it raises ValueError for a damaged one.
        """
        for path in reversed(self._result_paths()):
            with contextlib.suppress(RecordingError):  # see `damage_of_results`
                yield self._survey._read_result(path, decode)

    @property
    def damage_of_results(self) -> str | None:
        """Description of the last damaged result that was read; None: there is none."""
        damaged = self._survey.damaged_results
        paths = reversed(self._result_paths())
        return next((damaged[path] for path in paths if path in damaged), None)

    def read_diagnosis(self, decode: Callable[[Result], _T]) -> _T | None:
        """Read the latest diagnosis of the point that was stored with this drop; None without one.

        A diagnosis is stored with the drop that was the last one of its point at that time.

        Parameters
        ----------
        decode : callable
            Returns a diagnosis from its JSON; it raises ValueError for a damaged one.

        Raises
        ------
        RecordingError
            If the file of the diagnosis is damaged.
        """
        paths = self._survey._diagnoses.get(self.number)
        return self._survey._read_result(max(paths, key=_last), decode) if paths else None

    def _result_paths(self) -> list[str]:
        return sorted(self._survey._results.get(self.number, ()), key=_last)


@dataclass(slots=True)
class SurveyPoint:
    """Test point of a survey with its drops and later edits."""

    name: str
    """Name in the records of its drops."""
    title: str
    """Name after the last edit."""
    order: int
    """Position in the order of the points, from 1."""
    declared: dict[str, Any]
    """Declared values, including edits."""
    discarded: bool
    """True if the user has discarded the point."""
    notes: tuple[str, ...]
    """Notes of the user, in order."""
    position: Any
    """Position after the last edit; None without one."""
    target: Any
    """Target value after the last edit; None without one."""
    edits: tuple[dict[str, Any], ...]
    """All edits, in order."""
    drops: tuple[SurveyDrop, ...]
    """Drops in the order of recording, including discarded ones."""


class Survey:
    """Content of the folder of a survey, as :func:`read_survey` returns it.

    Parameters
    ----------
    layout : Layout
        Paths of the survey.
    index : Index
        Content of its journal.
    states : FileStates, optional
        Sizes and times of its files before they were read.
    """

    def __init__(self, layout: Layout, index: Index, states: FileStates | None = None) -> None:
        self.folder = layout.folder
        self.path = os.fspath(layout.folder)
        """Path to name in messages: of the folder, or of the file from which it was unpacked."""
        self.info: dict[str, Any] = dict(index.info)
        """Record of the survey: ``created_utc``, ``software``, ``format_version``."""
        self.survey_id = index.survey.hex() if index.survey else ""
        """Identity of the survey, 32 hexadecimal digits; empty if it is lost."""
        self.damaged_results: dict[str, str] = {}
        """Descriptions of damaged results that were read, by path within the survey."""
        self._layout = layout
        self._index = index
        self._states = states
        self._edits: dict[tuple[str, object], list[dict[str, Any]]] = {}
        for edit in index.edits:
            key = "number" if edit.get("number") is not None else "point"
            self._edits.setdefault((key, str(edit.get(key))), []).append(edit)
        self._results: dict[int | None, list[str]] = {}
        self._diagnoses: dict[int | None, list[str]] = {}
        for listed in index.files.values():
            if listed.path.startswith("results/diagnosis-"):
                self._diagnoses.setdefault(listed.number, []).append(listed.path)
            elif listed.path.startswith("results/"):
                self._results.setdefault(listed.number, []).append(listed.path)
        drops = self._read_drops()
        self.drops: tuple[SurveyDrop, ...] = tuple(drop for _, drop in sorted(drops.items()))
        """All drops in the order of their survey-wide numbers."""
        self.points: tuple[SurveyPoint, ...] = self._points(drops)
        """Test points in their order."""

    def index_if_unchanged(self) -> Index | None:
        """Return the index for a writer; None if a file was changed since the survey was read.

        The caller holds the lock of the survey. A change of any byte changes the time of its file,
        so that an unchanged time makes another reading unnecessary.
        """
        try:
            return self._index if self._states == file_states(self._layout) else None
        except OSError:
            return None

    def close(self) -> None:
        """Free the memory of drops and points; the survey cannot be used afterwards.

        Drops and survey refer to each other. Without this call their memory is only freed by
        Python's search for reference cycles, which takes long for many drops.
        """
        self.drops = self.points = ()

    @property
    def damage(self) -> tuple[str, ...]:
        """Descriptions of lost records and of damaged results that were read.

        `check` reports further damage.
        """
        return (*self._lost_records, *self.damaged_results.values())

    @property
    def events(self) -> tuple[dict[str, Any], ...]:
        """Recorded events, such as gaps and reconnections, in order."""
        return tuple(self._data(self._index.events))

    @property
    def checks(self) -> tuple[dict[str, Any], ...]:
        """Recorded checks of the zero and the span of channels, in order."""
        return tuple(self._data(self._index.checks))

    @property
    def listed_files(self) -> tuple[FileEntry, ...]:
        """Files of drops, results and captures, as the journal lists them."""
        return tuple(self._index.files.values())

    @property
    def captures(self) -> tuple[Path, ...]:
        """Files of the complete raw captures, which contain every byte of a link."""
        paths = [path for path in self._index.files if path.startswith("captures/")]
        return tuple(self.folder / path for path in sorted(paths, key=_last))

    def read_drop(self, number: int) -> DropRecord:
        """Read the complete record of a drop with all its rebounds.

        Parameters
        ----------
        number : int
            Survey-wide number of the drop.

        Raises
        ------
        RecordingError
            If neither journal nor file contains it undamaged.
        """
        entry = self._index.drops.get(number)
        later = self._index.rebounds.get(number, [])
        if entry is not None:
            try:
                return with_rebounds(self._from_journal(entry), self._rebounds(later))
            except RecordingError:
                pass  # damaged since the survey was opened
        record = self._from_file(number)
        if record is None:
            raise RecordingError(
                f"{self.folder}: expected drop {number} in the journal or in a file, got no "
                "undamaged record; try pfwd recover"
            )
        return with_rebounds(record, self._rebounds(later))

    def _read_result(self, path: str, decode: Callable[[Result], _T]) -> _T:
        try:
            try:
                return decode(self._parse_result(path))
            except ValueError as err:
                raise RecordingError(
                    f"{self.folder}/{path} is damaged: {err}; it does not count; compute it again"
                ) from err
        except RecordingError as err:
            self.damaged_results[path] = str(err).removeprefix(f"{self.folder}/")
            raise

    def _parse_result(self, path: str) -> Result:
        file, listed = f"{self.folder}/{path}", self._index.files[path]
        try:
            with open(file, "rb") as stream:
                data = stream.read(listed.size + 1)
        except OSError as err:
            data = str(err.strerror).encode()
        if len(data) != listed.size or hashlib.sha256(data).hexdigest() != listed.sha256:
            raise RecordingError(
                f"{file} is damaged: expected the stored result, got another or no content; "
                "it does not count; run pfwd recover, or compute it again"
            )
        try:
            result = decode_json(data)
        except RecordingError as err:
            raise RecordingError(f"{file}: stored result: {err}; try pfwd recover") from err
        if not isinstance(result, dict):
            raise RecordingError(f"{file}: expected a result, got {type(result).__name__}")
        return result

    def _read_drops(self) -> dict[int, SurveyDrop]:
        """Return the drops of the journal, and lost drops from their HDF5 files."""
        drops = {entry.number: self._drop(entry) for entry in self._index.drops.values()}
        restored: set[str] = set()
        for number in sorted({*self._index.lost_drops, *self._layout.drop_files()} - set(drops)):
            record = self._from_file(number)
            if record is not None:
                drops[number] = drop = self._drop_of_file(number, record)
                restored.add(f"drop {drop.point}/{drop.drop} is lost")
        self._lost_records = [text for text in lost_texts(self._index) if text not in restored]
        return drops

    def _points(self, drops_by_number: dict[int, SurveyDrop]) -> tuple[SurveyPoint, ...]:
        points = dict(self._index.points)
        for drop in drops_by_number.values():
            if drop.point not in points:
                order = len(points) + 1
                points[drop.point] = {"name": drop.point, "order": order, "declared": {}}
        drops: dict[str, list[SurveyDrop]] = {}
        for drop in self.drops:
            drops.setdefault(drop.point, []).append(drop)
        ordered = sorted(points.values(), key=lambda point: int(point["order"]))
        return tuple(self._point(point, tuple(drops.get(point["name"], ()))) for point in ordered)

    def _point(self, data: dict[str, Any], drops: tuple[SurveyDrop, ...]) -> SurveyPoint:
        edits = self._edits_of("point", data["name"])
        state = _state(edits)
        declared = dict(data["declared"])
        for edit in edits:
            if edit["what"] == "declared" and isinstance(edit.get("value"), dict):
                declared |= edit["value"]
        return SurveyPoint(
            name=data["name"],
            title=clean(str(state.get("name") or data["name"])),
            order=int(data["order"]),
            declared=declared,
            discarded=bool(state.get("discarded")),
            notes=_notes(edits),
            position=state.get("position"),
            target=state.get("target"),
            edits=edits,
            drops=drops,
        )

    def _drop(self, entry: DropEntry) -> SurveyDrop:
        return self._made(entry.number, entry.point, entry.drop, "journal")

    def _drop_of_file(self, number: int, record: DropRecord) -> SurveyDrop:
        return self._made(number, record.point, record.drop.number, "file")

    def _made(self, number: int, point: str, drop: int, source: str) -> SurveyDrop:
        edits = self._edits_of("number", number)
        state = _state(edits)
        return SurveyDrop(
            number=number,
            point=point,
            drop=drop,
            discarded=bool(state.get("discarded")),
            notes=_notes(edits),
            position=state.get("position"),
            target=state.get("target"),
            edits=edits,
            source=source,
            _survey=self,
        )

    def _edits_of(self, key: str, value: object) -> tuple[dict[str, Any], ...]:
        return tuple(self._edits.get((key, str(value)), ()))

    def _data(self, entries: list[Entry]) -> Iterator[dict[str, Any]]:
        for entry in entries:
            try:
                yield payload_data(self._index.read(self._layout, entry).payload)
            except RecordingError:
                continue

    def _from_journal(self, entry: DropEntry) -> DropRecord:
        data, arrays = decode_payload(self._frame(entry).payload)
        record = drop_from_parts(data, arrays)
        _require_drop(entry, data.get("number"), record.point, record.drop.number)
        return record

    def _frame(self, entry: DropEntry) -> Frame:
        return self._index.read(self._layout, entry.entry)

    def _rebounds(self, entries: list[Entry]) -> tuple[ReboundRecord, ...]:
        rebounds = []
        for entry in entries:
            try:
                frame = self._index.read(self._layout, entry)
                rebounds.append(rebound_from_payload(frame.payload))
            except RecordingError:
                continue
        return tuple(rebounds)

    def _from_file(self, number: int) -> DropRecord | None:
        """Return the drop in its HDF5 file; None if the file is missing or was changed."""
        path = self._layout.drop_file(number)
        listed = self._index.files.get(self._layout.drop_file_name(number))
        try:
            # HDF5 may crash on damaged bytes, so a known checksum is compared first.
            if listed and file_facts(self._layout, path)["sha256"] != listed.sha256:
                return None
            from pfwd_device.recording.drop_file import read_drop_file_parts

            record, number_in_file, survey = read_drop_file_parts(path)
        except (OSError, RecordingError):
            return None
        same = number_in_file == number and (self._index.survey in (None, survey))
        return record if same else None


def read_survey(folder: str | os.PathLike[str]) -> Survey:
    """Read the survey in a folder; the traces and results of its drops are read on request.

    Drops are read from the journal, or from their HDF5 files if the journal is damaged there.

    Raises
    ------
    RecordingError
        If the folder contains no survey, or the survey cannot be read at all.
    """
    layout = find_survey(folder)
    try:
        states = file_states(layout)  # before the reading, so that a later change is detected
    except OSError:
        states = None
    with no_collections():
        return Survey(layout, read_index(layout), states)


def _traces(entry: DropEntry, data: Mapping[str, Any], arrays: Mapping[str, Array]) -> DropRecord:
    record = drop_from_parts({**data, "rebounds": []}, arrays)
    _require_drop(entry, data.get("number"), record.point, record.drop.number)
    return record


def _require_drop(entry: DropEntry, *actual: object) -> None:
    """Raise RecordingError unless number, point and number within the point are those of a drop."""
    if actual != (entry.number, entry.point, entry.drop):
        raise RecordingError(f"expected drop {entry.number}, got another drop")


def _last(path: str) -> tuple[bool, int, str]:
    """Return the sort key of the file of a result: trials first, then in the order of storing."""
    return not path.startswith("results/trial-"), len(path), path


def _state(edits: tuple[dict[str, Any], ...]) -> dict[str, Any]:
    """Return the values after all edits: by kind, the value of the last edit of that kind."""
    state: dict[str, Any] = {}
    for edit in edits:
        kind = edit["what"]
        if kind in ("discard", "restore"):
            state["discarded"] = kind == "discard"
        else:
            state[kind] = edit.get("value")
    return state


def _notes(edits: tuple[dict[str, Any], ...]) -> tuple[str, ...]:
    texts = (str(edit.get("value")) for edit in edits if edit["what"] == "note")
    return tuple(clean(text.replace("\n", " "), limit=_MAX_NOTE_LENGTH) for text in texts)
