"""Irregularities of the record of a drop, as messages from its metadata."""

from collections.abc import Mapping
from typing import Any

from inversion.notices import Notice, messages_in
from pfwd_device.recording.record import COPY_OF

MARKS = "marks"
"""Key of a drop's metadata: entries with code and values, see `Notice.to_json`."""

SATURATED = "saturated"
"""Code of the mark of a drop in which a channel reached the end of the converter's range."""


def marks_in(metadata: Mapping[str, Any]) -> tuple[Notice, ...]:
    """Return the irregularities of a record, such as missing samples."""
    return messages_in(metadata.get(MARKS))


def copy_fault(metadata: Mapping[str, Any]) -> Notice | None:
    """Return the message about a drop of another point with the same samples; None: no copy."""
    copied = metadata.get(COPY_OF)
    if not isinstance(copied, Mapping):
        return None
    values = {key: str(copied.get(key)) for key in ("drop", "point")}
    return Notice("record-copied-from-point", values)
