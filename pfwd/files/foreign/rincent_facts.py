"""What the databases of Rincent's programs say of a project, whichever of them wrote it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from inversion.notices import Notice
from pfwd.files.foreign.common import (
    distinct,
    finite,
    moment_of,
    position_of,
    short_text,
    within,
)

RATES = (1.0, 1e7)
"""Hz; what a sampling rate may be."""

PRE_TRIGGERS = (0.0, 60.0)
"""s; what a pre-trigger may be."""

MOST_SEATING = 1000
"""Seating drops of a point; whoever writes more means something else."""

MASK = (1 << 64) - 1
"""Identities are signed 64-bit numbers in one place and unsigned hexadecimal ones in another."""


@dataclass(frozen=True, slots=True)
class StoredPeaks:
    """Peaks of a drop as the database has them."""

    load: float | None
    """N."""
    deflections: tuple[float, ...]
    """m, one a sensor in the order of the database; empty where one is no number."""
    duration: float | None = None
    """Of the load pulse, s."""


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
    peaks: tuple[StoredPeaks, ...] = ()
    """Of its drops, in their order."""
    labels: tuple[float, ...] | None = None
    """Positions of the sensors as the names of the deflections say, m; None: they say none."""

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

    where: str
    """File and member, for messages."""
    said_rate: tuple[object, str]
    """Samples per second, Hz, as it is written, and its name there."""
    said_pre_trigger: tuple[object, str]
    """s before the trigger, as it is written, and its name there."""
    known: Mapping[str, Any]
    """Header keys of all points; None: not said."""
    points: tuple[PointFacts, ...]
    offsets: tuple[float, ...] | None = None
    """Positions of the sensors, m, negative on the other side; None: one in the centre."""
    samples: int | None = None
    """Samples of a trace, as the database has it."""
    remarks: tuple[Notice, ...] = ()
    """What had to be made up for when the database was read."""

    @property
    def rate(self) -> float:
        """Samples per second, Hz; raises TraceError when the database says none.

        Asked for only where traces do not say their own: peaks need none.
        """
        hint = "give sampling_rate_hz in a file with --header"
        return within(*self.said_rate, *RATES, self.where, hint)

    @property
    def pre_trigger(self) -> float:
        """s before the trigger; raises as `rate`."""
        return within(*self.said_pre_trigger, *PRE_TRIGGERS, self.where)


def project_facts(
    where: str,
    points: Sequence[PointFacts],
    *,
    rate: tuple[object, str],
    pre_trigger: tuple[object, str],
    diameter: object,
    poisson_ratio: object,
    seating: object,
    device: str,
    site: str | None = None,
    offsets: tuple[float, ...] | None = None,
    samples: object = None,
    remarks: Sequence[Notice] = (),
) -> Facts:
    """What a database says of a project, checked.

    Parameters
    ----------
    where : str
        File and member, for messages.
    points : sequence of PointFacts
    rate, pre_trigger : (value, name), Hz and s
        As they are written, with the name that they have there.
    diameter : of the plate, m
    poisson_ratio, seating : as they are written
    device, site : str
    offsets : of the sensors, m
    samples : as it is written
    remarks : sequence of Notice
    """
    width, drops = finite(diameter), finite(seating)
    known = {
        # 0.3 in single precision is 0.30000001192092896
        "plate_radius_m": round(width / 2, 6) if width else None,
        # A rig has no plate; the program calls it Raideur, and writes 0.
        "test": "stiffness" if width == 0 else None,
        "poisson_ratio": finite(poisson_ratio),
        "seating_drops": int(drops) if drops is not None and 0 <= drops < MOST_SEATING else None,
        "device": short_text(device),
        "site": site,
    }
    count = finite(samples)
    return Facts(
        where,
        rate,
        pre_trigger,
        known,
        _with_distinct_names(points),
        offsets,
        None if count is None else int(count),
        tuple(remarks),
    )


def point_facts(
    identity: str,
    name: str,
    date: object,
    place: tuple[object, object],
    known: Mapping[str, Any],
    noted: Mapping[str, Any],
    peaks: Sequence[StoredPeaks] = (),
    labels: tuple[float, ...] | None = None,
) -> PointFacts:
    """What a database says of a point.

    Parameters
    ----------
    identity, name : str
    date : as it is written
    place : latitude and longitude, as they are written
    known, noted : what else it says
    peaks, labels : of its drops
    """
    moment = moment_of(date)
    return PointFacts(
        identity,
        name,
        {**known, "time_utc": moment.get("time_utc"), **position_of(*place)},
        {"time_local": moment.get("time_local"), **noted},
        tuple(peaks),
        labels,
    )


def _with_distinct_names(points: Sequence[PointFacts]) -> tuple[PointFacts, ...]:
    """The points, none with the name of another."""
    names = distinct([point.name for point in points])
    return tuple(replace(point, name=name) for point, name in zip(points, names, strict=True))


def named(*parts: object) -> str:
    """A name from the parts that there are."""
    return " ".join(str(part) for part in parts if part not in (None, "")) or "point"
