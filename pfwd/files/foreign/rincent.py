"""Reader of projects of Rincent's programs for Minidyn, Maxidyn and Heavydyn.

``.dynz``, ``.prjz`` and ``.mpvz`` are zip archives with a database and, for each point, the stored
traces: those that the maker's program has processed. A ``.dynz`` has the raw channels of every drop
as well. The layout was inferred from public files; the maker has published no description.
"""

import itertools
import os
from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from inversion.notices import Notice, Value
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.archive import Archive
from pfwd.files.foreign.common import (
    Channels,
    Request,
    Values,
    distinct_sensors,
    finite,
    make_drop,
    peaks_drop,
    point_of,
    sampled_time,
    within,
)
from pfwd.files.foreign.peaks_text import PEAKS_REMARK
from pfwd.files.foreign.rincent_facts import (
    IDENTITY_MASK,
    SAMPLING_RATES_HZ,
    Facts,
    PointFacts,
    StoredPeaks,
)
from pfwd.files.foreign.rincent_json import read_json
from pfwd.files.foreign.rincent_stored import Stored, parse_stored
from pfwd.files.foreign.rincent_xml import (
    RincentDrop,
    facts_of,
    raw_drops,
    read_tables,
    repair_xml,
)
from pfwd.files.header import PEAK_DEVIATIONS
from pfwd.files.traces import TracePoint
from pfwd_device import Channel, Drop
from pfwd_device.signals import displacement_of, integrated, remove_offset, trace_peaks
from pfwd_plugins.quantities import Measurand

JSON_NAME, XML_NAME, TRACE_FOLDER = "database.json", "database.xml", "rawdata/"

RATE_KEY = "sampling_rate_hz"
"""Header key with the sampling rate of the stored traces, Hz; overrides the rate in the file."""

RELATIVE_RATE_TOLERANCE = 1e-6
"""Relative difference below which two sampling rates in a file are equal."""

CENTRE_TOLERANCE_M = 1e-3
"""Distance from the plate's centre below which a sensor is the centre sensor."""

RELATIVE_PEAK_TOLERANCE = 5e-3
"""Relative difference below which stored peaks and those of the traces agree. Rounding and the
offset at rest cause less; peaks of a program that filters the traces are 1 % lower."""

SMOOTHING_HZ, N_SMOOTHING_POLES = 320.0, 6
"""Cut-off and poles of the filter of Minidyn's software. On 45 drops of a rig the filtered traces
have its peak loads within 0.01 % and its peak deflections within 0.03 %; unfiltered ones are up to
1.6 % off."""

_DEVIATION_CODES = {"stored-load-differs", "stored-deflection-differs"}
"""Codes of the remarks that stored peaks differ from those of the traces."""


def read(file: str, request: Request) -> list[TracePoint]:
    """Read the test points of a project.

    Parameters
    ----------
    file : str
        Path of the archive.
    request : Request
        ``channels`` chooses between raw channels and stored traces.

    Raises
    ------
    TraceError
        If the project is refused.
    """
    request, declared = request.without(RATE_KEY)
    rate = None
    if declared is not None:
        rate = within(declared.value, RATE_KEY, *SAMPLING_RATES_HZ, f"{declared.where}")
    with Archive(file) as archive:
        project = _Project(archive, rate)
        if request.channels != "stored" and project.drops:
            points = _raw_points(project, request)
        else:
            points = _stored_points(project, request)
    return points


@dataclass(frozen=True, slots=True)
class _Source:
    """Properties that all points of a file share."""

    file: str
    facts: Facts
    request: Request
    channels: Channels
    remarks: tuple[Notice, ...]
    rate: float | None = None
    """Declared sampling rate, Hz."""


class _Project:
    """Project that is open for reading: its databases and the names of its traces."""

    def __init__(self, archive: Archive, rate: float | None = None) -> None:
        self.archive = archive
        self.rate = rate
        """Declared sampling rate, Hz."""
        self.remarks: tuple[Notice, ...] = ()
        self.file = archive.file
        names = archive.names
        self.json = next((n for n in names if n.rpartition("/")[2] == JSON_NAME), None)
        self.xml = next((n for n in names if n.rpartition("/")[2] == XML_NAME), None)
        self.stored = [n for n in names if TRACE_FOLDER in f"/{n}" and not n.endswith("/")]
        self.drops: list[RincentDrop] = []
        self.xml_facts: Facts | None = None
        if self.json is None and self.xml is None:
            expected = f"{JSON_NAME} or {XML_NAME} in the archive"
            actual = quote(", ".join(names[:3]) or "nothing")
            raise TraceError(refusal(self.file, expected, actual, "is it a Rincent project?"))
        if self.xml is not None:
            where = f"{self.file}, {self.xml}"
            data, remarks = repair_xml(archive.read(self.xml), _short(where))
            self.remarks = tuple(remarks)
            tables = read_tables(data, where)
            self.drops = raw_drops(tables, where)
            self.xml_facts = facts_of(tables, where)

    def facts(self) -> Facts:
        """Return the content of the JSON database, which is more complete, else of the XML
        database.
        """
        if self.json is not None:
            return read_json(self.archive.read(self.json), f"{self.file}, {self.json}")
        assert self.xml_facts is not None
        return self.xml_facts

    def stored_peaks(self) -> Mapping[str, tuple[StoredPeaks, ...]]:
        """Return the peaks in the JSON database by the name of the point; empty: there is none to
        read.
        """
        if self.json is None:
            return {}
        try:
            return {point.name: point.peaks for point in self.facts().points}
        except TraceError:
            return {}  # raw channels can be read without this database


def _short(where: str) -> str:
    """Return file name and member without the folder, for remarks that are stored."""
    file, _, member = where.rpartition(", ")
    return f"{os.path.basename(file)}, {member}"


def _raw_points(project: _Project, request: Request) -> list[TracePoint]:
    if any(drop.quantity is None for drop in project.drops):
        if request.channels is None and project.stored:
            return _stored_points(project, request, Notice("raw-accelerations"))
        expected = "raw velocities or displacements"
        hint = "import the stored traces with --channels stored"
        raise TraceError(refusal(project.file, expected, "accelerations", hint))
    assert project.xml_facts is not None
    facts = project.xml_facts
    by_point: dict[str, list[RincentDrop]] = defaultdict(list)
    for drop in project.drops:
        by_point[drop.point].append(drop)
    points_by_identity = {point.identity: point for point in facts.points}
    peaks = project.stored_peaks()
    source = _Source(project.file, facts, request, "raw", project.remarks)
    rate = project.rate or facts.rate
    points = []
    for identity, raw_drops_of_point in by_point.items():
        point = points_by_identity.get(identity) or PointFacts(identity, f"point {identity}")
        drops = []
        for raw_drop in sorted(raw_drops_of_point, key=lambda drop: drop.number):
            where = f"{project.file}, {point.name}, drop {raw_drop.number}"
            time = sampled_time(raw_drop.load.size, rate, facts.pre_trigger)
            quantity = raw_drop.quantity or Measurand.VELOCITY
            drops.append(
                make_drop(
                    raw_drop.number, time, raw_drop.load, [(0.0, quantity, raw_drop.sensor)], where
                )
            )
        numbers = [drop.number for drop in drops]
        if len(set(numbers)) < len(numbers):
            where = f"{project.file}, {point.name}"
            raise TraceError(refusal(where, "every drop once", f"drops {numbers}"))
        where = _short(f"{project.file}, {project.json}")
        remarks, deviations = compare_raw_peaks(drops, peaks.get(point.name, ()), where)
        noted = {PEAK_DEVIATIONS: deviations or None}
        points.append(_point(source, point, drops, remarks, **noted))
    return points


def _stored_points(project: _Project, request: Request, *remarks: Notice) -> list[TracePoint]:
    facts = project.facts()  # before the traces, to report a damaged database first
    if not project.stored:
        if request.channels == "stored" and project.drops:
            hint = "import it without --channels stored"
            raise TraceError(refusal(project.file, f"traces in {TRACE_FOLDER}", "none", hint))
        source = _Source(project.file, facts, request, "stored", facts.remarks)
        points = [
            point_of_peaks
            for point in facts.points
            for point_of_peaks in _peaks_point(source, point)
        ]
        if not points:
            expected = f"traces in {TRACE_FOLDER}, or peaks of load and deflection in the database"
            raise TraceError(refusal(project.file, expected, "none"))
        return points
    all_remarks = (*remarks, *project.remarks, *facts.remarks)
    source = _Source(project.file, facts, request, "stored", all_remarks, project.rate)
    traces: dict[str, Stored] = {}
    order = {name: place for place, name in enumerate(project.stored)}
    for name in project.stored:
        traces[name] = parse_stored(project.archive.read(name), f"{project.file}, {name}")
    points, unassigned = [], dict(traces)
    members_by_number: dict[int, deque[str]] = defaultdict(deque)
    for name in traces:
        for number in _numbers_of(name, traces[name]):
            members_by_number[number].append(name)
    for point in facts.points:
        # Of several members with this identity, the first that no point has yet.
        candidates = [
            members_by_number[number] for number in point.numbers if number in members_by_number
        ]
        for names in candidates:
            while names and names[0] not in unassigned:
                names.popleft()
        match = min(
            (names[0] for names in candidates if names), key=order.__getitem__, default=None
        )
        if match is not None:
            points.append(_stored_point(source, point, unassigned.pop(match), match))
        else:
            points += _peaks_point(source, point)
    names_used = {point.name for point in facts.points}
    free_names = (name for n in itertools.count(1) if (name := f"point {n}") not in names_used)
    for (member, stored), name in zip(unassigned.items(), free_names, strict=False):
        remark = Notice("traces-without-point", {"file": _short(f"{project.file}, {member}")})
        points.append(_stored_point(source, PointFacts("", name), stored, member, remark))
    return points


def _numbers_of(member: str, stored: Stored) -> set[int]:
    """Return the identities of a point to which traces may belong.

    The name of the member and its content each have one, and they may differ.
    """
    try:
        name_identity = int(member.rpartition("/")[2].partition(".")[0], 16) & IDENTITY_MASK
    except ValueError:
        name_identity = stored.identity & IDENTITY_MASK
    return {name_identity, stored.identity & IDENTITY_MASK}


def _stored_point(
    source: _Source, point: PointFacts, stored: Stored, member: str, *more: Notice
) -> TracePoint:
    facts, where = source.facts, f"{source.file}, {member}"
    rate = source.rate or stored.rate or facts.rate
    remarks = [Notice("stored-traces"), *more, *_rate_remarks(source, stored, where)]
    channels = stored.drops[0].displacement.shape[0]
    offsets = facts.offsets or (0.0,)
    if len(offsets) != channels:
        expected = f"{len(offsets)} displacements, as the database lists sensors"
        raise TraceError(refusal(where, expected, str(channels)))
    used, sensor_remarks = distinct_sensors(offsets)
    remarks += sensor_remarks
    drops = []
    for number, stored_drop in enumerate(stored.drops, start=1):
        time = sampled_time(stored_drop.load.size, rate, facts.pre_trigger)
        quantity = Measurand.DISPLACEMENT
        sensors = [(offsets[i], quantity, stored_drop.displacement[i]) for i in used]
        drops.append(make_drop(number, time, stored_drop.load, sensors, f"{where}, drop {number}"))
    differences, deviations = compare_peaks(
        drops, point.peaks, _short(facts.where), "stored_traces"
    )
    remarks += differences
    return _point(source, point, drops, remarks, **{PEAK_DEVIATIONS: deviations or None})


def _peaks_point(source: _Source, point: PointFacts) -> list[TracePoint]:
    """Return a point without traces, from its peaks in the database; empty: it has no peaks."""
    where = f"{source.facts.where}, {point.name}"
    remarks, drops = [PEAKS_REMARK], []
    for number, peaks in enumerate(point.peaks, start=1):
        if peaks.load is None or not peaks.deflections:
            remarks.append(Notice("drop-without-peaks", {"file": _short(where), "drop": number}))
            continue
        offsets = source.facts.offsets or point.labels or (0.0,)
        if len(offsets) != len(peaks.deflections):
            expected = f"{len(offsets)} deflections, as the database lists sensors"
            raise TraceError(refusal(where, expected, str(len(peaks.deflections))))
        used, sensor_remarks = distinct_sensors(offsets)
        remarks += sensor_remarks
        pairs = [(offsets[i], peaks.deflections[i]) for i in used]
        drops.append(peaks_drop(number, peaks.load, pairs, f"{where}, drop {number}"))
    if not drops:
        return []
    durations = [peaks.duration for peaks in point.peaks if peaks.duration is not None]
    return [_point(source, point, drops, remarks, pulse_durations_s=durations or None)]


def _rate_remarks(source: _Source, stored: Stored, where: str) -> list[Notice]:
    """Return a remark if database and traces state different rates; that of the traces is used."""
    facts, rate = source.facts, stored.rate
    database_rate, samples = finite(facts.recorded_rate[0]), stored.drops[0].load.size
    if source.rate is not None or database_rate is None:
        return []
    if rate is None and facts.samples not in (None, samples):
        rate_of_database: dict[str, Value] = {
            "file": _short(where),
            "samples": samples,
            "database_samples": facts.samples,
            "rate_hz": database_rate,
        }
        return [Notice("rate-of-database", rate_of_database)]
    if rate is None:
        return []
    if abs(rate - database_rate) <= RELATIVE_RATE_TOLERANCE * rate:
        return []
    file, _, database = _short(facts.where).rpartition(", ")
    # The remark does not name the member, so that it is the same for all points and shown once.
    values: dict[str, Value] = {
        "file": file,
        "rate_hz": rate,
        "samples": samples,
        "database": database,
        "database_rate_hz": database_rate,
    }
    if facts.samples is None:
        return [Notice("rate-of-traces", values)]
    values["database_samples"] = facts.samples
    return [Notice("rate-and-samples-of-traces", values)]


def compare_peaks(
    drops: Sequence[Drop], stored: Sequence[StoredPeaks], where: str, traces: str
) -> tuple[list[Notice], dict[str, float]]:
    """Compare the peaks of the traces with those in the maker's database.

    The maker's program searches a deflection within the pulse only; the trace may drift to a larger
    value later. The peaks agree if any maximum of the trace equals the stored one.

    Parameters
    ----------
    drops : sequence of Drop
    stored : sequence of StoredPeaks
        Peaks in the database, in the same order.
    where : str
        File and member of the database, for remarks.
    traces : "stored_traces" or "raw_channels"
        Kind of the traces, for remarks.

    Returns
    -------
    remarks : list of Notice
        Remarks on different numbers of drops, drops with identical samples, and different loads or
        deflections; empty: all agree.
    deviations : dict of str to float
        By drop number the larger of the relative differences of load and centre deflection, if it
        exceeds `RELATIVE_PEAK_TOLERANCE`. If all drops have the same samples, each has the
        difference of the first.
    """
    if not stored:
        return [], {}
    about: dict[str, Value] = {"file": where, "traces": traces}
    if len(drops) != len(stored):
        counts = {"stored_drops": len(stored), "drops": len(drops)}
        return [Notice("stored-drops-differ", about | counts)], {}
    remarks = []
    groups = [[drop] for drop in drops]
    if len(drops) > 1 and all(drop.has_samples_of(drops[0]) for drop in drops[1:]):
        remarks.append(Notice("traces-identical", about | {"drops": len(drops)}))
        groups = [list(drops)]
    deviations_by_drop: dict[str, float] = {}
    loads, deflection_deviations, rising = [], [], False
    for (drop, *copies), recorded in zip(groups, stored, strict=False):
        own = [trace_peaks(drop).load / recorded.load - 1] if recorded.load else []
        loads += own
        same_sensors = len(recorded.deflections) == len(drop.channels)
        deflections = recorded.deflections if same_sensors else ()
        for channel, deflection in zip(drop.channels, deflections, strict=False):
            if deflection <= 0:
                continue
            largest, nearest = _maxima(displacement_of(channel, drop.time), deflection)
            deviation = nearest / deflection - 1
            agrees = abs(deviation) <= RELATIVE_PEAK_TOLERANCE
            deflection_deviations.append(deviation if agrees else largest / deflection - 1)
            rising = rising or (agrees and largest > (1 + RELATIVE_PEAK_TOLERANCE) * nearest)
            if abs(channel.offset) < CENTRE_TOLERANCE_M:
                own.append(deviation)
        worst = max(map(abs, own), default=0.0)
        if worst > RELATIVE_PEAK_TOLERANCE:
            deviations_by_drop |= {str(each.number): round(worst, 6) for each in (drop, *copies)}
    for code, deviations in (
        ("stored-load-differs", loads),
        ("stored-deflection-differs", deflection_deviations),
    ):
        if deviations and max(map(abs, deviations)) > RELATIVE_PEAK_TOLERANCE:
            ends = (min(deviations), max(deviations))
            is_same_value = f"{100 * ends[0]:+.1f}" == f"{100 * ends[1]:+.1f}"
            remarks.append(Notice(code, about | {"deviation": ends[0] if is_same_value else ends}))
            rising = False
    if rising:
        remarks.append(Notice("stored-deflection-earlier", about))
    return remarks, deviations_by_drop


def compare_raw_peaks(
    drops: Sequence[Drop], stored: Sequence[StoredPeaks], where: str
) -> tuple[list[Notice], dict[str, float]]:
    """Compare the peaks of raw channels with those in the maker's database.

    The maker's program filters the channels before it searches peaks. If they differ from the peaks
    of the raw channels but agree with those of filtered ones, a remark says so.

    Parameters
    ----------
    drops, stored, where
        As for :func:`compare_peaks`.

    Returns
    -------
    remarks, deviations
        As of :func:`compare_peaks`; the deviations are those of the raw channels.
    """
    as_recorded, deviations = compare_peaks(drops, stored, where, "raw_channels")
    if not _DEVIATION_CODES & {remark.code for remark in as_recorded}:
        return as_recorded, deviations
    smoothed = [smoothed_as_stored(drop) for drop in drops]
    remarks, _ = compare_peaks(smoothed, stored, where, "raw_channels")
    if _DEVIATION_CODES & {remark.code for remark in remarks}:
        return as_recorded, deviations
    values: dict[str, Value] = {
        "file": where,
        "cutoff_hz": SMOOTHING_HZ,
        "poles": N_SMOOTHING_POLES,
        "tolerance": RELATIVE_PEAK_TOLERANCE,
    }
    return [*remarks, Notice("stored-peaks-smoothed", values)], deviations


def smoothed_as_stored(drop: Drop) -> Drop:
    """Return a drop filtered as by the maker's program.

    The offset at rest is removed, load and sensor pass one causal Butterworth filter, and a
    velocity is integrated. Filter and order of the steps were inferred from files with raw channels
    and stored peaks.
    """
    from scipy.signal import butter, lfilter

    numerator, denominator = butter(N_SMOOTHING_POLES, 2 * SMOOTHING_HZ / drop.sampling_rate)

    def smooth(values: Values) -> Values:
        without_offset = remove_offset(drop.time, values)
        return np.asarray(lfilter(numerator, denominator, without_offset), np.float64)

    def displacement(channel: Channel) -> Channel:
        values = smooth(channel.values)
        for _ in range(channel.quantity.integrations):
            # The offset is removed before the filter and not again after it.
            values = integrated(values, drop.time)
        return Channel(channel.offset, Measurand.DISPLACEMENT, values)

    channels = tuple(displacement(channel) for channel in drop.channels)
    return Drop(drop.number, drop.time, smooth(drop.load), channels)


def _maxima(values: Values, target: float) -> tuple[float, float]:
    """Return the largest value of a trace and its local maximum nearest to `target`, m."""
    inside = values[1:-1]
    peaks = inside[(inside > values[:-2]) & (inside >= values[2:])]
    largest = float(values.max())
    # Relative to zero, or to the first sample, which is 0 in stored traces.
    candidates = [largest, float((values - values[0]).max()), *peaks, *(peaks - values[0])]
    return largest, float(min(candidates, key=lambda value: abs(value - target)))


def _point(
    source: _Source,
    point: PointFacts,
    drops: list[Drop],
    remarks: Sequence[Notice],
    **noted: object,
) -> TracePoint:
    suffix = source.file.rpartition(".")[2].lower()
    declared = {
        **source.facts.declared,
        **{k: v for k, v in point.declared.items() if v is not None},
    }
    declared["point"] = point.name
    content = "peaks" if drops[0].only_peaks is not None else f"{source.channels} channels"
    declared["source"] = f"Rincent project (.{suffix}), {content}"
    return point_of(
        source.file,
        declared,
        drops,
        source.request,
        noted={**point.noted, **noted},
        remarks=(*source.remarks, *remarks),
    )
