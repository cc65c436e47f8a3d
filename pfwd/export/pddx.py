"""Format ``pddx``: peak loads and deflections in AASHTO's Pavement Deflection Data Exchange, 2.0.

Sections and keys are those of public files of version 1.0. Version 2.0 is appendix C of
FHWA-HRT-07-040, of which only the introduction was available: sections with descriptive names,
entries as in .INI files, few changes from 1.0. Four things could not be verified: the required
keys, the form of traces (none are written), the first number of a drop (0 or 1), and the
mark of a comment. The format has no moduli.
"""

import datetime
import os
from collections.abc import Iterator
from itertools import groupby

from pfwd.errors import SurveyError, refusal
from pfwd.export.output import new_text_file
from pfwd.export.rows import Order, Row
from pfwd.files.editing import later_declarations
from pfwd.judging.places import number
from pfwd_device.recording.drop_file import software_version

VERSION = "2.0"
DELIMITER = ","

_ENGLISH_MONTHS = (
    *("Jan", "Feb", "Mar", "Apr", "May", "Jun"),
    *("Jul", "Aug", "Sep", "Oct", "Nov", "Dec"),
)
_REMARKS = (
    "Sections and keys as in public files of PDDX 1.0; not verified against the text of the "
    "standard 2.0 (FHWA-HRT-07-040, appendix C).",
    "DropData: peaks of the traces as recorded, offsets removed, with whatever response of the "
    "geophones they carry; deflections downward positive. DropDeflectionCorrected: that of the "
    "centre with the declared response taken out, by which points are judged.",
    "DropKind: seating, measured or rejected (a rebound, a false trigger); only measured drops are "
    "averaged. PointValue, PointTarget (kPa or micron) and PointVerdict belong to the procedure "
    "named; a value with PointValueNotSupported decides nothing. These keys are not of the "
    "standard. Time histories are not in this file.",
)


def write_pddx(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write the peaks of all drops that have peaks and are not discarded.

    A file has one plate and one set of sensors. Drops with another plate or other sensors go to
    further files, numbered from 2.

    Parameters
    ----------
    order : Order
    path : path of the first file

    Returns
    -------
    list of str
        One sentence for each omission, and a note that the layout was not verified.

    Raises
    ------
    SurveyError
        If no drop has peaks.
    """
    rows = order.rows
    # Drops on a rig of springs have no deflection of a pavement.
    on_rig = sum(row.values["kind"] == "stiffness" for row in rows)
    rows = [row for row in rows if row.values["kind"] != "stiffness"]
    used = [row for row in rows if row.used and row.drop.peaks is not None]
    if not used:
        drops = f"{on_rig} on a rig" if on_rig else "none"
        raise SurveyError(refusal(order.content.path, "drops with peaks to export", drops))
    groups: dict[tuple[float, tuple[float, ...]], list[Row]] = {}
    for row in used:
        groups.setdefault(_configuration(order.content.path, row), []).append(row)
    notes = ["the layout was not verified against the text of the PDDX 2.0 standard"]
    name, ending = os.path.splitext(os.fspath(path))
    for count, (configuration, group) in enumerate(groups.items(), start=1):
        file = name + ending if count == 1 else f"{name}-{count}{ending}"
        with new_text_file(file, force=order.force, newline="\r\n") as stream:
            for line in _lines(os.path.basename(file), group, configuration):
                stream.write(line + "\n")
        if len(groups) > 1:
            radius, offsets = configuration
            notes.append(
                f"{file}: {len(group)} drops of the plate of {radius:g} m with "
                f"{len(offsets)} sensor{'s' if len(offsets) > 1 else ''}; a file has one device"
            )
    if on_rig:
        notes.append(f"{on_rig} drops on a rig are left out")
    if len(used) < len(rows):
        notes.append(f"{len(rows) - len(used)} discarded or incomplete drops are left out")
    return notes


def _lines(
    name: str, rows: list[Row], configuration: tuple[float, tuple[float, ...]]
) -> Iterator[str]:
    radius, offsets = configuration
    first = rows[0].values
    yield from _section(
        "Pavement Deflection Data Exchange File",
        PDDXVersionNumber=VERSION,
        DelimiterSymbol=DELIMITER,
        DecimalSymbol=".",
    )
    yield from _section(
        "Units",
        LoadPlateRadiusUnits="millimeter",
        LoadUnits="kilo-Newton",
        DeflectionUnits="micron",
        TemperatureUnits="Celsius",
        SensorLocationUnits="millimeter",
        GPSUnits="degree,degree,meter",
        TestLocationUnits="kilometer,meter,meter",
    )
    moments = sorted(moment for row in rows if (moment := _moment(row)) is not None)
    yield from _section(
        "Operations Information",
        FileName=_text(name),
        StartDate=_date(moments[0]) if moments else None,
        EndDate=_date(moments[-1]) if moments else None,
        OperatorName=_text(first["operator"]),
    )
    yield from _section(
        "Device Information",
        DeviceDesignationName="PFWD",
        DeviceSerialNumber=_text(first["device"]),
        DeviceLoadType="Impulse",
    )
    yield from _section(
        "Device Configuration",
        LoadPlateRadius=f"{radius * 1e3:g}",
        NumberOfDeflectionSensors=str(len(offsets)),
        DeflectionSensorXAxisDistances=DELIMITER.join(f"{offset * 1e3:g}" for offset in offsets),
        DeflectionSensorYAxisDistances=DELIMITER.join("0" for _ in offsets),
    )
    yield from _section("Location Identification", SiteName=_text(first["site"]))
    points = groupby(rows, key=lambda row: row.point.name)
    for index, (_, group) in enumerate(points, start=1):
        yield from _location(index, list(group))
    # Comments come last, because a reader may not support them.
    yield from (f"; {line}" for line in (f"pfwd {software_version()}", *_REMARKS))


def _location(index: int, rows: list[Row]) -> Iterator[str]:
    place = next((row.place for row in rows if row.place is not None), None)
    moment = next((time for row in rows if (time := _moment(row)) is not None), None)
    where = None
    if place is not None:
        degrees = f"{place.latitude:.8f}{DELIMITER}{place.longitude:.8f}"
        where = f"{degrees}{DELIMITER}{place.altitude or 0:g}"
    # The chainage in the imported file, m.
    imported = (rows[0].drop.declared or {}).get("imported")
    chainage = number(imported.get("chainage_m")) if isinstance(imported, dict) else None
    drops: dict[str, str | None] = {}
    kinds = dict(rows[0].point.progress.kinds)
    for count, row in enumerate(rows, start=1):
        peaks = row.drop.peaks
        assert peaks is not None
        numbers = [peaks.load / 1e3, *(peak * 1e6 for _, peak in peaks.displacements)]
        drops[f"DropData_{count}"] = DELIMITER.join(f"{figure:.2f}" for figure in numbers)
        drops[f"DropKind_{count}"] = kinds.get(row.drop.number)
        corrected = row.values["deflection_corrected_m"]
        if corrected is not None:
            drops[f"DropDeflectionCorrected_{count}"] = f"{corrected * 1e6:.2f}"
    yield from _section(
        f"Test Location {index}",
        TestLocation=None if chainage is None else f"{chainage / 1e3:g},0,0",
        GPSLocation=where,
        TestTime=None if moment is None else f"{moment:%H:%M:%S}",
        TestComment=_text(rows[0].point.title),
        **_verdict_entries(rows[0]),
        NumberOfDrops=str(len(rows)),
        **drops,
    )


def _verdict_entries(row: Row) -> dict[str, str | None]:
    """Return procedure, value, target and verdict of a point as entries of its section."""
    values = row.values
    scale = 1e6 if values["unit"] == "m" else 1e-3

    def scaled(key: str) -> str | None:
        value = number(values[key])
        return None if value is None else f"{value * scale:.2f}"

    return {
        "PointProcedure": _text(values["procedure"]),
        "PointQuantity": _text(values["quantity"]),
        "PointValue": scaled("value"),
        "PointValueNotSupported": _text(values["value_not_supported"]),
        "PointTarget": scaled("target"),
        "PointVerdict": _text(values["verdict"]),
    }


def _section(name: str, **entries: str | None) -> Iterator[str]:
    yield f"[{name}]"
    for key, value in entries.items():
        if value is not None:
            yield f"{key} = {value}"
    yield ""


def _configuration(where: str, row: Row) -> tuple[float, tuple[float, ...]]:
    """Return the plate radius and the offsets of the sensors of a drop, m."""
    peaks, point = row.drop.peaks, row.point.source
    assert peaks is not None
    assert point is not None
    declared = {**(row.drop.declared or {}), **later_declarations(point)}
    radius = number(declared.get("plate_radius_m"))
    if radius is None:
        hint = "pfwd edit --set plate_radius_m=..."
        raise SurveyError(refusal(where, "a plate radius", f"none in {row.point.title}", hint))
    return radius, tuple(offset for offset, _ in peaks.displacements)


def _moment(row: Row) -> datetime.datetime | None:
    try:
        return datetime.datetime.fromisoformat(str(row.values["time_utc"])).replace(tzinfo=None)
    except ValueError:
        return None


def _date(moment: datetime.datetime) -> str:
    # strftime would use the language of the system.
    return f"{moment.day:02d}-{_ENGLISH_MONTHS[moment.month - 1]}-{moment.year:04d}"


def _text(value: object) -> str | None:
    """Return a text without the delimiter, which would end its entry."""
    return None if value is None else str(value).replace(DELIMITER, " ").strip() or None
