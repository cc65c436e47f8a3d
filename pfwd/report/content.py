"""The data of a report, before anything is drawn or written."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pfwd.judging import PointView
from pfwd.procedures import Procedure


@dataclass(frozen=True, eq=False, slots=True)
class Report:
    """Data of a report on a survey."""

    title: str
    survey: str
    """Path of the survey."""
    survey_id: str
    made: str
    """Local time of the report, ISO 8601."""
    zone: str
    """Time zone of `made` as its offset, such as UTC+02:00."""
    software: str
    """Packages that made numbers or pictures, each with its version."""
    procedure: Procedure
    chosen: bool
    """True if a procedure was chosen; otherwise all measured drops are averaged."""
    instruments: tuple[Mapping[str, Any], ...]
    """Identities of the instruments, as they reported themselves."""
    check: Mapping[str, Any] | None
    """The last check of the sensors."""
    points: tuple[PointView, ...]
    """Points with the curves of their drops; a point whose plate was changed has several parts."""
    checksums: Mapping[int, str]
    """SHA-256 of the drop files by number of the drop within the survey."""
    damage: tuple[str, ...]
    """Damage of the survey, one sentence each."""
    settings: Mapping[str, Any]
    """Settings of the inversion of drops for this report."""
    command: str
    """Command line that makes this report again."""
    survey_procedure: str | None = None
    """Name of the survey's procedure, if the report judges by another; else None."""
    otherwise: tuple[str, ...] = ()
    """Sentences that state where the report judges differently from the survey."""

    target_changes: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    """Targets that were changed after the last drop of a point, by the name of the point: time of
    the change (UTC, ISO 8601), and the target until then, Pa or m."""
    replaced_target: float | None = None
    """Target that the survey declares for the point of a slip with a target of its own, Pa or m."""

    @property
    def survey_name(self) -> str:
        """Name of the survey's folder; a path of the computer does not belong into a report."""
        return os.path.basename(os.path.abspath(self.survey))
