"""Projects of Rincent's Minidyn, Maxidyn and Heavydyn: ``.dynz``, ``.prjz`` and ``.mpvz``.

All three are zip archives with a database and, for each point, the traces that the program stored.
A ``.dynz`` has the raw channels of every drop as well. Layout as seen in public files; the maker
has published none.
"""

from collections import defaultdict, deque
from dataclasses import dataclass

from pfwd_device import Drop
from pfwd_survey.errors import TraceError, quote, refusal
from pfwd_survey.files.foreign.archive import Archive
from pfwd_survey.files.foreign.common import (
    Channels,
    Request,
    distinct,
    make_drop,
    one_a_place,
    point_of,
    sampled_time,
)
from pfwd_survey.files.foreign.rincent_facts import MASK, Facts, PointFacts
from pfwd_survey.files.foreign.rincent_json import read_json
from pfwd_survey.files.foreign.rincent_stored import Stored, parse_stored
from pfwd_survey.files.foreign.rincent_xml import RawDrop, facts_of, raw_drops, read_tables
from pfwd_survey.files.traces import TracePoint

JSON, XML, TRACES = "database.json", "database.xml", "rawdata/"

RATE_TOLERANCE = 1e-6
"""Relative; two places of a file that say the sampling rate say the same one."""

RAW_REMARK = (
    "raw channels: the response of the geophone is not in the file; declare "
    "geophone_natural_frequency_hz and geophone_damping where they are known"
)
STORED_REMARK = "load and displacement as the maker's software processed and stored them"


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
    with Archive(file) as archive:
        project = _Project(archive)
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
    remarks: tuple[str, ...]


class _Project:
    """An opened project: its databases and where its traces are."""

    def __init__(self, archive: Archive) -> None:
        self.archive = archive
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
            tables = read_tables(archive.read(self.xml), where)
            self.drops = raw_drops(tables, where)
            self.xml_facts = facts_of(tables, where)

    def facts(self) -> Facts:
        """Of the JSON database where there is one: it says more."""
        if self.json is not None:
            return read_json(self.archive.read(self.json), f"{self.file}, {self.json}")
        assert self.xml_facts is not None
        return self.xml_facts


def _raw_points(project: _Project, request: Request) -> list[TracePoint]:
    if any(drop.quantity is None for drop in project.drops):
        if request.channels is None and project.stored:
            remark = "the raw channels are accelerations, so the stored traces were taken"
            return _stored_points(project, request, remark)
        expected = "raw velocities or displacements"
        hint = "give --channels stored"
        raise TraceError(refusal(project.file, expected, "accelerations", hint))
    assert project.xml_facts is not None
    facts = project.xml_facts
    by_point: dict[str, list[RawDrop]] = defaultdict(list)
    for drop in project.drops:
        by_point[drop.point].append(drop)
    known = {point.identity: point for point in facts.points}
    source = _Source(project.file, facts, request, "raw", (RAW_REMARK,))
    found = []
    for identity, raw in by_point.items():
        point = known.get(identity) or PointFacts(identity, f"point {identity}")
        drops = []
        for one in sorted(raw, key=lambda drop: drop.number):
            where = f"{project.file}, {point.name}, drop {one.number}"
            time = sampled_time(one.load.size, facts.rate, facts.pre_trigger)
            quantity = one.quantity or "velocity"
            drops.append(
                make_drop(one.number, time, one.load, [(0.0, quantity, one.sensor)], where)
            )
        _refuse_twins(drops, f"{project.file}, {point.name}")
        found.append(_point(source, point, drops))
    return found


def _refuse_twins(drops: list[Drop], where: str) -> None:
    numbers = [drop.number for drop in drops]
    if len(set(numbers)) < len(numbers):
        raise TraceError(refusal(where, "every drop once", f"drops {numbers}"))


def _stored_points(project: _Project, request: Request, *remarks: str) -> list[TracePoint]:
    facts = project.facts()  # first: a damaged database is the better message
    if not project.stored:
        came = "peaks only" if project.xml is None else "none"
        hint = "save the project with its raw data"
        if request.channels == "stored" and project.drops:
            hint = "leave --channels stored out"
        raise TraceError(refusal(project.file, f"traces in {TRACES}", came, hint))
    source = _Source(project.file, facts, request, "stored", (*remarks, STORED_REMARK))
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
    strangers = [name.rpartition("/")[2] for name in left]
    for (member, stored), name in zip(left.items(), distinct(strangers), strict=True):
        alone = _Source(
            source.file, facts, request, "stored", (*source.remarks, "a point without a name")
        )
        found.append(_stored_point(alone, PointFacts("", f"point {name}"), stored, member))
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
    rate = stored.rate or facts.rate
    if abs(rate - facts.rate) > RATE_TOLERANCE * facts.rate:
        came = f"{rate:g} Hz"
        raise TraceError(refusal(where, f"{facts.rate:g} Hz as in the database", came))
    channels = stored.drops[0].displacement.shape[0]
    offsets = facts.offsets or (0.0,)
    if len(offsets) != channels:
        expected = f"{len(offsets)} displacements, as the database lists sensors"
        raise TraceError(refusal(where, expected, str(channels)))
    used, left_out = one_a_place(offsets)
    drops = []
    for number, one in enumerate(stored.drops, start=1):
        time = sampled_time(one.load.size, rate, facts.pre_trigger)
        sensors = [(offsets[i], "displacement", one.displacement[i]) for i in used]
        drops.append(
            make_drop(number, time, one.load, sensors, f"{where}, drop {number}")  # type: ignore[arg-type]
        )
    return _point(source, point, drops, *left_out)


def _point(source: _Source, point: PointFacts, drops: list[Drop], *remarks: str) -> TracePoint:
    suffix = source.file.rpartition(".")[2].lower()
    known = {**source.facts.known, **{k: v for k, v in point.known.items() if v is not None}}
    known["point"] = point.name
    known["source"] = f"Rincent project (.{suffix}), {source.channels} channels"
    return point_of(
        source.file,
        known,
        drops,
        source.request,
        noted=point.noted,
        remarks=(*source.remarks, *remarks),
    )
