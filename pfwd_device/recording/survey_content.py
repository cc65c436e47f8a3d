"""Points and drops of a survey.

A drop reads its traces and results only on request, through the survey to which it belongs. A drop
has a survey-wide number and a number within its test point. A key is the text that identifies a
drop on its instrument.
"""

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_payload import DropFacts
from pfwd_device.recording.payload import decode_json
from pfwd_device.recording.record import DropRecord

Result = Mapping[str, Any]


class ResultFile(NamedTuple):
    """File of a stored result, as the journal lists it."""

    path: str
    size: int
    """Length, bytes."""
    sha256: str

    def read(self) -> Result:
        """Read the result.

        Raises
        ------
        RecordingError
            If the file is missing or its content differs from that of the journal.
        """
        try:
            with open(self.path, "rb") as stream:
                data = stream.read(self.size + 1)
        except OSError as err:
            data = str(err.strerror).encode()
        if len(data) != self.size or hashlib.sha256(data).hexdigest() != self.sha256:
            raise RecordingError(
                f"{self.path} is damaged: expected the stored result, got another or no content; "
                "it does not count; run pfwd recover, or compute it again"
            )
        return parse_result(data, self.path)


class DropOrigin(Protocol):
    """Interface of a survey that reads the data of its drops, given their survey-wide number."""

    def key_of(self, number: int, /) -> str | None:
        """Return the text that identifies a drop on its instrument; None without one."""

    def results_of(self, number: int, /) -> tuple[ResultFile, ...]:
        """Return the files with stored results of a drop: trials first, the valid result last."""

    def result_count_of(self, number: int, /) -> int:
        """Return the number of stored results of a drop."""

    def read_diagnosis(self, number: int, /) -> Result | None:
        """Return the latest diagnosis that was stored with a drop; None without one."""

    def file_of(self, number: int, /) -> Path | None:
        """Return the HDF5 file of a drop; None if it has not been made."""

    def read_drop(self, number: int, /) -> DropRecord:
        """Read the complete record of a drop with all its rebounds."""

    def read_traces(self, number: int, /) -> DropRecord:
        """Read the record of a drop without rebounds and without raw counts."""

    def read_facts(self, number: int, /) -> DropFacts:
        """Read the declarations of a drop with its recorded peaks, or without these its traces."""

    def read_results(self, number: int, /) -> tuple[Result, ...]:
        """Read the stored results of a drop: trials first, the valid result last."""

    def readable_results(self, number: int, /) -> Iterator[Result]:
        """Yield the undamaged stored results of a drop: the valid result first, trials last."""

    def read_last_result(self, number: int, /) -> Result | None:
        """Read the valid result of a drop; None without a stored result."""


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
    _origin: DropOrigin = field(repr=False)

    @property
    def key(self) -> str | None:
        """Text that identifies the drop on its instrument; None without one."""
        return self._origin.key_of(self.number)

    @property
    def results(self) -> tuple[Path, ...]:
        """Files with stored results: trials first, the valid result last."""
        return tuple(Path(file.path) for file in self.result_files)

    @property
    def result_files(self) -> tuple[ResultFile, ...]:
        """Files of `results` with their sizes and checksums."""
        return self._origin.results_of(self.number)

    @property
    def result_count(self) -> int:
        """Number of stored results, without reading them."""
        return self._origin.result_count_of(self.number)

    @property
    def file(self) -> Path | None:
        """HDF5 file of the drop; None if it has not been made."""
        return self._origin.file_of(self.number)

    def read(self) -> DropRecord:
        """Read the complete record of the drop with all its rebounds.

        Raises
        ------
        RecordingError
            If there is no undamaged record of it.
        """
        return self._origin.read_drop(self.number)

    def read_traces(self) -> DropRecord:
        """Read the record without rebounds and without raw counts; errors as in :meth:`read`."""
        return self._origin.read_traces(self.number)

    def read_facts(self) -> DropFacts:
        """Read declarations and recorded peaks, or the traces where no peaks are recorded.

        It is the fastest access to the values of a row in a table; errors as in :meth:`read`.
        """
        return self._origin.read_facts(self.number)

    def read_results(self) -> tuple[Result, ...]:
        """Read the stored results: trials first, the valid result last.

        Raises
        ------
        RecordingError
            If the file of a result is damaged.
        """
        return self._origin.read_results(self.number)

    def readable_results(self) -> Iterator[Result]:
        """Yield the undamaged stored results: the valid result first, trials last."""
        return self._origin.readable_results(self.number)

    def read_last_result(self) -> Result | None:
        """Read the valid result of the drop; None without a stored result.

        The errors are those of `read_results`.
        """
        return self._origin.read_last_result(self.number)

    def read_diagnosis(self) -> Result | None:
        """Read the latest diagnosis of the point that was stored with this drop; None without one.

        A diagnosis is stored with the drop that was the last one of its point at that time.

        Raises
        ------
        RecordingError
            If the file of the diagnosis is damaged.
        """
        return self._origin.read_diagnosis(self.number)


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


def parse_result(data: bytes | str, where: str) -> Result:
    """Return a stored result of an analysis from its JSON text.

    Parameters
    ----------
    data : bytes or str
        JSON text.
    where : str
        Name of the file, for messages.

    Raises
    ------
    RecordingError
        If the text is not a JSON object.
    """
    try:
        result = decode_json(data)
    except RecordingError as err:
        raise RecordingError(f"{where}: stored result: {err}; try pfwd recover") from err
    if not isinstance(result, dict):
        raise RecordingError(f"{where}: expected a result, got {type(result).__name__}")
    return result
