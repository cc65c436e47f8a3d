"""What a report shows, gathered and judged, before anything is drawn or written."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pfwd.judging import PointView
from pfwd.procedures import Procedure


@dataclass(frozen=True, eq=False, slots=True)
class Report:
    """A survey as it is reported."""

    title: str
    survey: str
    """Path."""
    survey_id: str
    made: str
    """Local time, ISO 8601."""
    zone: str
    """Name of the time zone of `made`."""
    software: Mapping[str, str]
    """Versions by package."""
    procedure: Procedure
    chosen: bool
    """Whether a procedure was chosen by anybody; otherwise the drops are averaged as they are."""
    instruments: tuple[Mapping[str, Any], ...]
    """Identities that drops were measured with."""
    check: Mapping[str, Any] | None
    """The last check of the sensors."""
    points: tuple[PointView, ...]
    """With the curves of their drops; a point whose plate was changed is here more than once."""
    checksums: Mapping[int, str]
    """SHA-256 of the drop files by number of the drop within the survey."""
    damage: tuple[str, ...]
    """What is lost of the survey."""
    settings: Mapping[str, Any]
    """Of the inversion, for what was found for this report."""
    command: str
    """That makes this report again."""
    own_procedure: str | None = None
    """Name of the survey's, where the report was asked to judge by another."""
    otherwise: tuple[str, ...] = ()
    """Where it was asked for another judgement than the survey's own, a sentence each."""
