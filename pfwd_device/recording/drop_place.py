"""Where the journal of a survey has a drop, so that another process finds it too."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from pfwd_device.errors import RecordingError
from pfwd_device.peaks import Peaks
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
    """Where the journal has a drop: what another process needs to read it, and no more."""

    layout: Layout
    entry: Entry
    number: int
    """Survey-wide."""
    point: str
    drop: int
    """Within the point."""

    def read_facts(self) -> DropFacts:
        """As :meth:`SurveyDrop.read_facts`, from the journal alone.

        Raises
        ------
        RecordingError
            If the journal does not have it whole at this place.
        """
        frame = drop_frame(self.layout, self.entry, self.number)
        data, found = decode_payload_unless(frame.payload, recorded_peaks, is_trace)
        expected = (self.number, self.point, self.drop)
        if not isinstance(found, Peaks):
            return facts_of(self._record(data, found))
        refuse_another(expected, data.get("number"), data.get("point"), data.get("drop"))
        declared, metadata = data.get("declared"), data.get("metadata")
        if not isinstance(declared, dict) or not isinstance(metadata, dict):
            raise RecordingError(f"expected what is known of drop {self.number}, came others")
        return DropFacts(declared, metadata, found, None)

    def read_traces(self) -> DropRecord:
        """As :meth:`SurveyDrop.read_traces`, from the journal alone; raises as `read_facts`."""
        frame = drop_frame(self.layout, self.entry, self.number)
        return self._record(*decode_payload(frame.payload, is_trace))

    def _record(self, data: dict[str, Any], arrays: Mapping[str, Array]) -> DropRecord:
        record = drop_from_parts({**data, "rebounds": []}, arrays)
        expected = (self.number, self.point, self.drop)
        refuse_another(expected, data.get("number"), record.point, record.drop.number)
        return record


def drop_frame(layout: Layout, entry: Entry, number: int) -> Frame:
    """The record of the drop with this survey-wide number; RecordingError when it is another's."""
    frame = read_record(layout, entry.segment, entry.offset)
    if (frame.kind, frame.sequence) != (Kind.DROP, entry.sequence):
        raise RecordingError(f"expected drop {number}, came another record")
    return frame


def refuse_another(expected: tuple[int, str, int], *found: object) -> None:
    """Refuse the record of another drop: number, point and number within it, expected and found."""
    if found != expected:
        raise RecordingError(f"expected drop {expected[0]}, came another one")
