"""Reader of ``database.json`` in Rincent projects, as the acquisition program or the viewer writes
it.
"""

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

from inversion.notices import Notice
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.common import decoded, finite, short_text, temperature_of
from pfwd.files.foreign.rincent_facts import (
    Facts,
    PointFacts,
    StoredPeaks,
    join_name,
    point_facts,
    project_facts,
)
from pfwd.files.header import MAX_REMARK_CHARACTERS
from pfwd_device.recording.payload import json_excess

Table = Mapping[str, Any]

_DEFLECTION_NAME = re.compile(r"D(-?\d{1,5})")
"""Name of a deflection: D and the offset of its sensor in mm."""

LOAD_NAMES, DEFLECTION_LABEL = ("Load", "Fmax"), "Umax"
"""Names of the peak load, N, and of the peak deflection of a machine with one sensor, m."""

DURATION_NAMES = ("PulseTime", "Time pulse")
"""Names of the duration of the load pulse, s; like those of the peaks they differ between machines
and program versions."""


def read_json(data: bytes, where: str) -> Facts:
    """Return the content of a ``database.json``.

    Parameters
    ----------
    data : bytes
        Content of the member.
    where : str
        File and member, for messages.

    Raises
    ------
    TraceError
        If the data are no such database.
    """
    if (problem := json_excess(data)) is not None:  # the largest known database has under 1 MB
        raise TraceError(f"{where}: {problem}")
    text, encoding = decoded(data)
    is_utf_8 = encoding == "utf-8-sig"
    remarks = () if is_utf_8 else (Notice("json-not-utf-8", {"file": where}),)
    try:
        # strict=False accepts comments of users with line ends in them.
        database = json.loads(text, strict=False)
    except (ValueError, RecursionError) as err:
        raise TraceError(refusal(where, "JSON", quote(str(err)))) from err
    if isinstance(database, dict) and "project" in database:
        return _viewer(_table(database, "project"), where, remarks)
    if isinstance(database, dict) and "base" in database and "distinct" in database:
        # Viewers before 2023 wrote the content of "project" without that key.
        return _viewer(database, where, remarks)
    if isinstance(database, dict) and "ParamsAcqu" in database:
        return _acquisition(database, where, remarks)
    actual = ", ".join(map(str, database)) if isinstance(database, dict) else "no object"
    raise TraceError(refusal(where, "a database with ParamsAcqu, project or base", quote(actual)))


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
        for point in _tables(entry.get("Points")):
            points.append(_acquired_point(point, report))
    return project_facts(
        where,
        points,
        rate=(acquired.get("FreqAcqu"), "FreqAcqu (Hz)"),
        pre_trigger=(acquired.get("PreTrig"), "PreTrig (s)"),
        diameter=_diameter(bearing.get("DPlate"), calibrated.get("Dplate")),
        poisson_ratio=bearing.get("CPoisson"),
        seating=_table(database, "ParamsPoint").get("NbTraining"),
        device=join_name(machine, short_text(hardware.get("Serial"))),
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
        join_name(name, short_text(point.get("Number"))),
        point.get("Date"),
        (point.get("Latitude"), point.get("Longitude")),
        {
            "operator": short_text(report.get("Operator")),
            "temperature_c": temperature_of(report.get("Temperature")),
        },
        _noted(point, point.get("Comments") or point.get("Comment")),
        [_stored_peaks(drop, drop.get("Deflections")) for drop in _tables(entry.get("Drops"))],
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
            for point in _tables(_table(zone, "base").get("points")):
                points.append(_viewed_point(_table(point, "base"), inner))
    return project_facts(
        where,
        points,
        rate=(acquired.get("frequency"), "frequency (Hz)"),
        pre_trigger=(acquired.get("preTrig"), "preTrig (s)"),
        diameter=_diameter(bearing.get("dPlate"), calibrated.get("dPlate")),
        poisson_ratio=bearing.get("cPoisson"),
        seating=_training(reports),
        device=join_name(machine, short_text(hardware.get("Serial number"))),
        site=short_text(about.get("Site")) or short_text(base.get("name")),
        offsets=_offsets(calibrated.get("channels"), "type", "position", "LoadCell"),
        samples=acquired.get("nbSamples"),
        remarks=remarks,
    )


def _viewed_point(point: Table, report: Table) -> PointFacts:
    position, about = _table(point, "coordinates"), _labelled(point.get("information"))
    operator = _labelled(report.get("information")).get("Operator")
    drops = [_labelled(_table(drop, "base").get("data")) for drop in _tables(point.get("drops"))]
    names = list(
        dict.fromkeys(key for drop in drops for key in drop if _DEFLECTION_NAME.fullmatch(key))
    )
    labels = tuple(float(name[1:]) / 1000 for name in names) or None
    return point_facts(
        str(point.get("id", "")),
        join_name(short_text(report.get("name")), short_text(point.get("number"))),
        point.get("date"),
        (position.get("lat"), position.get("lng")),
        {"operator": short_text(operator)},
        _noted(_labelled(point.get("data")), about.get("Comment")),
        [_stored_peaks(drop, [drop.get(name) for name in names] or None) for drop in drops],
        labels,
    )


def _stored_peaks(drop: Table, deflections: object) -> StoredPeaks:
    """Return the peaks of a drop.

    Parameters
    ----------
    drop : mapping
        Entry of the drop in the database.
    deflections : object
        List of deflections, m; anything else: the machine has one sensor, whose peak is in `drop`.
    """
    values = deflections if isinstance(deflections, list) else [drop.get(DEFLECTION_LABEL)]
    numbers = [finite(value) for value in values]
    finite_numbers = tuple(number for number in numbers if number is not None)
    return StoredPeaks(
        _first_number(drop, LOAD_NAMES),
        finite_numbers if len(finite_numbers) == len(numbers) else (),
        _first_number(drop, DURATION_NAMES),
    )


def _first_number(drop: Table, names: tuple[str, ...]) -> float | None:
    return next((n for name in names if (n := finite(drop.get(name))) is not None), None)


def _diameter(first: object, second: object) -> float | None:
    """Return the first diameter of the plate that is a number, m; 0: a test without a plate."""
    diameter = finite(first)
    return finite(second) if diameter is None else diameter


def _noted(data: Table, comment: object) -> dict[str, Any]:
    """Return the further data of a point, under names that do not depend on the program."""
    return {
        "air_temperature_c": finite(data.get("Tair")),
        "surface_temperature_c": finite(data.get("Tsurf")),
        "manual_temperature_c": finite(data.get("Tman")),
        "chainage_m": finite(data.get("Chainage")),
        "position_dop": finite(data.get("DOP")),
        "comment": short_text(comment, MAX_REMARK_CHARACTERS),
    }


def _training(reports: list[Table]) -> int | None:
    """Return the number of drops of a point that the maker's program marks as seating ("Training").

    None: the database marks no drops.
    """
    for indexes in _objects_under("indexes", reports):
        kinds = [_table(drop, "distinct").get("type") for drop in _tables(indexes.get("list"))]
        if "Training" in kinds or "Averaging" in kinds:
            return kinds.count("Training")
    return None


def _objects_under(key: str, value: object, depth: int = 12) -> Iterator[Table]:
    """Yield the objects under a key at any depth, because the depth differs between versions."""
    if depth == 0:
        return
    if isinstance(value, dict):
        if isinstance(value.get(key), dict):
            yield value[key]
        value = [child for name, child in value.items() if name != "zones"]
    if isinstance(value, list):
        for child in value:
            yield from _objects_under(key, child, depth - 1)


def _offsets(channels: object, kind: str, position: str, load: str) -> tuple[float, ...] | None:
    """Return the offsets of all channels but load cells, m; None: not in the database."""
    offsets = []
    for channel in _tables(channels):
        if channel.get(kind) == load:
            continue
        position_m = finite(channel.get(position))
        if position_m is None:
            return None
        offsets.append(round(position_m, 6))  # 0.3 in single precision is 0.30000001192092896
    return tuple(offsets) or None


def _table(parent: Table, *keys: str) -> Table:
    """Return the first object under one of several keys, whose names differ between versions."""
    candidates = (parent.get(key) for key in keys)
    return next((value for value in candidates if isinstance(value, dict)), {})


def _tables(value: object) -> list[Table]:
    return [entry for entry in value if isinstance(entry, dict)] if isinstance(value, list) else []


def _labelled(value: object) -> dict[str, Any]:
    """Return a list of objects with ``label`` and ``value`` as one mapping.

    If a label occurs twice, the first value is used: values that the viewer derives, for instance
    corrected for temperature, follow the measured one.
    """
    values: dict[str, Any] = {}
    for entry in _tables(value):
        values.setdefault(str(entry.get("label")), entry.get("value"))
    return values
