"""Content of a survey, independent of its storage in a folder or in one exported file.

Both have the same points and drops; a drop reads its data through its survey.
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

MAX_RESULT_BYTES = 10_000_000
"""Largest stored result; a usual one takes 3 kB."""

Result = Mapping[str, Any]


class DropOrigin(Protocol):
    """Interface of a survey that reads its drops by their survey-wide number."""

    def key_of(self, number: int, /) -> str | None:
        """Return the key of a drop, which identifies it on the instrument."""

    def results_of(self, number: int, /) -> tuple[Path, ...]:
        """Return the files with results of a drop, in order."""

    def result_count_of(self, number: int, /) -> int:
        """Return the number of stored results of a drop."""

    def last_result_of(self, number: int, /) -> Path | None:
        """Return the last of the files with results of a drop."""

    def read_diagnosis(self, number: int, /) -> Result | None:
        """Return the last diagnosis that was stored with a drop."""

    def place_of(self, number: int, /) -> DropPlace | None:
        """Return the place from which another process reads a drop; None if it cannot."""

    def file_of(self, number: int, /) -> Path | None:
        """Return the HDF5 file of a drop; None if it is not published."""

    def file_bytes_of(self, number: int, /) -> bytes | None:
        """Return the bytes of the HDF5 file of a drop; None unless it is unchanged."""

    def read_drop(self, number: int, /) -> DropRecord:
        """Read a drop with all its rebounds."""

    def read_traces(self, number: int, /) -> DropRecord:
        """Read a drop without rebounds and without raw counts."""

    def read_facts(self, number: int, /) -> DropFacts:
        """Read the recorded peaks of a drop, or else its traces, with its declarations."""

    def read_results(self, number: int, /) -> tuple[Result, ...]:
        """Read the stored results of a drop: trials first, the result that counts last."""

    def read_last_result(self, number: int, /) -> Result | None:
        """Read the last stored result; None if there is none."""


@dataclass(slots=True)
class SurveyDrop:
    """A drop with its later edits; its arrays are read on request."""

    number: int
    """Survey-wide number, from 1."""
    point: str
    """Name of the test point."""
    drop: int
    """Number within the point, from 1."""
    discarded: bool
    notes: tuple[str, ...]
    position: Any
    """Position after the last edit; None: as recorded."""
    target: Any
    edits: tuple[dict[str, Any], ...]
    """All edits, in order."""
    source: str
    """Source of the record: "journal", "file" if the journal is damaged there, or "export" for an
    exported survey."""
    _origin: DropOrigin = field(repr=False)

    @property
    def key(self) -> str | None:
        """Key that identifies the drop on the instrument; read on request."""
        return self._origin.key_of(self.number)

    @property
    def results(self) -> tuple[Path, ...]:
        """Files with results: trials first, the result that counts last.

        An exported survey has no such files, as it contains the results.
        """
        return self._origin.results_of(self.number)

    @property
    def result_count(self) -> int:
        """Number of stored results, without reading them."""
        return self._origin.result_count_of(self.number)

    @property
    def last_result(self) -> Path | None:
        """File of the last result, which another process can read as well."""
        return self._origin.last_result_of(self.number)

    @property
    def place(self) -> DropPlace | None:
        """Place from which another process reads its facts; None if only this one can."""
        return self._origin.place_of(self.number)

    @property
    def file(self) -> Path | None:
        """HDF5 file of the drop; None if it is not published, or in an exported survey."""
        return self._origin.file_of(self.number)

    def read(self) -> DropRecord:
        """Read the drop with all its rebounds.

        Raises
        ------
        RecordingError
            If there is no undamaged record of it.
        """
        return self._origin.read_drop(self.number)

    def read_traces(self) -> DropRecord:
        """Read the drop without rebounds and without raw counts; errors as in :meth:`read`."""
        return self._origin.read_traces(self.number)

    def read_facts(self) -> DropFacts:
        """Read the recorded peaks, or else the traces, with the declarations."""
        return self._origin.read_facts(self.number)

    def read_results(self) -> tuple[Result, ...]:
        """Read the stored results: trials first, the result that counts last.

        Raises
        ------
        RecordingError
            If one of them is damaged.
        """
        return self._origin.read_results(self.number)

    def read_last_result(self) -> Result | None:
        """Read the last stored result; None if there is none; errors as in `read_results`.

        In the folder of a survey the other results are not read.
        """
        return self._origin.read_last_result(self.number)

    def read_diagnosis(self) -> Result | None:
        """Read the last diagnosis stored with this drop, the last one of its point at that time.

        None if there is none.

        Raises
        ------
        RecordingError
            If it is damaged.
        """
        return self._origin.read_diagnosis(self.number)

    def read_file(self) -> bytes | None:
        """Read the bytes of its HDF5 file; None unless it is unchanged. Rebounds may be missing."""
        return self._origin.file_bytes_of(self.number)


@dataclass(slots=True)
class SurveyPoint:
    """A test point."""

    name: str
    """Name in the records of its drops."""
    title: str
    """Name after the last edit."""
    order: int
    declared: dict[str, Any]
    """Declared values, including edits."""
    discarded: bool
    notes: tuple[str, ...]
    position: Any
    target: Any
    edits: tuple[dict[str, Any], ...]
    drops: tuple[SurveyDrop, ...]
    """Drops in the order of recording, including discarded ones."""


class SurveyContent(Protocol):
    """Interface of a survey, independent of its storage."""

    @property
    def path(self) -> str:
        """Path of the folder or file."""

    @property
    def survey_id(self) -> str:
        """Identity, 32 hexadecimal digits; empty if it is lost."""

    @property
    def info(self) -> Mapping[str, Any]:
        """Time and program of its creation."""

    @property
    def points(self) -> tuple[SurveyPoint, ...]:
        """Points in order."""

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
        """Files with raw captures; an exported survey contains the captures."""

    @property
    def damage(self) -> tuple[str, ...]:
        """Losses, a short text each."""


def read_result(path: Path) -> Result:
    """Read a stored result from its file; errors as in `parse_result`."""
    try:
        if path.stat().st_size > MAX_RESULT_BYTES:
            raise RecordingError(f"{path}: expected a result, got a file of over 10 MB")
        return parse_result(path.read_bytes(), str(path))
    except OSError as err:
        raise RecordingError(f"{path}: expected a readable result, got {err.strerror}") from err


def parse_result(data: bytes | str, where: str) -> Result:
    """Parse a stored result.

    Raises
    ------
    RecordingError
        If the data are no result.
    """
    try:
        result = decode_json(data)
    except RecordingError as err:
        hint = "try pfwd recover"
        raise RecordingError(f"{where}: of a result {err}; {hint}") from err
    if not isinstance(result, dict):
        raise RecordingError(f"{where}: expected a result, got {type(result).__name__}")
    return result
