"""What the databases of Rincent's programs say of a project, whichever of them wrote it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pfwd_survey.files.foreign.common import distinct

RATES = (1.0, 1e7)
"""Hz; what a sampling rate may be."""

PRE_TRIGGERS = (0.0, 60.0)
"""s; what a pre-trigger may be."""

MASK = (1 << 64) - 1
"""Identities are signed 64-bit numbers in one place and unsigned hexadecimal ones in another."""


@dataclass(frozen=True, slots=True)
class PointFacts:
    """A test point without its traces."""

    identity: str
    """As it is written in the database."""
    name: str
    known: Mapping[str, Any] = field(default_factory=dict)
    """Header keys."""
    noted: Mapping[str, Any] = field(default_factory=dict)
    """What else is kept."""

    @property
    def numbers(self) -> set[int]:
        """The identity as a number, hexadecimal or decimal: databases have either."""
        found = set()
        for base in (16, 10):
            try:
                found.add(int(self.identity, base) & MASK)
            except ValueError:
                continue
        return found


@dataclass(frozen=True, slots=True)
class Facts:
    """A project without its traces."""

    rate: float
    """Samples per second, Hz."""
    pre_trigger: float
    """s before the trigger."""
    known: Mapping[str, Any]
    """Header keys of all points; None: not said."""
    points: tuple[PointFacts, ...]
    offsets: tuple[float, ...] | None = None
    """Positions of the sensors, m, negative on the other side; None: one in the centre."""


def with_distinct_names(points: list[PointFacts]) -> tuple[PointFacts, ...]:
    """The points, none with the name of another."""
    names = distinct([point.name for point in points])
    return tuple(
        PointFacts(point.identity, name, point.known, point.noted)
        for point, name in zip(points, names, strict=True)
    )


def named(*parts: object) -> str:
    """A name from the parts that there are."""
    return " ".join(str(part) for part in parts if part not in (None, "")) or "point"
