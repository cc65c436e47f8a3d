"""Projects of Rincent's Minidyn, Maxidyn and Heavydyn: ``.dynz``, ``.prjz`` and ``.mpvz``.

All three are zip archives with a database and, for each point, the traces that the program stored.
A ``.dynz`` has the raw channels of every drop as well. Layout as seen in public files; the maker
has published none.
"""

import itertools
import os
from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from inversion.notices import Notice, Value
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.archive import Archive
from pfwd.files.foreign.common import (
    Channels,
    Request,
    Values,
    finite,
    make_drop,
    one_a_place,
    peaks_drop,
    point_of,
    sampled_time,
    within,
)
from pfwd.files.foreign.peaks_text import PEAKS_REMARK
from pfwd.files.foreign.rincent_facts import (
    MASK,
    RATES,
    Facts,
    PointFacts,
    StoredPeaks,
)
from pfwd.files.foreign.rincent_json import read_json
from pfwd.files.foreign.rincent_stored import Stored, parse_stored
from pfwd.files.foreign.rincent_xml import (
    RawDrop,
    facts_of,
    mended,
    raw_drops,
    read_tables,
)
from pfwd.files.header import PEAK_DEVIATIONS
from pfwd.files.traces import TracePoint
from pfwd_device import Channel, Drop
from pfwd_device.signals import displacement_of, remove_offset, trace_peaks

JSON, XML, TRACES = "database.json", "database.xml", "rawdata/"

RATE = "sampling_rate_hz"
"""Key of ``--header``: sampling rate of the stored traces, Hz; wins over what the file says."""

RATE_TOLERANCE = 1e-6
"""Relative; two places of a file that say the sampling rate say the same one."""

CENTRE = 1e-3
"""m; a sensor nearer to the plate's centre than this is the centre sensor."""

PEAK_TOLERANCE = 5e-3
"""Relative; peaks that the maker's software stored and those of the traces are then the same. It is
what rounding and the offset at rest come to; software that smooths first is 1 % lower."""

SMOOTHING_HZ, SMOOTHING_POLES = 320.0, 6
"""Of the filter of Minidyn's software: with it 45 drops of a rig have its peak loads within 0.01 %
and its peak deflections within 0.03 %; without, both are up to 1.6 % off."""

STORED_REMARK = Notice("stored-traces")

_DEVIATIONS = {"stored-load-differs", "stored-deflection-differs"}
"""Codes of remarks on stored peaks that are not those of the traces."""


def read(file: str, request: Request) -> list[TracePoint]:
    """The test points of a project.

    Parameters
    ----------
    file : str
    request : Request
        ``channels`` chooses between raw channels and stored traces.

    Raises
    ------
    TraceError
        If it is refused.
    """
    said = dict(request.said)
    declared = said.pop(RATE, None)
    request = replace(request, said=said)
    rate = None
    if declared is not None:
        rate = within(declared.value, RATE, *RATES, f"{declared.where}")
    with Archive(file) as archive:
        project = _Project(archive, rate)
        if request.channels != "stored" and project.drops:
            points = _raw_points(project, request)
        else:
            points = _stored_points(project, request)
    return points


@dataclass(frozen=True, slots=True)
class _Source:
    """What the points of a file are made with."""

    file: str
    facts: Facts
    request: Request
    channels: Channels
    remarks: tuple[Notice, ...]
    rate: float | None = None
    """As it was declared, Hz."""


class _Project:
    """An opened project: its databases and where its traces are."""

    def __init__(self, archive: Archive, rate: float | None = None) -> None:
        self.archive = archive
        self.rate = rate
        """As it was declared, Hz."""
        self.remarks: tuple[Notice, ...] = ()
        self.file = archive.file
        names = archive.names
        self.json = next((n for n in names if n.rpartition("/")[2] == JSON), None)
        self.xml = next((n for n in names if n.rpartition("/")[2] == XML), None)
        self.stored = [n for n in names if TRACES in f"/{n}" and not n.endswith("/")]
        self.drops: list[RawDrop] = []
        self.xml_facts: Facts | None = None
        if self.json is None and self.xml is None:
            expected = f"{JSON} or {XML} in the archive"
            came = quote(", ".join(names[:3]) or "nothing")
            raise TraceError(refusal(self.file, expected, came, "is it a Rincent project?"))
        if self.xml is not None:
            where = f"{self.file}, {self.xml}"
            data, remarks = mended(archive.read(self.xml), _short(where))
            self.remarks = tuple(remarks)
            tables = read_tables(data, where)
            self.drops = raw_drops(tables, where)
            self.xml_facts = facts_of(tables, where)

    def facts(self) -> Facts:
        """Of the JSON database where there is one: it says more."""
        if self.json is not None:
            return read_json(self.archive.read(self.json), f"{self.file}, {self.json}")
        assert self.xml_facts is not None
        return self.xml_facts

    def stored_peaks(self) -> Mapping[str, tuple[StoredPeaks, ...]]:
        """Of each point by its name, what the maker's software found; empty when it is unknown."""
        if self.json is None:
            return {}
        try:
            return {point.name: point.peaks for point in self.facts().points}
        except TraceError:
            return {}  # the raw channels do not need this database


def _short(where: str) -> str:
    """Name of file and member, for a remark that is kept."""
    file, _, member = where.rpartition(", ")
    return f"{os.path.basename(file)}, {member}"


def _raw_points(project: _Project, request: Request) -> list[TracePoint]:
    if any(drop.quantity is None for drop in project.drops):
        if request.channels is None and project.stored:
            return _stored_points(project, request, Notice("raw-accelerations"))
        expected = "raw velocities or displacements"
        hint = "give --channels stored"
        raise TraceError(refusal(project.file, expected, "accelerations", hint))
    assert project.xml_facts is not None
    facts = project.xml_facts
    by_point: dict[str, list[RawDrop]] = defaultdict(list)
    for drop in project.drops:
        by_point[drop.point].append(drop)
    known = {point.identity: point for point in facts.points}
    peaks = project.stored_peaks()
    source = _Source(project.file, facts, request, "raw", project.remarks)
    rate = project.rate or facts.rate
    found = []
    for identity, raw in by_point.items():
        point = known.get(identity) or PointFacts(identity, f"point {identity}")
        drops = []
        for one in sorted(raw, key=lambda drop: drop.number):
            where = f"{project.file}, {point.name}, drop {one.number}"
            time = sampled_time(one.load.size, rate, facts.pre_trigger)
            quantity = one.quantity or "velocity"
            drops.append(
                make_drop(one.number, time, one.load, [(0.0, quantity, one.sensor)], where)
            )
        _refuse_twins(drops, f"{project.file}, {point.name}")
        where = f"{_short(f'{project.file}, {project.json}')}"
        stored = peaks.get(point.name, ())
        compared = compare_raw_peaks(drops, stored, where)
        point = _with_deviations(point, peak_deviations(drops, stored))
        found.append(_point(source, point, drops, *compared))
    return found


def _refuse_twins(drops: list[Drop], where: str) -> None:
    numbers = [drop.number for drop in drops]
    if len(set(numbers)) < len(numbers):
        raise TraceError(refusal(where, "every drop once", f"drops {numbers}"))


def _stored_points(project: _Project, request: Request, *remarks: Notice) -> list[TracePoint]:
    facts = project.facts()  # first: a damaged database is the better message
    if not project.stored:
        if request.channels == "stored" and project.drops:
            hint = "leave --channels stored out"
            raise TraceError(refusal(project.file, f"traces in {TRACES}", "none", hint))
        source = _Source(project.file, facts, request, "stored", facts.remarks)
        found = [one for point in facts.points for one in _peaks_point(source, point)]
        if not found:
            expected = f"traces in {TRACES}, or peaks of load and deflection in the database"
            raise TraceError(refusal(project.file, expected, "none"))
        return found
    said = (*remarks, *project.remarks, *facts.remarks, STORED_REMARK)
    source = _Source(project.file, facts, request, "stored", said, project.rate)
    traces: dict[str, Stored] = {}
    order = {name: place for place, name in enumerate(project.stored)}
    for name in project.stored:
        traces[name] = parse_stored(project.archive.read(name), f"{project.file}, {name}")
    found, left = [], dict(traces)
    named: dict[int, deque[str]] = defaultdict(deque)
    for name in traces:
        for number in _numbers_of(name, traces[name]):
            named[number].append(name)
    for point in facts.points:
        # The first one in the archive that nobody has taken.
        waiting = [named[number] for number in point.numbers if number in named]
        for names in waiting:
            while names and names[0] not in left:
                names.popleft()
        match = min((names[0] for names in waiting if names), key=order.__getitem__, default=None)
        if match is not None:
            found.append(_stored_point(source, point, left.pop(match), match))
        else:
            found += _peaks_point(source, point)
    taken = {point.name for point in facts.points}
    free = (name for n in itertools.count(1) if (name := f"point {n}") not in taken)
    for (member, stored), name in zip(left.items(), free, strict=False):
        remark = Notice("traces-without-point", {"file": _short(f"{project.file}, {member}")})
        alone = replace(source, remarks=(*source.remarks, remark))
        found.append(_stored_point(alone, PointFacts("", name), stored, member))
    return found


def _numbers_of(member: str, stored: Stored) -> set[int]:
    """What identifies the point of traces: the name of the member, and the identity within."""
    try:
        of_name = int(member.rpartition("/")[2].partition(".")[0], 16) & MASK
    except ValueError:
        of_name = stored.identity & MASK
    return {of_name, stored.identity & MASK}


def _stored_point(source: _Source, point: PointFacts, stored: Stored, member: str) -> TracePoint:
    facts, where = source.facts, f"{source.file}, {member}"
    rate = source.rate or stored.rate or facts.rate
    remarks = _rate_remarks(source, stored, where)
    channels = stored.drops[0].displacement.shape[0]
    offsets = facts.offsets or (0.0,)
    if len(offsets) != channels:
        expected = f"{len(offsets)} displacements, as the database lists sensors"
        raise TraceError(refusal(where, expected, str(channels)))
    used, left_out = one_a_place(offsets)
    remarks += left_out
    drops = []
    for number, one in enumerate(stored.drops, start=1):
        time = sampled_time(one.load.size, rate, facts.pre_trigger)
        sensors = [(offsets[i], "displacement", one.displacement[i]) for i in used]
        drops.append(
            make_drop(number, time, one.load, sensors, f"{where}, drop {number}")  # type: ignore[arg-type]
        )
    remarks += compare_peaks(drops, point.peaks, _short(facts.where), "stored_traces")
    point = _with_deviations(point, peak_deviations(drops, point.peaks))
    return _point(source, point, drops, *remarks)


def _peaks_point(source: _Source, point: PointFacts) -> list[TracePoint]:
    """A point of which the project has no traces; none when it has no peaks either."""
    where = f"{source.facts.where}, {point.name}"
    remarks, drops = [PEAKS_REMARK], []
    for number, one in enumerate(point.peaks, start=1):
        if one.load is None or not one.deflections:
            remarks.append(Notice("drop-without-peaks", {"file": _short(where), "drop": number}))
            continue
        offsets = source.facts.offsets or point.labels or (0.0,)
        if len(offsets) != len(one.deflections):
            expected = f"{len(offsets)} deflections, as the database lists sensors"
            raise TraceError(refusal(where, expected, str(len(one.deflections))))
        used, left_out = one_a_place(offsets)
        remarks += left_out
        pairs = [(offsets[i], one.deflections[i]) for i in used]
        drops.append(peaks_drop(number, one.load, pairs, f"{where}, drop {number}"))
    if not drops:
        return []
    durations = [one.duration for one in point.peaks if one.duration is not None]
    said = tuple(one for one in source.remarks if one != STORED_REMARK)
    source = replace(source, remarks=said)
    point = replace(point, noted={**point.noted, "pulse_durations_s": durations or None})
    return [_point(source, point, drops, *remarks)]


def _rate_remarks(source: _Source, stored: Stored, where: str) -> list[Notice]:
    """Where database and traces do not say the same rate; who sampled wrote the traces."""
    facts, rate = source.facts, stored.rate
    said, samples = finite(facts.said_rate[0]), stored.drops[0].load.size
    if source.rate is not None or said is None:
        return []
    if rate is None and facts.samples not in (None, samples):
        rate_of_database: dict[str, Value] = {
            "file": _short(where),
            "samples": samples,
            "database_samples": facts.samples,
            "rate_hz": said,
        }
        return [Notice("rate-of-database", rate_of_database)]
    if rate is None:
        return []
    if abs(rate - said) <= RATE_TOLERANCE * rate:
        return []
    file, _, database = _short(facts.where).rpartition(", ")
    # Without the member of the archive, which is another for every point: one remark for all.
    values: dict[str, Value] = {
        "file": file,
        "rate_hz": rate,
        "samples": samples,
        "database": database,
        "database_rate_hz": said,
    }
    if facts.samples is None:
        return [Notice("rate-of-traces", values)]
    values["database_samples"] = facts.samples
    return [Notice("rate-and-samples-of-traces", values)]


def peak_deviations(drops: Sequence[Drop], stored: Sequence[StoredPeaks]) -> Mapping[str, float]:
    """Return how far load and centre deflection are from the stored peaks, where that is much.

    Of the deflection the maximum of the trace that is nearest to the stored value counts, as the
    maker's software takes a maximum within the pulse.

    Parameters
    ----------
    drops : sequence of Drop
    stored : sequence of StoredPeaks
        In the same order.

    Returns
    -------
    mapping of str to float
        The larger relative difference by the number of the drop, above `PEAK_TOLERANCE`. Of copies
        of one drop the first is compared, and its difference is that of all.
    """
    if len(drops) != len(stored):
        return {}
    found = {}
    copies = len(drops) > 1 and all(drop.has_samples_of(drops[0]) for drop in drops[1:])
    for drop, peaks in zip(drops, stored, strict=True):
        compared = stored[0] if copies else peaks
        deviations = [abs(trace_peaks(drop).load / compared.load - 1)] if compared.load else []
        if len(compared.deflections) == len(drop.channels):
            for channel, deflection in zip(drop.channels, compared.deflections, strict=True):
                if deflection > 0 and abs(channel.offset) < CENTRE:
                    _, nearest = _maxima(displacement_of(channel, drop.time), deflection)
                    deviations.append(abs(nearest / deflection - 1))
        largest = max(deviations, default=0.0)
        if largest > PEAK_TOLERANCE:
            found[str(drop.number)] = round(largest, 6)
    return found


def compare_peaks(
    drops: Sequence[Drop], stored: Sequence[StoredPeaks], where: str, traces: str
) -> list[Notice]:
    """Return the differences between the peaks that the maker's software stored and the traces.

    Its deflection is a maximum within the pulse, not always the largest value of a trace that
    drifts: a maximum of the trace that is the same is agreement.

    Parameters
    ----------
    drops : sequence of Drop
    stored : sequence of StoredPeaks
        In the same order.
    where : str
        Where they are stored.
    traces : "stored_traces" or "raw_channels"

    Returns
    -------
    list of Notice
        For the number of drops, for drops that are one, for the load, for the deflections;
        none where all is the same.
    """
    if not stored:
        return []
    about: dict[str, Value] = {"file": where, "traces": traces}
    if len(drops) != len(stored):
        counts = {"stored_drops": len(stored), "drops": len(drops)}
        return [Notice("stored-drops-differ", about | counts)]
    found = []
    if len(drops) > 1 and all(drop.has_samples_of(drops[0]) for drop in drops[1:]):
        found.append(Notice("traces-identical", about | {"drops": len(drops)}))
        drops, stored = drops[:1], stored[:1]
    loads, moved, rising = [], [], False
    for drop, one in zip(drops, stored, strict=True):
        peaks = trace_peaks(drop)
        if one.load:
            loads.append(peaks.load / one.load - 1)
        if len(one.deflections) != len(drop.channels):
            continue
        for channel, theirs in zip(drop.channels, one.deflections, strict=True):
            if theirs > 0:
                largest, nearest = _maxima(displacement_of(channel, drop.time), theirs)
                same = abs(nearest / theirs - 1) <= PEAK_TOLERANCE
                moved.append((nearest if same else largest) / theirs - 1)
                rising = rising or (same and largest > (1 + PEAK_TOLERANCE) * nearest)
    for code, parts in (("stored-load-differs", loads), ("stored-deflection-differs", moved)):
        if parts and max(map(abs, parts)) > PEAK_TOLERANCE:
            ends = (min(parts), max(parts))
            alike = f"{100 * ends[0]:+.1f}" == f"{100 * ends[1]:+.1f}"
            found.append(Notice(code, about | {"deviation": ends[0] if alike else ends}))
            rising = False
    if rising:
        found.append(Notice("stored-deflection-earlier", about))
    return found


def compare_raw_peaks(
    drops: Sequence[Drop], stored: Sequence[StoredPeaks], where: str
) -> list[Notice]:
    """As :func:`compare_peaks`, of raw channels: the maker's software smooths them first."""
    as_recorded = compare_peaks(drops, stored, where, "raw_channels")
    if not _DEVIATIONS & {remark.code for remark in as_recorded}:
        return as_recorded
    smoothed = [smoothed_as_stored(drop) for drop in drops]
    remarks = compare_peaks(smoothed, stored, where, "raw_channels")
    if _DEVIATIONS & {remark.code for remark in remarks}:
        return as_recorded
    values: dict[str, Value] = {
        "file": where,
        "cutoff_hz": SMOOTHING_HZ,
        "poles": SMOOTHING_POLES,
        "tolerance": PEAK_TOLERANCE,
    }
    return [*remarks, Notice("stored-peaks-smoothed", values)]


def smoothed_as_stored(drop: Drop) -> Drop:
    """A drop as the maker's software has it before it takes peaks.

    The offset at rest goes, then load and sensor through one causal Butterworth filter; a velocity
    is then integrated. Found from files with raw channels and stored peaks.
    """
    from scipy.signal import butter, lfilter

    numerator, denominator = butter(SMOOTHING_POLES, 2 * SMOOTHING_HZ / drop.sampling_rate)

    def smooth(values: Values) -> Values:
        rested = remove_offset(drop.time, values)
        return np.asarray(lfilter(numerator, denominator, rested), np.float64)

    def moved(channel: Channel) -> Channel:
        values = smooth(channel.values)
        if channel.quantity == "velocity":
            # Its offset is gone: what the filter leaves of it is not taken off again.
            steps = np.diff(drop.time) * (values[1:] + values[:-1]) / 2
            values = np.concatenate([[0.0], np.cumsum(steps)])
        return Channel(channel.offset, "displacement", values)

    channels = tuple(moved(channel) for channel in drop.channels)
    return Drop(drop.number, drop.time, smooth(drop.load), channels)


def _maxima(values: Values, wanted: float) -> tuple[float, float]:
    """The largest value of a trace, and of it and of its maxima the one nearest to `wanted`, m."""
    inside = values[1:-1]
    peaks = inside[(inside > values[:-2]) & (inside >= values[2:])]
    largest = float(values.max())
    # From the rest before the trigger, or from the first sample, which is 0 in these traces.
    found = [largest, float((values - values[0]).max()), *peaks, *(peaks - values[0])]
    return largest, float(min(found, key=lambda value: abs(value - wanted)))


def _with_deviations(point: PointFacts, deviations: Mapping[str, float]) -> PointFacts:
    """Return the point with the deviations of its peaks among what is kept of its import."""
    if not deviations:
        return point
    return replace(point, noted={**point.noted, PEAK_DEVIATIONS: dict(deviations)})


def _point(source: _Source, point: PointFacts, drops: list[Drop], *remarks: Notice) -> TracePoint:
    suffix = source.file.rpartition(".")[2].lower()
    known = {**source.facts.known, **{k: v for k, v in point.known.items() if v is not None}}
    known["point"] = point.name
    what = "peaks" if drops[0].only_peaks is not None else f"{source.channels} channels"
    known["source"] = f"Rincent project (.{suffix}), {what}"
    return point_of(
        source.file,
        known,
        drops,
        source.request,
        noted=point.noted,
        remarks=(*source.remarks, *remarks),
    )
