"""Reads a survey without locking it, also while another program writes it."""

import hashlib
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_payload import (
    DropFacts,
    drop_from_parts,
    facts_of,
    rebound_from_payload,
    with_rebounds,
)
from pfwd_device.recording.drop_place import DropPlace, drop_frame, refuse_another
from pfwd_device.recording.files import file_facts
from pfwd_device.recording.framing import Frame
from pfwd_device.recording.index import (
    DropEntry,
    FileStates,
    Index,
    file_states,
    no_collections,
    read_index,
)
from pfwd_device.recording.journal import read_record
from pfwd_device.recording.layout import Layout, refuse_special_files
from pfwd_device.recording.ledger import Entry
from pfwd_device.recording.payload import decode_payload, payload_data
from pfwd_device.recording.record import DropRecord, Rebound
from pfwd_device.recording.recovery import lost_texts
from pfwd_device.recording.survey_content import Result, SurveyDrop, SurveyPoint, read_result
from pfwd_device.text import clean

_LONGEST_NOTE = 4096


class Survey:
    """What the folder of a survey holds; made by :func:`read_survey`."""

    def __init__(self, layout: Layout, index: Index, states: FileStates | None = None) -> None:
        self.folder = layout.folder
        self.info: dict[str, Any] = dict(index.info)
        """``created_utc``, ``software``, ``format_version``."""
        self.survey_id = index.survey.hex() if index.survey else ""
        self.damage: tuple[str, ...] = ()
        """What is lost, a short text each; ``check`` tells more."""
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
        found = self._found()
        self.drops: tuple[SurveyDrop, ...] = tuple(drop for _, drop in sorted(found.items()))
        """All drops by survey-wide number."""
        self.points: tuple[SurveyPoint, ...] = self._points(found)
        """In order."""

    @property
    def path(self) -> str:
        """Its folder."""
        return os.fspath(self.folder)

    def index_if_unchanged(self) -> Index | None:
        """What was read, for who writes next; None: ledger or journal have changed since.

        To be asked while nobody else can write. What is read once more a second later would be no
        safer than this: whatever changes a byte changes the time of the change.
        """
        try:
            return self._index if self._states == file_states(self._layout) else None
        except OSError:
            return None

    def close(self) -> None:
        """Let go of the drops and points.

        They know their survey and it knows them, so that the memory of many is given back at once
        only by this, and otherwise by a long search for such circles.
        """
        self.drops = self.points = ()

    @property
    def events(self) -> tuple[dict[str, Any], ...]:
        """Gaps, reconnections and the like, in order."""
        return tuple(self._data(self._index.events))

    @property
    def checks(self) -> tuple[dict[str, Any], ...]:
        """Checks of zero and span, in order."""
        return tuple(self._data(self._index.checks))

    @property
    def captures(self) -> tuple[Path, ...]:
        """Raw captures that are closed."""
        paths = [path for path in self._index.files if path.startswith("captures/")]
        return tuple(self.folder / path for path in sorted(paths, key=_last))

    def read_traces(self, number: int) -> DropRecord:
        """As :meth:`read_drop`, without rebounds and without what the converter gave."""
        place = self.place_of(number)
        if place is not None:
            try:
                return place.read_traces()
            except RecordingError:
                pass  # damaged since the survey was opened
        return replace(self.read_drop(number), counts=None, rebounds=())

    def read_facts(self, number: int) -> DropFacts:
        """Peaks of a drop where they were recorded, else its traces, with what is known of it."""
        place = self.place_of(number)
        if place is not None:
            try:
                return place.read_facts()
            except RecordingError:
                pass  # damaged since the survey was opened
        return facts_of(self.read_traces(number))

    def place_of(self, number: int) -> DropPlace | None:
        """Where the journal has the drop with this survey-wide number; None: it has not."""
        found = self._index.drops.get(number)
        if found is None:
            return None
        return DropPlace(self._layout, found.entry, number, found.point, found.drop)

    def read_drop(self, number: int) -> DropRecord:
        """The drop with this survey-wide number, with all its rebounds.

        Raises
        ------
        RecordingError
            If neither journal nor file holds it whole.
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
                f"{self.folder}: expected drop {number} in the journal or in a file, got neither "
                "whole; try pfwd recover"
            )
        return with_rebounds(record, self._rebounds(later))

    def key_of(self, number: int) -> str | None:
        """What identifies the drop with this survey-wide number on the instrument."""
        entry = self._index.drops.get(number)
        key: object = None if entry is None else entry.key
        if entry is not None and key is None:
            try:
                key = payload_data(self._frame(entry).payload).get("key")
            except RecordingError:
                entry = None  # damaged since the survey was opened
        if entry is None:
            record = self._from_file(number)
            key = None if record is None else record.metadata.get("key")
        return key if isinstance(key, str) else None

    def results_of(self, number: int) -> tuple[Path, ...]:
        """Files with results of the drop with this survey-wide number, in order."""
        return tuple(
            self.folder / path for path in sorted(self._results.get(number, ()), key=_last)
        )

    def result_count_of(self, number: int) -> int:
        """How many results of the drop with this survey-wide number are stored."""
        return len(self._results.get(number, ()))

    def last_result_of(self, number: int) -> Path | None:
        """The last of the files with results of the drop with this survey-wide number."""
        paths = self._results.get(number)
        return self.folder / max(paths, key=_last) if paths else None

    def read_diagnosis(self, number: int) -> Result | None:
        """The last diagnosis that was kept with the drop with this survey-wide number."""
        paths = self._diagnoses.get(number)
        return read_result(self.folder / max(paths, key=_last)) if paths else None

    def read_results(self, number: int) -> tuple[Result, ...]:
        """The stored results of the drop with this survey-wide number, in order."""
        return tuple(read_result(path) for path in self.results_of(number))

    def read_last_result(self, number: int) -> Result | None:
        """The last of them; None: there is none. The others are not looked at."""
        path = self.last_result_of(number)
        return None if path is None else read_result(path)

    def file_of(self, number: int) -> Path | None:
        """The HDF5 file of the drop with this survey-wide number, when it is published."""
        name = self._layout.drop_file_name(number)
        return self.folder / name if name in self._index.files else None

    def file_bytes_of(self, number: int) -> bytes | None:
        """The drop's HDF5 file, when it is there as it was published; rebounds may have followed.

        Parameters
        ----------
        number : int
            Survey-wide number of the drop.
        """
        path = self._layout.drop_file(number)
        listed = self._index.files.get(self._layout.drop_file_name(number))
        try:
            if listed is None or path.stat().st_size != listed.size:
                return None
            data = path.read_bytes()
        except OSError:
            return None
        return data if hashlib.sha256(data).hexdigest() == listed.sha256 else None

    def _found(self) -> dict[int, SurveyDrop]:
        """Drops of the journal, then those of files that the journal has lost; sets `damage`."""
        drops = {entry.number: self._drop(entry) for entry in self._index.drops.values()}
        restored: set[str] = set()
        for number in sorted({*self._index.lost_drops, *self._layout.drop_files()} - set(drops)):
            record = self._from_file(number)
            if record is not None:
                drops[number] = drop = self._drop_of_file(number, record)
                restored.add(f"drop {drop.point}/{drop.drop} is lost")
        self.damage = tuple(text for text in lost_texts(self._index) if text not in restored)
        return drops

    def _points(self, found: dict[int, SurveyDrop]) -> tuple[SurveyPoint, ...]:
        known = dict(self._index.points)
        for drop in found.values():  # in the order of their records
            if drop.point not in known:
                order = len(known) + 1
                known[drop.point] = {"name": drop.point, "order": order, "declared": {}}
        drops: dict[str, list[SurveyDrop]] = {}
        for drop in self.drops:
            drops.setdefault(drop.point, []).append(drop)
        ordered = sorted(known.values(), key=lambda point: int(point["order"]))
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
            _origin=self,
        )

    def _edits_of(self, key: str, value: object) -> tuple[dict[str, Any], ...]:
        return tuple(self._edits.get((key, str(value)), ()))

    def _data(self, entries: list[Entry]) -> Iterator[dict[str, Any]]:
        for entry in entries:
            try:
                frame = read_record(self._layout, entry.segment, entry.offset)
                yield payload_data(frame.payload)
            except RecordingError:
                continue

    def _from_journal(self, entry: DropEntry) -> DropRecord:
        data, arrays = decode_payload(self._frame(entry).payload)
        record = drop_from_parts(data, arrays)
        expected = (entry.number, entry.point, entry.drop)
        refuse_another(expected, data.get("number"), record.point, record.drop.number)
        return record

    def _frame(self, entry: DropEntry) -> Frame:
        return drop_frame(self._layout, entry.entry, entry.number)

    def _rebounds(self, entries: list[Entry]) -> tuple[Rebound, ...]:
        found = []
        for entry in entries:
            try:
                frame = read_record(self._layout, entry.segment, entry.offset)
                found.append(rebound_from_payload(frame.payload))
            except RecordingError:
                continue
        return tuple(found)

    def _from_file(self, number: int) -> DropRecord | None:
        """The drop of a file that is as it was published, or None."""
        path = self._layout.drop_file(number)
        listed = self._index.files.get(self._layout.drop_file_name(number))
        try:
            # HDF5 may do anything with damaged bytes; the checksum goes first where there is one.
            if listed and file_facts(self._layout, path)["sha256"] != listed.sha256:
                return None
            from pfwd_device.recording.drop_file import read_drop_file_parts

            record, found, survey = read_drop_file_parts(path)
        except (OSError, RecordingError):
            return None
        same = found == number and (self._index.survey in (None, survey))
        return record if same else None


def read_survey(folder: str | os.PathLike[str]) -> Survey:
    """The survey in a folder, read-only; arrays are read when asked for.

    Drops come from the journal; where it is damaged, from the drop's file.

    Raises
    ------
    RecordingError
        If there is no survey, or it cannot be read at all.
    """
    layout = Layout(Path(folder).absolute())
    if not layout.exists():
        raise RecordingError(
            f"{layout.folder}: expected the folder of a survey, got none; is the path right?"
        )
    refuse_special_files(layout)
    try:
        states = file_states(layout)  # before: what changes while it is read has changed since
    except OSError:
        states = None
    with no_collections():
        return Survey(layout, read_index(layout), states)


def _last(path: str) -> tuple[bool, int, str]:
    """Sorts files of one folder by what they say: what counts last, then by their numbers."""
    return not path.startswith("results/trial-"), len(path), path


def _state(edits: tuple[dict[str, Any], ...]) -> dict[str, Any]:
    """What counts after all edits: the last of each kind."""
    state: dict[str, Any] = {}
    for edit in edits:
        what = edit["what"]
        if what in ("discard", "restore"):
            state["discarded"] = what == "discard"
        else:
            state[what] = edit.get("value")
    return state


def _notes(edits: tuple[dict[str, Any], ...]) -> tuple[str, ...]:
    texts = (str(edit.get("value")) for edit in edits if edit["what"] == "note")
    return tuple(clean(text.replace("\n", " "), limit=_LONGEST_NOTE) for text in texts)
