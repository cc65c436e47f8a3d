"""``database.json`` of Rincent's programs: of the acquisition, and of the viewer."""

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

from inversion.notices import Notice
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.common import finite, short_text, temperature_of
from pfwd.files.foreign.rincent_facts import (
    Facts,
    PointFacts,
    StoredPeaks,
    named,
    point_facts,
    project_facts,
)
from pfwd.files.header import LONGEST_REMARK
from pfwd_device.recording.payload import json_excess

Table = Mapping[str, Any]

_POSITION = re.compile(r"D(-?\d{1,5})")
"""Name of a deflection: the position of its sensor in mm."""

LOADS, DEFLECTION = ("Load", "Fmax"), "Umax"
DURATIONS = ("PulseTime", "Time pulse")
"""Names of peak load (N), of the deflection of a machine with one sensor (m), and of the duration
of the pulse (s). They differ between machines and between versions of their programs."""


def read_json(data: bytes, where: str) -> Facts:
    """What a ``database.json`` says.

    Parameters
    ----------
    data : bytes
    where : str
        File and member, for messages.

    Raises
    ------
    TraceError
        If it is no such database, or says neither sampling rate nor pre-trigger.
    """
    if (problem := json_excess(data)) is not None:  # the largest one seen has under 1 MB
        raise TraceError(f"{where}: {problem}")
    remarks: tuple[Notice, ...] = ()
    try:
        text = data.decode("utf-8-sig")  # .NET writes a byte order mark
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
        remarks = (Notice("json-not-utf-8", {"file": where}),)
    try:
        # Not strict: a comment may hold the end of a line as it was typed.
        database = json.loads(text, strict=False)
    except (ValueError, RecursionError) as err:
        raise TraceError(refusal(where, "JSON", quote(str(err)))) from err
    if isinstance(database, dict) and "project" in database:
        return _viewer(_table(database, "project"), where, remarks)
    if isinstance(database, dict) and "base" in database and "distinct" in database:
        # Of viewers before 2023, which had no level of the project.
        return _viewer(database, where, remarks)
    if isinstance(database, dict) and "ParamsAcqu" in database:
        return _acquisition(database, where, remarks)
    came = ", ".join(map(str, database)) if isinstance(database, dict) else "no object"
    raise TraceError(refusal(where, "a database with ParamsAcqu, project or base", quote(came)))


def _acquisition(database: Table, where: str, remarks: tuple[Notice, ...]) -> Facts:
    acquired = _table(database, "ParamsAcqu")
    bearing, calibrated = _table(database, "ParamsBearing"), _table(database, "Calibrations")
    hardware = _table(database, "Hardware", "Machines")
    project = _table(database, "Project", "Dossiers")
    machine = short_text(hardware.get("TypeMachineName")) or short_text(
        _table(database, "Database").get("Software")
    )
    points = []
    for entry in _tables(database.get("PVs")):
        report = _table(entry, "PV", "PVs") or entry
        for one in _tables(entry.get("Points")):
            points.append(_acquired_point(one, report))
    return project_facts(
        where,
        points,
        rate=(acquired.get("FreqAcqu"), "FreqAcqu (Hz)"),
        pre_trigger=(acquired.get("PreTrig"), "PreTrig (s)"),
        diameter=_diameter(bearing.get("DPlate"), calibrated.get("Dplate")),
        poisson_ratio=bearing.get("CPoisson"),
        seating=_table(database, "ParamsPoint").get("NbTraining"),
        device=named(machine, short_text(hardware.get("Serial"))),
        site=short_text(project.get("Site")) or short_text(project.get("Name")),
        offsets=_offsets(calibrated.get("Channels"), "Type", "Position", "LoadCell"),
        samples=acquired.get("NbSamples"),
        remarks=remarks,
    )


def _acquired_point(entry: Table, report: Table) -> PointFacts:
    point = _table(entry, "Point", "Points") or entry
    name = short_text(report.get("Name")) or short_text(report.get("Nom"))
    return point_facts(
        str(point.get("ID", "")),
        named(name, short_text(point.get("Number"))),
        point.get("Date"),
        (point.get("Latitude"), point.get("Longitude")),
        {
            "operator": short_text(report.get("Operator")),
            "temperature_c": temperature_of(report.get("Temperature")),
        },
        _noted(point, point.get("Comments") or point.get("Comment")),
        [_acquired_peaks(drop) for drop in _tables(entry.get("Drops"))],
    )


def _acquired_peaks(drop: Table) -> StoredPeaks:
    said = drop.get("Deflections")
    listed = said if isinstance(said, list) else [drop.get(DEFLECTION)]
    found = [finite(one) for one in listed]
    whole = tuple(one for one in found if one is not None)
    return StoredPeaks(
        _first_number(drop, LOADS),
        whole if len(whole) == len(found) else (),
        _first_number(drop, DURATIONS),
    )


def _viewer(project: Table, where: str, remarks: tuple[Notice, ...]) -> Facts:
    base, distinct = _table(project, "base"), _table(project, "distinct")
    acquired = _table(base, "acquisitionParameters")
    bearing, calibrated = _table(distinct, "bearingParameters"), _table(distinct, "calibrations")
    hardware, about = _labelled(base.get("hardware")), _labelled(base.get("information"))
    machine = short_text(hardware.get("TypeMachineName")) or short_text(project.get("machine"))
    reports = _tables(_table(base, "reports").get("list"))
    points = []
    for report in reports:
        inner = _table(report, "base")
        for zone in _tables(inner.get("zones")):
            for one in _tables(_table(zone, "base").get("points")):
                points.append(_viewed_point(_table(one, "base"), inner))
    return project_facts(
        where,
        points,
        rate=(acquired.get("frequency"), "frequency (Hz)"),
        pre_trigger=(acquired.get("preTrig"), "preTrig (s)"),
        diameter=_diameter(bearing.get("dPlate"), calibrated.get("dPlate")),
        poisson_ratio=bearing.get("cPoisson"),
        seating=_training(reports),
        device=named(machine, short_text(hardware.get("Serial number"))),
        site=short_text(about.get("Site")) or short_text(base.get("name")),
        offsets=_offsets(calibrated.get("channels"), "type", "position", "LoadCell"),
        samples=acquired.get("nbSamples"),
        remarks=remarks,
    )


def _viewed_point(point: Table, report: Table) -> PointFacts:
    place, about = _table(point, "coordinates"), _labelled(point.get("information"))
    operator = _labelled(report.get("information")).get("Operator")
    drops = [_labelled(_table(one, "base").get("data")) for one in _tables(point.get("drops"))]
    names = list(dict.fromkeys(key for drop in drops for key in drop if _POSITION.fullmatch(key)))
    labels = tuple(float(name[1:]) / 1000 for name in names) or None
    return point_facts(
        str(point.get("id", "")),
        named(short_text(report.get("name")), short_text(point.get("number"))),
        point.get("date"),
        (place.get("lat"), place.get("lng")),
        {"operator": short_text(operator)},
        _noted(_labelled(point.get("data")), about.get("Comment")),
        [_viewed_peaks(drop, names) for drop in drops],
        labels,
    )


def _viewed_peaks(drop: Table, names: list[str]) -> StoredPeaks:
    found = [finite(drop.get(name)) for name in names or [DEFLECTION]]
    whole = tuple(one for one in found if one is not None)
    return StoredPeaks(
        _first_number(drop, LOADS),
        whole if len(whole) == len(found) else (),
        _first_number(drop, DURATIONS),
    )


def _first_number(drop: Table, names: tuple[str, ...]) -> float | None:
    return next((n for name in names if (n := finite(drop.get(name))) is not None), None)


def _diameter(first: object, second: object) -> float | None:
    """Of the plate, m: the first that is said. 0 is a test without a plate."""
    found = finite(first)
    return finite(second) if found is None else found


def _noted(data: Table, comment: object) -> dict[str, Any]:
    """What else is kept of a point, under the names that both programs have for it."""
    return {
        "air_temperature_c": finite(data.get("Tair")),
        "surface_temperature_c": finite(data.get("Tsurf")),
        "manual_temperature_c": finite(data.get("Tman")),
        "chainage_m": finite(data.get("Chainage")),
        "position_dop": finite(data.get("DOP")),
        "comment": short_text(comment, LONGEST_REMARK),
    }


def _training(reports: list[Table]) -> int | None:
    """How many of a point's drops the viewer calls training; None when it does not say."""
    for indexes in _found("indexes", reports):
        kinds = [_table(one, "distinct").get("type") for one in _tables(indexes.get("list"))]
        if "Training" in kinds or "Averaging" in kinds:
            return kinds.count("Training")
    return None


def _found(key: str, value: object, depth: int = 12) -> Iterator[Table]:
    """Every object with this key, wherever it stands; where that is differs between versions."""
    if depth == 0:
        return
    if isinstance(value, dict):
        if isinstance(value.get(key), dict):
            yield value[key]
        value = [one for name, one in value.items() if name != "zones"]
    if isinstance(value, list):
        for one in value:
            yield from _found(key, one, depth - 1)


def _offsets(channels: object, kind: str, position: str, load: str) -> tuple[float, ...] | None:
    """Positions of all channels that are no load cell, m; None when the database has none."""
    found = []
    for channel in _tables(channels):
        if channel.get(kind) == load:
            continue
        place = finite(channel.get(position))
        if place is None:
            return None
        found.append(round(place, 6))  # 0.3 in single precision is 0.30000001192092896
    return tuple(found) or None


def _table(parent: Table, *keys: str) -> Table:
    """The first of these that is there: versions of one program name them differently."""
    found = (parent.get(key) for key in keys)
    return next((value for value in found if isinstance(value, dict)), {})


def _tables(value: object) -> list[Table]:
    return [one for one in value if isinstance(one, dict)] if isinstance(value, list) else []


def _labelled(value: object) -> dict[str, Any]:
    """A list of label and value as a table; the first of a label counts.

    What a viewer makes of a number (corrected for temperature, say) comes behind it.
    """
    found: dict[str, Any] = {}
    for one in _tables(value):
        found.setdefault(str(one.get("label")), one.get("value"))
    return found
