"""Files of other programs, built from numbers of our own in the layouts of docs/files.md."""

import base64
import io
import json
import struct
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

SAMPLES = Path(__file__).parents[3] / "data" / "foreign"
Values = NDArray[np.float64]


def sample(name: str) -> str:
    """Return a document or the beginning of a file in the layout of another program."""
    return (SAMPLES / name).read_text(encoding="utf-8")


@dataclass(frozen=True)
class Traces:
    """One drop: load (n,), N, and sensors (channels, n)."""

    load: Values
    sensors: Values


def pulse(
    samples: int = 300,
    rate: float = 15_000.0,
    pre: float = 0.005,
    peak: float = 8000.0,
    channels: int = 1,
    offset: float = 0.0,
) -> Traces:
    """A half-sine load and displacements (or whatever they are taken for) that follow it."""
    time = np.arange(samples) / rate - pre
    shape = np.where((time > 0) & (time < 0.01), np.sin(np.pi * time / 0.01), 0.0)
    rows = [1e-4 * shape / (1 + index) * peak / 8000 for index in range(channels)]
    return Traces(peak * shape + offset, np.array(rows) + offset * 1e-6)


def zipped(members: Mapping[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    """An archive; names are written as they stand, backslashes and all."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, data in members.items():
            info = zipfile.ZipInfo(name)
            info.filename = name  # the constructor would turn what this system separates by
            info.compress_type = method
            archive.writestr(info, data)
    return stream.getvalue()


def stored(
    drops: Sequence[Traces],
    identity: int = 1,
    rate: float | None = None,
    *,
    by_sample: bool = False,
    older: bool = False,
) -> bytes:
    """A member ``rawdata/<id>``; the older layout is big-endian and has no byte with a length."""
    order = ">" if older else "<"
    channels, samples = drops[0].sensors.shape
    data = struct.pack(f"{order}i", 1) + (b"" if older else bytes([15])) + b"ISAANSIMPLEFILE"
    data += struct.pack(f"{order}Ii", 0x8D937355, 1)
    data += struct.pack(f"{order}iqiii", 1, identity, samples, len(drops), channels)
    if rate is not None:
        data += struct.pack(f"{order}d", rate)
    for drop in drops:
        table = drop.sensors.T if by_sample else drop.sensors
        data += struct.pack(f"{order}i", samples) + drop.load.astype(f"{order}f4").tobytes()
        data += struct.pack(f"{order}ii", *table.shape)
        data += np.ascontiguousarray(table, f"{order}f4").tobytes()
    return data


def dataset(
    points: Mapping[str, Sequence[Traces]],
    *,
    rate: float = 15_000.0,
    pre: float = 0.005,
    kind: int = 2,
    more: str = "",
    head: str = "",
) -> bytes:
    """A ``database.xml`` with the first sensor of every drop as raw channel."""

    def row(name: str, **columns: object) -> str:
        cells = "".join(f"<{key}>{value}</{key}>" for key, value in columns.items())
        return f"  <{name}>{cells}</{name}>\n"

    def channel(values: Values) -> str:
        data = values.astype("<f8").tobytes()
        text = base64.encodebytes(data).decode()
        return f"<Length>{len(data)}</Length><Data>{text}</Data>"

    text = sample("dataset.xml").format(rate=rate, pre=pre)
    for number, (identity, drops) in enumerate(points.items(), start=1):
        when = "2024-05-06T10:00:00+02:00"
        text += row("Points", ID=identity, Numero=number, IdPV=7, IdParamsAcqu=3, Date=when)
        text += row("GPSPoints", Latitude=45.5, Longitude=6.25, HDOP=0.7, IdPoint=identity)
        for count, drop in enumerate(drops):
            text += row(
                "Frappes",
                ID=count,
                Numero=count,
                IdPoint=identity,
                IdTypeCapteur=kind,
                Capteur=channel(drop.sensors[0]),
                Force=channel(drop.load),
            )
    body = f'<MDDataSet xmlns="http://tempuri.org/MDDataSet.xsd">\n{text}{more}</MDDataSet>\n'
    return f'<?xml version="1.0" encoding="utf-8"?>\n{head}{body}'.encode()


def acquired(
    points: Mapping[str, Sequence[Traces]],
    *,
    rate: float = 15_000.0,
    pre: float = 0.005,
    offsets: Sequence[float] | None = None,
    **more: Any,
) -> dict[str, Any]:
    """A ``database.json`` of the acquisition."""
    database: dict[str, Any] = json.loads(sample("acquired.json"))
    database["ParamsAcqu"] |= {"FreqAcqu": rate, "PreTrig": pre}
    if offsets is not None:
        del database["ParamsBearing"]
        channels = [{"Type": "LoadCell", "Position": 0.0}]
        channels += [{"Type": "Geophone", "Position": float(np.float32(drop))} for drop in offsets]
        database["Calibrations"] = {"Dplate": float(np.float32(0.3)), "Channels": channels}
    (report,) = database["PVs"]
    (entry,) = report["Points"]
    report["Points"] = []
    for number, (identity, drops) in enumerate(points.items(), start=1):
        point = {"ID": identity, "Number": number, "Chainage": 10.0 * number}
        peaks = [{"Number": n, "Fmax": float(d.load.max())} for n, d in enumerate(drops, start=1)]
        report["Points"].append({"Point": entry["Point"] | point, "Drops": peaks})
    return {**database, **more}


def viewed(
    points: Mapping[str, Sequence[Traces]], *, rate: float = 15_000.0, pre: float = 0.005
) -> dict[str, Any]:
    """A ``database.json`` of the viewer."""
    database: dict[str, Any] = json.loads(sample("viewed.json"))
    base = database["project"]["base"]
    base["acquisitionParameters"] |= {"frequency": rate, "preTrig": pre}
    zone = base["reports"]["list"][0]["base"]["zones"][0]["base"]
    (point,) = zone["points"]
    numbered = enumerate(points, start=1)
    zone["points"] = [{"base": point["base"] | {"id": i, "number": n}} for n, i in numbered]
    return database


def prjz(
    points: Mapping[str, Sequence[Traces]],
    database: Mapping[str, Any],
    *,
    folder: str = "Rawdata\\",
    rate: float | None = None,
    by_sample: bool = False,
) -> bytes:
    """A project with stored traces."""
    members = {"database.json": json.dumps(database).encode("utf-8-sig")}
    for identity, drops in points.items():
        number = int(identity, 16)
        signed = number - (1 << 64) if number >= 1 << 63 else number
        members[folder + identity] = stored(drops, signed, rate, by_sample=by_sample)
    return zipped(members)


def dynz(points: Mapping[str, Sequence[Traces]], **settings: Any) -> bytes:
    """A project with raw channels and with stored traces, which are twice the raw ones."""
    members = {"database.xml": dataset(points, **settings), "database.txt": b"text"}
    members["database.json"] = json.dumps(acquired(points)).encode()
    for identity, drops in points.items():
        doubled = [Traces(2 * drop.load, 2 * drop.sensors) for drop in drops]
        members[f"rawdata/{identity}"] = stored(doubled, int(identity, 16))
    return zipped(members)


def thy(
    drops: Sequence[tuple[int, int, Traces]],
    *,
    step_ms: float = 0.1707,
    digits: int = 4,
    sensors: str = "9",
) -> bytes:
    """A JILS time history; a drop is station, number, and traces in N and m."""
    lines = [
        "Date-Time: 05-06-2024 08:00:00",
        f"Sensors: {sensors}",
        "Weight/spring: 3",
        "Location: Test road",
        "Temp: 68.0",
        "Operator: A. B.",
        "Comments: none",
        "",
    ]
    for station, number, drop in drops:
        columns = " ".join(f"Disp{n}" for n in range(1, len(drop.sensors) + 1))
        lines += [
            f"Station: {station}  Lane: 1  Milepost:   0.000",
            f"Drop # {number}  Desired peak force: 9000.000",
            f"Time Force {columns}",
            f"Impact: 0    Number_of_samples: {drop.load.size}",
        ]
        for row in range(drop.load.size):
            kip = drop.load[row] / 4448.2216152605
            mils = " ".join(f"{-value / 2.54e-5:.6f}" for value in drop.sensors[:, row])
            lines.append(f"{row * step_ms:.{digits}f} {kip:.6f} {mils}")
        lines.append("")
    return "\r\n".join(lines).encode("latin-1")


SENSOR_OFFSETS = "plate_radius_m = 0.15\nsensor_offsets_m = [0.0, 0.3, nan]\n"
"""Header of a JILS file, which names no positions; the third sensor is left out."""


def dat(station: int, drops: Sequence[tuple[float, Sequence[float]]], note: str = "retest") -> str:
    """The lines of a station in a JILS .DAT; loads in N, deflections in m."""
    lines = [
        f"{station} 1   0.000 1 {load / 4448.2216152605:.2f} "
        f"{' '.join(f'{peak / 2.54e-5:.2f}' for peak in moved)}  68.0"
        for load, moved in drops
    ]
    lines += [
        "Drop Sequence Completed Time: 08:36    Air Temp (F): 71.6",
        "GPS: Quality : DGPS Fix   Latitude = 34 deg30.000000  N   Longitude = 89 deg15.000000   W"
        "   PDOP = 1.50",
        f"Note: {note}",
    ]
    return "\n".join(lines) + "\n"


DAT_HEAD = (
    "M5\nDate-Time:  5/13/2019  8:35:57\nSensors: 1, 2, 3\nWeight/spring: 3\n"
    "Location: Test road\nTemp:   68.00\nOperator: A. B.\nComments: \n"
)

SIMPLE_MAP = """
plate_radius_m = 0.15
[time]
column = 1
unit = "s"
[load]
column = 2
unit = "N"
[[sensor]]
column = 3
quantity = "displacement"
unit = "m"
offset_m = 0.0
[text]
names = false
"""
"""Column map of a text with time, load and a displacement."""


def delimited(*columns: Values, separator: str = ",") -> str:
    """Rows of numbers in a text without names."""
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return "\n".join(separator.join(map(repr, row)) for row in rows) + "\n"
