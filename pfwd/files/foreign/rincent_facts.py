"""Content of the database of a Rincent project, independent of the database's format."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from inversion.notices import Notice
from pfwd.files.foreign.common import (
    distinct_names,
    finite,
    moment_of,
    position_of,
    short_text,
    within,
)

SAMPLING_RATES_HZ = (1.0, 1e7)
"""Range of plausible sampling rates."""

PRE_TRIGGERS_S = (0.0, 60.0)
"""Range of plausible times before the trigger."""

MAX_SEATING_DROPS = 1000
"""Limit of the seating drops of a point; a larger number has another meaning."""

IDENTITY_MASK = (1 << 64) - 1
"""Mask that makes identities equal, which are signed 64-bit numbers in some files and unsigned
hexadecimal ones in others."""


@dataclass(frozen=True, slots=True)
class StoredPeaks:
    """Peaks of a drop as stored in the database."""

    load: float | None
    """Peak load, N."""
    deflections: tuple[float, ...]
    """Peak deflections, m, in the order of the sensors in the database; empty: one of them is no
    number."""
    duration: float | None = None
    """Duration of the load pulse, s."""


@dataclass(frozen=True, slots=True)
class PointFacts:
    """Content of the database about one test point."""

    identity: str
    """Identity as written in the database."""
    name: str
    declared: Mapping[str, Any] = field(default_factory=dict)
    """Values of header keys."""
    noted: Mapping[str, Any] = field(default_factory=dict)
    """Further data to store with the point."""
    peaks: tuple[StoredPeaks, ...] = ()
    """Peaks of its drops, in the order of the drops."""
    labels: tuple[float, ...] | None = None
    """Offsets of the sensors, m, from the names of the deflections; None: the names have none."""

    @property
    def numbers(self) -> set[int]:
        """Possible values of the identity as a number: its text is hexadecimal or decimal."""
        numbers = set()
        for base in (16, 10):
            try:
                numbers.add(int(self.identity, base) & IDENTITY_MASK)
            except ValueError:
                continue
        return numbers


@dataclass(frozen=True, slots=True)
class Facts:
    """Content of the database about the project and its points."""

    where: str
    """File and member of the database, for messages."""
    recorded_rate: tuple[object, str]
    """Sampling rate, Hz, unchecked, and the name of its entry in the database."""
    recorded_pre_trigger: tuple[object, str]
    """Time before the trigger, s, unchecked, and the name of its entry in the database."""
    declared: Mapping[str, Any]
    """Values of header keys for all points; None: not in the database."""
    points: tuple[PointFacts, ...]
    offsets: tuple[float, ...] | None = None
    """Offsets of the sensors, m, negative on the other side; None: one sensor, in the centre."""
    samples: int | None = None
    """Number of samples of a trace that the database states; None: not in the database."""
    remarks: tuple[Notice, ...] = ()
    """Remarks on repairs of the database."""

    @property
    def rate(self) -> float:
        """Sampling rate, Hz.

        It is checked when it is used, because only traces without a rate of their own need it.

        Raises
        ------
        TraceError
            If the database has no plausible one.
        """
        hint = "give sampling_rate_hz in a file with --header"
        return within(*self.recorded_rate, *SAMPLING_RATES_HZ, self.where, hint)

    @property
    def pre_trigger(self) -> float:
        """Time before the trigger, s.

        Raises
        ------
        TraceError
            If the database has no plausible one.
        """
        return within(*self.recorded_pre_trigger, *PRE_TRIGGERS_S, self.where)


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
    """Check the entries of a database and return them as `Facts`.

    Parameters
    ----------
    where : str
        File and member of the database, for messages.
    points : sequence of PointFacts
    rate, pre_trigger : (value, name), Hz and s
        Values in the database, with the names of their entries.
    diameter : object, m
        Diameter of the plate; 0: a test on a rig, without a plate.
    poisson_ratio, seating, samples : object
        Values in the database; seating: number of seating drops.
    device, site : str
    offsets : tuple of float, m, optional
        Offsets of the sensors.
    remarks : sequence of Notice
        Remarks on repairs of the database.
    """
    width, drops = finite(diameter), finite(seating)
    declared = {
        # Rounded, because 0.3 in single precision is 0.30000001192092896.
        "plate_radius_m": round(width / 2, 6) if width else None,
        # Tests on a rig of springs ("Raideur") have the diameter 0.
        "test": "stiffness" if width == 0 else None,
        "poisson_ratio": finite(poisson_ratio),
        "seating_drops": int(drops)
        if drops is not None and 0 <= drops < MAX_SEATING_DROPS
        else None,
        "device": short_text(device),
        "site": site,
    }
    count = finite(samples)
    names = distinct_names([point.name for point in points])
    return Facts(
        where,
        rate,
        pre_trigger,
        declared,
        tuple(replace(point, name=name) for point, name in zip(points, names, strict=True)),
        offsets,
        None if count is None else int(count),
        tuple(remarks),
    )


def point_facts(
    identity: str,
    name: str,
    date: object,
    position: tuple[object, object],
    declared: Mapping[str, Any],
    noted: Mapping[str, Any],
    peaks: Sequence[StoredPeaks] = (),
    labels: tuple[float, ...] | None = None,
) -> PointFacts:
    """Convert the entries of a database about a point to `PointFacts`.

    Parameters
    ----------
    identity, name : str
    date : object
        Date and time in the database, ISO 8601.
    position : tuple of object
        Latitude and longitude in the database, degrees.
    declared : mapping of header key to value
    noted : mapping
        Further data to store with the point.
    peaks, labels
        As the fields of `PointFacts`.
    """
    moment = moment_of(date)
    return PointFacts(
        identity,
        name,
        {**declared, "time_utc": moment.get("time_utc"), **position_of(*position)},
        {"time_local": moment.get("time_local"), **noted},
        tuple(peaks),
        labels,
    )


def join_name(*parts: object) -> str:
    """Return the parts that are not empty, joined by blanks; "point" if all are empty."""
    return " ".join(str(part) for part in parts if part not in (None, "")) or "point"
