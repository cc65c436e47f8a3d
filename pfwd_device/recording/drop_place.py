"""Location of a drop in the journal, the files with all records of a survey.

Another process can read the drop by its location without reading the survey first.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from pfwd_device.drop import Peaks
from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_payload import (
    DropFacts,
    drop_from_parts,
    facts_of,
    is_trace,
    recorded_peaks,
)
from pfwd_device.recording.framing import Frame, Kind
from pfwd_device.recording.journal import read_record
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.ledger import Entry
from pfwd_device.recording.payload import Array, decode_payload, decode_payload_unless
from pfwd_device.recording.record import DropRecord


class DropPlace(NamedTuple):
    """Location of a drop in the journal of a survey, small enough to send to another process."""

    layout: Layout
    """Paths of the survey."""
    entry: Entry
    """Place of the record in the journal."""
    number: int
    """Number of the drop within the survey."""
    point: str
    drop: int
    """Number of the drop within the point."""

    def read_facts(self) -> DropFacts:
        """Read the declarations and the recorded peaks of the drop, or its traces without peaks.

        Raises
        ------
        RecordingError
            If the journal does not contain the complete drop at this location.
        """
        frame = drop_frame(self.layout, self.entry, self.number)
        data, peaks_or_arrays = decode_payload_unless(frame.payload, recorded_peaks, is_trace)
        expected = (self.number, self.point, self.drop)
        if not isinstance(peaks_or_arrays, Peaks):
            return facts_of(self._record(data, peaks_or_arrays))
        require_drop(expected, data.get("number"), data.get("point"), data.get("drop"))
        declared, metadata = data.get("declared"), data.get("metadata")
        if not isinstance(declared, dict) or not isinstance(metadata, dict):
            raise RecordingError(f"expected the declarations of drop {self.number}, got other data")
        return DropFacts(declared, metadata, peaks_or_arrays, None)

    def read_traces(self) -> DropRecord:
        """Read the drop without rebounds and raw counts; errors as in `read_facts`."""
        frame = drop_frame(self.layout, self.entry, self.number)
        return self._record(*decode_payload(frame.payload, is_trace))

    def _record(self, data: dict[str, Any], arrays: Mapping[str, Array]) -> DropRecord:
        record = drop_from_parts({**data, "rebounds": []}, arrays)
        expected = (self.number, self.point, self.drop)
        require_drop(expected, data.get("number"), record.point, record.drop.number)
        return record


def drop_frame(layout: Layout, entry: Entry, number: int) -> Frame:
    """Read the record of a drop from the journal.

    Parameters
    ----------
    layout : Layout
        Paths of the survey.
    entry : Entry
        Place of the record.
    number : int
        Number of the drop within the survey, for messages.

    Raises
    ------
    RecordingError
        If the record at this place is damaged, or that of something else.
    """
    frame = read_record(layout, entry.segment, entry.offset)
    if (frame.kind, frame.sequence) != (Kind.DROP, entry.sequence):
        raise RecordingError(f"expected drop {number}, got another record")
    return frame


def require_drop(expected: tuple[int, str, int], *actual: object) -> None:
    """Raise RecordingError unless a drop that was read is the expected one.

    Both are identified by the number within the survey, the point and the number within the point.
    """
    if actual != expected:
        raise RecordingError(f"expected drop {expected[0]}, got another drop")
