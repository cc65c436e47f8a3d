"""Reader of ``database.xml`` in projects of Rincent's Minidyn: tables as XML, raw channels in
base64.

The parser (expat) reads the text as a stream. An XML document type, and with it all entities, is
refused: none of these files has one, and entities can read other files or fill the memory.
"""

import base64
import binascii
import itertools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from xml.parsers import expat

import numpy as np

from inversion.notices import Notice, Value
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.common import (
    Values,
    finite,
    short_text,
    temperature_of,
)
from pfwd.files.foreign.rincent_facts import (
    Facts,
    PointFacts,
    join_name,
    point_facts,
    project_facts,
)
from pfwd_plugins.quantities import Measurand

ROOT = "MDDataSet"
MAX_XML_DEPTH = 32
"""Levels of elements; the format has four."""

MAX_XML_CELLS = 500_000
"""Largest number of rows, columns and attributes; a drop has about twenty."""

MAX_XML_NAME_CHARACTERS = 256
"""Characters of a name; those of the format have up to twenty."""

QUANTITY_BY_SENSOR_TYPE = {1: None, 2: Measurand.VELOCITY, 3: Measurand.DISPLACEMENT}
"""Measured quantity by ``IdTypeCapteur``; None: acceleration, which this program does not read."""

_UNESCAPED_SIGN = re.compile(
    rb"&(?!(?:amp|lt|gt|quot|apos|#[0-9]{1,7}|#x[0-9A-Fa-f]{1,6});)|<(?![A-Za-z_/!?:]|[\x80-\xff])"
)
"""Character that XML requires to be escaped; the maker's program does not escape what users type.
"""

MAX_UNESCAPED_SIGNS = 10_000
"""Characters without escape; users type a few for each point. Each grows from one byte to five."""

_ENCODING = re.compile(rb"<\?xml[^>]{0,200}encoding")

_ATTRIBUTE = re.compile(rb"=\s*[\"']")

Row = Mapping[str, str]
Tables = Mapping[str, list[dict[str, str]]]


@dataclass(frozen=True, eq=False, slots=True)
class RincentDrop:
    """Raw channels of one drop."""

    point: str
    """Identity of its point."""
    number: int
    """Number within the point, from 1."""
    load: Values
    """Load, (n,), N, including the offset of the load cell."""
    quantity: Measurand | None
    """Quantity of the sensor; None: acceleration."""
    sensor: Values
    """Values of the sensor, (n,), m/s or m, including its offset."""


def repair_xml(data: bytes, where: str) -> tuple[bytes, list[Notice]]:
    """Correct encoding and unescaped characters, which the maker's program writes against the
    standard.

    Parameters
    ----------
    data : bytes
        Content of ``database.xml``.
    where : str
        File and member, for remarks.

    Returns
    -------
    data : bytes
    remarks : list of Notice
        Corrections, with file, member and line.
    """
    remarks = []
    if not _ENCODING.match(data) and not data.startswith((b"\xff\xfe", b"\xfe\xff")):
        try:
            data.decode("utf-8")
        except UnicodeDecodeError as err:
            line = data.count(b"\n", 0, err.start) + 1
            remarks.append(Notice("text-not-utf-8", {"file": where, "line": line}))
            data = data.decode("cp1252", errors="replace").encode()
    positions = [
        match.start()
        for match in itertools.islice(_UNESCAPED_SIGN.finditer(data), MAX_UNESCAPED_SIGNS + 1)
    ]
    if 0 < len(positions) <= MAX_UNESCAPED_SIGNS:  # else it is refused as no XML
        line = data.count(b"\n", 0, positions[0]) + 1
        values: dict[str, Value] = {"file": where, "line": line, "sign": chr(data[positions[0]])}
        if len(positions) == 1:
            remarks.append(Notice("sign-not-escaped", values))
        else:
            values["more_places"] = len(positions) - 1
            remarks.append(Notice("signs-not-escaped", values))
        data = _UNESCAPED_SIGN.sub(lambda sign: b"&amp;" if sign[0] == b"&" else b"&lt;", data)
    return data, remarks


def read_tables(data: bytes, where: str) -> Tables:
    """Return the tables of a ``database.xml``.

    Parameters
    ----------
    data : bytes
    where : str
        File and member, for messages.

    Returns
    -------
    mapping of table name to list of rows
        A row maps the names of columns to texts. A nested element has a name such as
        ``Force/Data``.

    Raises
    ------
    TraceError
        If the data are no XML, have a document type, or another root element.
    """
    cells = sum(1 for _ in itertools.islice(_ATTRIBUTE.finditer(data), MAX_XML_CELLS + 1))
    if cells > MAX_XML_CELLS:
        raise TraceError(
            refusal(where, f"at most {MAX_XML_CELLS} values", "more", "import parts of the project")
        )
    reader = _TableReader(where)
    try:
        reader.parser.Parse(data, True)
    except expat.ExpatError as err:
        actual = f"{expat.ErrorString(err.code)} in line {err.lineno}"
        hint = "the file was cut off or damaged: copy it again"
        raise TraceError(refusal(where, "complete XML", actual, hint)) from err
    except (UnicodeError, ValueError, LookupError) as err:
        if isinstance(err, TraceError):
            raise
        raise TraceError(refusal(where, "XML", quote(str(err)))) from err
    return reader.tables


class _TableReader:
    """Handlers of the XML parser, which collect the rows of all tables."""

    def __init__(self, where: str) -> None:
        self.tables: dict[str, list[dict[str, str]]] = {}
        self._where = where
        self._path: list[str] = []
        self._text: list[str] = []
        self._cells = 0
        self.parser = expat.ParserCreate(namespace_separator="}")
        self.parser.buffer_text = True
        self.parser.StartDoctypeDeclHandler = self._refuse_type
        self.parser.EntityDeclHandler = self._refuse_type
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._text.append

    def _refuse_type(self, *_: object) -> None:
        raise TraceError(refusal(self._where, "XML without a document type", "one with entities"))

    def _start(self, name: str, _attributes: object) -> None:
        name = name.rpartition("}")[2]
        if len(name) > MAX_XML_NAME_CHARACTERS:
            raise TraceError(
                refusal(self._where, f"names of at most {MAX_XML_NAME_CHARACTERS}", quote(name))
            )
        self._cells += 1
        if self._cells > MAX_XML_CELLS:
            raise TraceError(
                refusal(self._where, f"at most {MAX_XML_CELLS} rows and columns", "more")
            )
        if not self._path and name != ROOT:
            raise TraceError(refusal(self._where, f"a data set {ROOT}", quote(name)))
        if len(self._path) >= MAX_XML_DEPTH:
            raise TraceError(
                refusal(self._where, f"at most {MAX_XML_DEPTH} levels of elements", "more")
            )
        if len(self._path) == 1:
            self.tables.setdefault(name, []).append({})
        self._path.append(name)
        self._text.clear()

    def _end(self, _name: str) -> None:
        if len(self._path) >= 3:
            text = "".join(self._text).strip()
            if text:
                self.tables[self._path[1]][-1]["/".join(self._path[2:])] = text
        self._path.pop()
        self._text.clear()


def facts_of(tables: Tables, where: str) -> Facts:
    """Return the content of the tables about the project and its points.

    Raises
    ------
    TraceError
        If the points were recorded with different settings.
    """
    acquired = _only(tables, "ParamsAcqu", ("NbSamples", "FreqAcqu", "PreTrig"), where)
    bearing = _only(tables, "ParamsPortance", ("DPlaque", "CPoisson"), where)
    counted = _only(tables, "ParamsPoint", ("NbMiseEnPlace",), where)
    serials = {row["Serial"] for row in tables.get("Machines", []) if "Serial" in row}
    serial = serials.pop() if len(serials) == 1 else None
    reports = {row["ID"]: row for row in tables.get("PVs", []) if "ID" in row}
    places = {row["IdPoint"]: row for row in tables.get("GPSPoints", []) if "IdPoint" in row}
    points = [
        _point(row, reports.get(row.get("IdPV", ""), {}), places.get(row.get("ID", ""), {}))
        for row in tables.get("Points", [])
    ]
    return project_facts(
        where,
        points,
        rate=(acquired.get("FreqAcqu"), "FreqAcqu (Hz)"),
        pre_trigger=(acquired.get("PreTrig"), "PreTrig (s)"),
        diameter=bearing.get("DPlaque"),
        poisson_ratio=bearing.get("CPoisson"),
        seating=counted.get("NbMiseEnPlace"),
        device=join_name("Minidyn", short_text(serial)),
        samples=acquired.get("NbSamples"),
    )


def raw_drops(tables: Tables, where: str) -> list[RincentDrop]:
    """Return the raw channels of every drop, in the order of the file.

    Raises
    ------
    TraceError
        If a channel is cut off or damaged.
    """
    raw = []
    for row in tables.get("Frappes", []):
        if "Force/Data" not in row or "Capteur/Data" not in row:
            continue
        number = finite(row.get("Numero"))
        point = row.get("IdPoint", "")
        if number is None or not 0 <= number < 1e6 or number != int(number):
            actual = quote(row.get("Numero"))
            raise TraceError(refusal(f"{where}, Frappes", "Numero, a whole number from 0", actual))
        place = f"{where}, point {quote(point)[1:-1]}, drop {int(number) + 1}"
        kind = finite(row.get("IdTypeCapteur"))
        if kind not in QUANTITY_BY_SENSOR_TYPE:
            expected = "IdTypeCapteur 1, 2 or 3"
            raise TraceError(refusal(place, expected, quote(row.get("IdTypeCapteur"))))
        load = _numbers(row, "Force", place)
        sensor = _numbers(row, "Capteur", place)
        raw.append(
            RincentDrop(
                point, int(number) + 1, load, QUANTITY_BY_SENSOR_TYPE[int(kind or 0)], sensor
            )
        )
    return raw


def _numbers(row: Row, name: str, where: str) -> Values:
    try:
        # base64 may be divided into lines; any other character is damage.
        text = "".join(row[f"{name}/Data"].split())
        data = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as err:
        raise TraceError(
            refusal(
                where, f"{name} in base64", f"damage ({err})", "the file is damaged: copy it again"
            )
        ) from err
    length = finite(row.get(f"{name}/Length"))
    if len(data) % 8 or (length is not None and length != len(data)):
        expected = "whole numbers of 8 bytes" if length is None else f"{length:.0f} bytes"
        raise TraceError(refusal(where, f"{expected} in {name}", str(len(data))))
    return np.frombuffer(data, "<f8").copy()


def _point(row: Row, report: Row, place: Row) -> PointFacts:
    return point_facts(
        row.get("ID", ""),
        join_name(short_text(report.get("Nom")), short_text(row.get("Numero"))),
        row.get("Date"),
        (place.get("Latitude"), place.get("Longitude")),
        {
            "site": short_text(report.get("Nom")),
            "temperature_c": temperature_of(report.get("Temperature")),
        },
        {"position_dop": finite(place.get("HDOP"))},
    )


def _only(tables: Tables, name: str, keys: tuple[str, ...], where: str) -> Row:
    """Return the row of a table of settings that the points use; {} if the table is missing.

    Other tables refer to it by an ``Id`` column; if they refer to none, all its rows are used.

    Raises
    ------
    TraceError
        If rows in use differ in one of `keys`.
    """
    rows = tables.get(name, [])
    identities = {
        row[f"Id{name}"] for table in tables.values() for row in table if f"Id{name}" in row
    }
    rows = [row for row in rows if row.get("ID") in identities] or rows
    different = {tuple(row.get(key) for key in keys) for row in rows}
    if len(different) > 1:
        expected = f"one set of {', '.join(keys)} for all points"
        hint = "save the points with one setting as a project of their own"
        raise TraceError(refusal(f"{where}, {name}", expected, f"{len(different)}", hint))
    return rows[0] if rows else {}
