"""What a report shows, gathered and judged, before anything is drawn or written."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from inversion.result import TimeHistories
from pfwd_survey.files.header import PointSetup
from pfwd_survey.inverting.diagnosis.result import DiagnosisResult
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.peaks.basin import Basin
from pfwd_survey.peaks.stiffness import Stiffness
from pfwd_survey.procedures import PointDrop, PointProgress, Procedure


@dataclass(frozen=True, eq=False, slots=True)
class ReportDrop:
    """One drop of a point."""

    number: int
    """Within the point."""
    record: int
    """Within the survey."""
    facts: PointDrop
    """As the procedure sees it."""
    result: DropResult | None
    """None for a rejected or discarded drop."""
    stored: bool
    """Whether the result was kept with the survey; otherwise it was found for this report."""
    curves: TimeHistories | None
    """Measured and fitted."""
    warnings: tuple[str, ...]
    time_local: str
    """ISO 8601 with the offset of the zone; empty: not recorded."""
    marks: tuple[str, ...]
    """What is odd about the record."""
    notes: tuple[str, ...]
    checksum: str
    """SHA-256 of the drop's file; empty: it has none."""
    left_out: tuple[float, ...] = ()
    """Distances of sensors that take no part in the fit, m: dead, or not to be believed."""
    basin: Basin | None = None
    """Of a drop without traces."""
    stiffness: Stiffness | None = None
    """Of a drop on a rig."""


@dataclass(frozen=True, eq=False, slots=True)
class ReportPoint:
    """One test point."""

    name: str
    """As it was named last."""
    setup: PointSetup
    drops: tuple[ReportDrop, ...]
    progress: PointProgress
    position: Mapping[str, Any] | None
    """latitude, longitude in degrees, and how it is known; None: not known."""
    notes: tuple[str, ...]
    discarded: bool
    diagnosis: DiagnosisResult | None
    """None: not asked for, or none."""
    warnings: tuple[str, ...]
    """Of the point as a whole."""


@dataclass(frozen=True, eq=False, slots=True)
class Report:
    """A survey as it is reported."""

    title: str
    survey: str
    """Path."""
    survey_id: str
    made: str
    """Local time, ISO 8601."""
    software: Mapping[str, str]
    """Versions by package."""
    procedure: Procedure
    chosen: bool
    """Whether a procedure was chosen by anybody; otherwise the drops are averaged as they are."""
    instruments: tuple[Mapping[str, Any], ...]
    """Identities that drops were measured with."""
    check: Mapping[str, Any] | None
    """The last check of the sensors."""
    points: tuple[ReportPoint, ...]
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
