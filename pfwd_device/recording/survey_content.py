"""What a survey holds, wherever it is kept: in its folder, or whole in one exported file.

Both give the same points and drops; a drop asks the survey that it is of for what has to be read.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_payload import DropFacts
from pfwd_device.recording.drop_place import DropPlace
from pfwd_device.recording.payload import decode_json
from pfwd_device.recording.record import DropRecord

LARGEST_RESULT = 10_000_000
"""Bytes of a result; one takes some 3 kB."""

Result = Mapping[str, Any]


class DropOrigin(Protocol):
    """A survey that reads its drops by their number within it."""

    def key_of(self, number: int, /) -> str | None:
        """What identifies a drop on the instrument."""

    def results_of(self, number: int, /) -> tuple[Path, ...]:
        """Files with results of a drop, in order."""

    def result_count_of(self, number: int, /) -> int:
        """How many results of a drop are stored."""

    def last_result_of(self, number: int, /) -> Path | None:
        """The last of the files with results of a drop."""

    def read_diagnosis(self, number: int, /) -> Result | None:
        """The last diagnosis that was kept with a drop."""

    def place_of(self, number: int, /) -> DropPlace | None:
        """Where another process finds the facts of a drop; None: it cannot."""

    def file_of(self, number: int, /) -> Path | None:
        """The HDF5 file of a drop, when it is published."""

    def file_bytes_of(self, number: int, /) -> bytes | None:
        """That file, when it is there as it was published."""

    def read_drop(self, number: int, /) -> DropRecord:
        """A drop with all its rebounds."""

    def read_traces(self, number: int, /) -> DropRecord:
        """A drop without rebounds and without what the converter gave."""

    def read_facts(self, number: int, /) -> DropFacts:
        """Peaks of a drop where they are known, else its traces, with what is known of it."""

    def read_results(self, number: int, /) -> tuple[Result, ...]:
        """The stored results of a drop, what was tried first, what counts last."""

    def read_last_result(self, number: int, /) -> Result | None:
        """The last of them; None: there is none."""


@dataclass(slots=True)
class SurveyDrop:
    """A drop with what was said of it later; its arrays are read when asked for."""

    number: int
    """Survey-wide number, from 1."""
    point: str
    """Name of the test point."""
    drop: int
    """Number within the point, from 1."""
    discarded: bool
    notes: tuple[str, ...]
    position: Any
    """As it was edited last; None: as recorded."""
    target: Any
    edits: tuple[dict[str, Any], ...]
    """All edits, in order."""
    source: str
    """Where the record comes from: "journal", "file" when the journal is damaged there, or "export"
    of an exported survey."""
    _origin: DropOrigin = field(repr=False)

    @property
    def key(self) -> str | None:
        """What identifies the drop on the instrument; read when asked for."""
        return self._origin.key_of(self.number)

    @property
    def results(self) -> tuple[Path, ...]:
        """Files with results, what was tried first, what counts last.

        An exported survey has none, its results are within it.
        """
        return self._origin.results_of(self.number)

    @property
    def result_count(self) -> int:
        """How many results are stored; no path is made of them, and none is read."""
        return self._origin.result_count_of(self.number)

    @property
    def last_result(self) -> Path | None:
        """The file that `read_last_result` reads, for another process too."""
        return self._origin.last_result_of(self.number)

    @property
    def place(self) -> DropPlace | None:
        """Where another process finds its facts; None: it has to be read in this one."""
        return self._origin.place_of(self.number)

    @property
    def file(self) -> Path | None:
        """Its HDF5 file, when it is published; None of an exported survey."""
        return self._origin.file_of(self.number)

    def read(self) -> DropRecord:
        """The drop with all its rebounds.

        Raises
        ------
        RecordingError
            If it is not there whole.
        """
        return self._origin.read_drop(self.number)

    def read_traces(self) -> DropRecord:
        """As :meth:`read`, without rebounds and without what the converter gave."""
        return self._origin.read_traces(self.number)

    def read_facts(self) -> DropFacts:
        """Its peaks where they were recorded, else its traces, with what is known of it."""
        return self._origin.read_facts(self.number)

    def read_results(self) -> tuple[Result, ...]:
        """The stored results, what was tried first, what counts last.

        Raises
        ------
        RecordingError
            If one of them is damaged.
        """
        return self._origin.read_results(self.number)

    def read_last_result(self) -> Result | None:
        """The last of them, None where there is none; raises as :meth:`read_results`.

        Of a survey's folder the others are not looked at.
        """
        return self._origin.read_last_result(self.number)

    def read_diagnosis(self) -> Result | None:
        """The last diagnosis of its point, where it was the last drop then; None: there is none.

        Raises
        ------
        RecordingError
            If it is damaged.
        """
        return self._origin.read_diagnosis(self.number)

    def read_file(self) -> bytes | None:
        """Its HDF5 file, when it is there as it was published; rebounds may have followed."""
        return self._origin.file_bytes_of(self.number)


@dataclass(slots=True)
class SurveyPoint:
    """A test point."""

    name: str
    """As its drops name it."""
    title: str
    """As it was renamed last."""
    order: int
    declared: dict[str, Any]
    """What was declared, edits included."""
    discarded: bool
    notes: tuple[str, ...]
    position: Any
    target: Any
    edits: tuple[dict[str, Any], ...]
    drops: tuple[SurveyDrop, ...]
    """In the order of recording, discarded ones with them."""


class SurveyContent(Protocol):
    """A survey, for who does not need to know how it is kept."""

    @property
    def path(self) -> str:
        """Folder or file."""

    @property
    def survey_id(self) -> str:
        """32 hexadecimal digits; empty when it is not known any more."""

    @property
    def info(self) -> Mapping[str, Any]:
        """When and by what it was made."""

    @property
    def points(self) -> tuple[SurveyPoint, ...]:
        """In order."""

    @property
    def drops(self) -> tuple[SurveyDrop, ...]:
        """All drops by their number within the survey."""

    @property
    def events(self) -> tuple[Mapping[str, Any], ...]:
        """Gaps, reconnections and the like, in order."""

    @property
    def checks(self) -> tuple[Mapping[str, Any], ...]:
        """Checks of zero and span, in order."""

    @property
    def captures(self) -> tuple[Path, ...]:
        """Files with the bytes of links; an exported survey has them inside."""

    @property
    def damage(self) -> tuple[str, ...]:
        """What is lost, a short text each."""


def read_result(path: Path) -> Result:
    """A stored result in its file; raises as `parse_result`."""
    try:
        if path.stat().st_size > LARGEST_RESULT:
            raise RecordingError(f"{path}: expected a result, got a file of over 10 MB")
        return parse_result(path.read_bytes(), str(path))
    except OSError as err:
        raise RecordingError(f"{path}: expected a readable result, got {err.strerror}") from err


def parse_result(data: bytes | str, where: str) -> Result:
    """A stored result.

    Raises
    ------
    RecordingError
        If it is none.
    """
    try:
        result = decode_json(data)
    except RecordingError as err:
        hint = "try pfwd recover"
        raise RecordingError(f"{where}: of a result {err}; {hint}") from err
    if not isinstance(result, dict):
        raise RecordingError(f"{where}: expected a result, got {type(result).__name__}")
    return result
