"""Location of a drop in the journal of a survey, for use in another process."""

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
    """Location of a drop in the journal, small enough to send to another process."""

    layout: Layout
    entry: Entry
    number: int
    """Number of the drop within the survey."""
    point: str
    drop: int
    """Number of the drop within the point."""

    def read_facts(self) -> DropFacts:
        """Read the facts from the journal; see :meth:`SurveyDrop.read_facts`.

        Raises
        ------
        RecordingError
            If the journal does not hold the complete drop at this location.
        """
        frame = drop_frame(self.layout, self.entry, self.number)
        data, peaks_or_arrays = decode_payload_unless(frame.payload, recorded_peaks, is_trace)
        expected = (self.number, self.point, self.drop)
        if not isinstance(peaks_or_arrays, Peaks):
            return facts_of(self._record(data, peaks_or_arrays))
        require_drop(expected, data.get("number"), data.get("point"), data.get("drop"))
        declared, metadata = data.get("declared"), data.get("metadata")
        if not isinstance(declared, dict) or not isinstance(metadata, dict):
            raise RecordingError(f"expected declarations of drop {self.number}, got other data")
        return DropFacts(declared, metadata, peaks_or_arrays, None)

    def read_traces(self) -> DropRecord:
        """Read the traces from the journal; errors as in `read_facts`."""
        frame = drop_frame(self.layout, self.entry, self.number)
        return self._record(*decode_payload(frame.payload, is_trace))

    def _record(self, data: dict[str, Any], arrays: Mapping[str, Array]) -> DropRecord:
        record = drop_from_parts({**data, "rebounds": []}, arrays)
        expected = (self.number, self.point, self.drop)
        require_drop(expected, data.get("number"), record.point, record.drop.number)
        return record


def drop_frame(layout: Layout, entry: Entry, number: int) -> Frame:
    """Return the record of the drop of this survey-wide number, or raise RecordingError."""
    frame = read_record(layout, entry.segment, entry.offset)
    if (frame.kind, frame.sequence) != (Kind.DROP, entry.sequence):
        raise RecordingError(f"expected drop {number}, got another record")
    return frame


def require_drop(expected: tuple[int, str, int], *actual: object) -> None:
    """Raise RecordingError unless number, point and number within the point are as expected."""
    if actual != expected:
        raise RecordingError(f"expected drop {expected[0]}, got another one")
