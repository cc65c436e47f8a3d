"""Facts of a project in the databases of Rincent's programs, the same for all of them."""

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
"""Range of sampling rates."""

PRE_TRIGGERS_S = (0.0, 60.0)
"""Range of pre-triggers."""

MAX_SEATING_DROPS = 1000
"""Seating drops of a point; a larger number has another meaning."""

IDENTITY_MASK = (1 << 64) - 1
"""Mask for identities: signed 64-bit numbers in some files, unsigned hexadecimal in others."""


@dataclass(frozen=True, slots=True)
class StoredPeaks:
    """Peaks of a drop in the database."""

    load: float | None
    """Peak load, N."""
    deflections: tuple[float, ...]
    """Deflections, m, in the order of the sensors in the database; empty if one is no number."""
    duration: float | None = None
    """Duration of the load pulse, s."""


@dataclass(frozen=True, slots=True)
class PointFacts:
    """Test point without its traces."""

    identity: str
    """Identity as written in the database."""
    name: str
    declared: Mapping[str, Any] = field(default_factory=dict)
    """Values of header keys."""
    noted: Mapping[str, Any] = field(default_factory=dict)
    """Other data to store."""
    peaks: tuple[StoredPeaks, ...] = ()
    """Peaks of its drops, in their order."""
    labels: tuple[float, ...] | None = None
    """Offsets of the sensors from the names of the deflections, m; None: not in the names."""

    @property
    def numbers(self) -> set[int]:
        """The identity as a number, hexadecimal or decimal: databases have either."""
        numbers = set()
        for base in (16, 10):
            try:
                numbers.add(int(self.identity, base) & IDENTITY_MASK)
            except ValueError:
                continue
        return numbers


@dataclass(frozen=True, slots=True)
class Facts:
    """Project without its traces."""

    where: str
    """File and member, for messages."""
    recorded_rate: tuple[object, str]
    """Sampling rate, Hz, as written in the database, and its name there."""
    recorded_pre_trigger: tuple[object, str]
    """Time before the trigger, s, as written in the database, and its name there."""
    declared: Mapping[str, Any]
    """Values of header keys of all points; None: not stated."""
    points: tuple[PointFacts, ...]
    offsets: tuple[float, ...] | None = None
    """Offsets of the sensors, m, negative on the other side; None: one in the centre."""
    samples: int | None = None
    """Samples of a trace according to the database."""
    remarks: tuple[Notice, ...] = ()
    """Remarks on repairs of the database."""

    @property
    def rate(self) -> float:
        """Sampling rate, Hz; raises TraceError if the database has none.

        Required only for traces without a rate of their own; peaks need none.
        """
        hint = "give sampling_rate_hz in a file with --header"
        return within(*self.recorded_rate, *SAMPLING_RATES_HZ, self.where, hint)

    @property
    def pre_trigger(self) -> float:
        """Time before the trigger, s; raises TraceError if the database has none."""
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
    """Return the checked facts of a project.

    Parameters
    ----------
    where : str
        File and member, for messages.
    points : sequence of PointFacts
    rate, pre_trigger : (value, name), Hz and s
        Values as written in the database, with their names there.
    diameter : diameter of the plate, m
    poisson_ratio, seating, samples : values as written in the database
    device, site : str
    offsets : offsets of the sensors, m
    remarks : sequence of Notice
    """
    width, drops = finite(diameter), finite(seating)
    declared = {
        # 0.3 in single precision is 0.30000001192092896
        "plate_radius_m": round(width / 2, 6) if width else None,
        # A rig, which the program calls Raideur, has no plate: diameter 0.
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
    """Return the facts of a point.

    Parameters
    ----------
    identity, name : str
    date : date as written in the database
    position : latitude and longitude as written in the database
    declared, noted : values of header keys, other data to store
    peaks, labels : peaks of its drops, offsets in their names
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
    """Return the parts that are not empty as one name."""
    return " ".join(str(part) for part in parts if part not in (None, "")) or "point"
