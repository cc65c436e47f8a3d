"""Fill a workbook of the user with a survey: ``pfwd report SURVEY --template T.xlsx``.

A cell is filled when it has a name (one of Excel's defined names) or holds ``{{ name }}``. Of the
survey there are single values; ``points.value``, or the name ``points_value``, fills the cell and
those below it, a row a point, with the look of the first; ``drops.peak_load_n`` does so with a row
a drop. A unit may follow: ``{{ points.value | MPa }}``, or ``points_value_MPa``.
"""

import os
import re
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from copy import copy
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

from inversion.notices import text_of
from pfwd.errors import OptionError, quote, refusal
from pfwd.export.rows import judged_values
from pfwd.export.tables import FORMULA_STARTS
from pfwd.export.workbook import as_date
from pfwd.judging import DropView, PointView
from pfwd.report.content import Report
from pfwd.report.point_facts import (
    diagnosis_of,
    local_time,
    names_text,
    time_of,
    used_drops,
    verdict_of,
)
from pfwd_device.text import harmless

MAX_TEMPLATE_BYTES = 20_000_000
"""Size of a template; forms with a logo have some 100,000 bytes."""

MAX_UNPACKED_BYTES = 200_000_000
"""Size of the unpacked workbook; a hostile archive unpacks to more than memory holds."""

SCALES = {
    "Pa": 1.0,
    "kPa": 1e-3,
    "MPa": 1e-6,
    "N": 1.0,
    "kN": 1e-3,
    "m": 1.0,
    "mm": 1e3,
    "um": 1e6,
    "s": 1.0,
    "ms": 1e3,
    "percent": 1e2,
    "mm_s": 1e3,
}
"""Factor from SI to each unit that a template may request, by its name."""

_TEMPLATE_FIELD = re.compile(r"\{\{\s*([A-Za-z_][\w.]*)\s*(?:\|\s*(\w+)\s*)?\}\}")

Value = Any
Values = Mapping[str, Value]


def fill_template(
    report: Report, template: str | os.PathLike[str], company: str | None = None
) -> tuple[bytes, list[str]]:
    """Return the bytes of the filled workbook, and the filled cells.

    Parameters
    ----------
    report : Report
    template : path of an .xlsx file
    company : str, optional
        Name of the company.

    Returns
    -------
    bytes
    list of str
        As ``Sheet!B3``.

    Raises
    ------
    OptionError
        If it is no workbook, or names something that no report has.
    """
    book = _open(template)
    filler = _Filler(report, os.fspath(template), company)
    filler.fill_names(book)
    for sheet in book.worksheets:
        filler.fill_sheet(sheet)
    if not filler.filled:
        examples = ", ".join([*list(filler.survey)[:4], "points.value"])
        expected = f"named cells or {{{{ }}}} such as {examples}"
        raise OptionError(refusal(f"--template {template}", expected, "none"))
    stream = BytesIO()
    book.save(stream)
    return stream.getvalue(), filler.filled


def _open(template: str | os.PathLike[str]) -> Any:
    from openpyxl import load_workbook

    where = f"--template {template}"
    try:
        size = Path(template).stat().st_size
        if size > MAX_TEMPLATE_BYTES:
            raise OptionError(refusal(where, f"at most {MAX_TEMPLATE_BYTES} bytes", str(size)))
        with ZipFile(template) as archive:
            unpacked = sum(item.file_size for item in archive.infolist())
        if unpacked > MAX_UNPACKED_BYTES:
            expected = f"at most {MAX_UNPACKED_BYTES} bytes, unpacked"
            raise OptionError(refusal(where, expected, str(unpacked)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # on parts that it drops, such as pivot tables
            return load_workbook(template)
    except OSError as err:
        problem = err.strerror or "something else"
        raise OptionError(refusal(where, "a workbook (.xlsx)", problem)) from err
    except OptionError:
        raise
    except (BadZipFile, KeyError, ValueError, TypeError, SyntaxError) as err:
        hint = "save it as .xlsx"
        raise OptionError(refusal(where, "a workbook (.xlsx)", "another file", hint)) from err


class _Filler:
    """Fills the cells of a workbook that have or contain a name of `docs/reports.md`."""

    def __init__(self, report: Report, template: str, company: str | None) -> None:
        self._where = f"--template {template}"
        self.survey = {**survey_values(report), "company": company}
        self._rows = {
            "points": [point_values(point) for point in report.points],
            "drops": [drop_values(p, drop) for p in report.points for drop in p.drops],
        }
        self._keys = {
            "points": list(point_values(report.points[0])),
            "drops": list(drop_values(report.points[0], report.points[0].drops[0])),
        }
        self.filled: list[str] = []

    def fill_names(self, book: Any) -> None:
        """Fill the cells with a defined name of the workbook or of one of its sheets."""
        for names in (book.defined_names, *(sheet.defined_names for sheet in book.worksheets)):
            for name, defined in names.items():
                key, unit = self._of_name(name)
                if key is None:
                    continue  # a name of the workbook's own
                for title, place in defined.destinations:
                    if title in book.sheetnames:
                        cell = book[title][place.replace("$", "").split(":")[0]]
                        self._fill(cell, key, unit)

    def _of_name(self, name: str) -> tuple[str | None, str | None]:
        """Return the key and the unit that a defined name stands for."""
        if name in self.survey:
            return name, None
        for kind, keys in self._keys.items():
            rest = name.removeprefix(f"{kind}_")
            if rest == name:
                continue
            if rest in keys:
                return f"{kind}.{rest}", None
            key, _, unit = rest.rpartition("_")
            if key in keys and unit in SCALES:
                return f"{kind}.{key}", unit
        return None, None

    def fill_sheet(self, sheet: Any) -> None:
        """Fill the cells that hold a name in double braces."""
        for row in list(sheet.iter_rows()):
            for cell in row:
                text = cell.value
                if not isinstance(text, str) or "{{" not in text:
                    continue
                fields = list(_TEMPLATE_FIELD.finditer(text))
                if len(fields) == 1 and fields[0].span() == (0, len(text.strip())):
                    self._fill(cell, fields[0][1], fields[0][2])
                elif fields:
                    self._fill_text(cell, text)

    def _fill_text(self, cell: Any, text: str) -> None:
        def value_text(match: re.Match[str]) -> str:
            value = _scaled(self._single(match[1], cell), match[2], self._at(cell))
            return (
                "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
            )

        _put(cell, _TEMPLATE_FIELD.sub(value_text, text))
        self.filled.append(self._name(cell))

    def _fill(self, cell: Any, key: str, unit: str | None) -> None:
        kind, _, column = key.partition(".")
        if kind not in self._rows or not column:
            _put(cell, _scaled(self._single(key, cell), unit, self._at(cell)))
            self.filled.append(self._name(cell))
            return
        if column not in self._keys[kind]:
            self._refuse(cell, key, [f"{kind}.{name}" for name in self._keys[kind]])
        sheet, style = cell.parent, cell._style
        for number, values in enumerate(self._rows[kind]):
            below = sheet.cell(row=cell.row + number, column=cell.column)
            _put(below, _scaled(values[column], unit, self._at(cell)))
            if number:
                below._style = copy(style)
        self.filled.append(self._name(cell))

    def _single(self, key: str, cell: Any) -> Value:
        if key not in self.survey:
            hint = [*self.survey, "points.value", "drops.modulus_pa"]
            self._refuse(cell, key, hint)
        return self.survey[key]

    def _refuse(self, cell: Any, key: str, names: Sequence[str]) -> None:
        expected = f"one of {', '.join(names)}"
        raise OptionError(refusal(self._at(cell), expected, quote(key)))

    def _at(self, cell: Any) -> str:
        return f"{self._where}, {self._name(cell)}"

    def _name(self, cell: Any) -> str:
        return f"{harmless(cell.parent.title)}!{cell.coordinate}"


def _scaled(value: Value, unit: str | None, where: str) -> Value:
    if unit is None:
        return value
    if unit not in SCALES:
        raise OptionError(refusal(where, f"a unit among {', '.join(SCALES)}", quote(unit)))
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return value * SCALES[unit] if number else value


def _put(cell: Any, value: Value) -> None:
    """Write a value into a cell; a text that begins with = stays text."""
    if isinstance(value, str):
        cell.value = harmless(value)
        cell.data_type = "s"
        if value.lstrip(" ").startswith(FORMULA_STARTS):
            cell.quotePrefix = True
    else:
        cell.value = value


def survey_values(report: Report) -> Values:
    """Return the values of the survey by key."""
    points = [point for point in report.points if not point.discarded]
    counts = Counter(verdict_of(point) for point in points)
    times = sorted(filter(None, map(time_of, report.points)))
    procedure = report.procedure if report.chosen else None
    first = report.instruments[0] if report.instruments else {}
    channels = first.get("channels") or ()
    calibrated = [str(c["calibrated"]) for c in channels if c.get("calibrated")]
    setups = [point.setup for point in report.points]

    return {
        "title": report.title,
        "survey": report.survey_name,
        "survey_id": report.survey_id,
        "site": names_text(setup.site for setup in setups) or None,
        "operator": names_text(setup.operator for setup in setups) or None,
        "device": names_text(setup.device for setup in setups) or first.get("model"),
        "serial_number": first.get("serial_number"),
        "calibrated": as_date(min(calibrated)) or min(calibrated) if calibrated else None,
        "procedure": None if procedure is None else procedure.name,
        "procedure_title": None if procedure is None else procedure.title,
        "quantity": str(report.procedure.quantity),
        "unit": report.procedure.quantity.unit,
        "plate_radius_m": setups[0].plate_radius if setups else None,
        "first_time": as_date(times[0]) if times else None,
        "last_time": as_date(times[-1]) if times else None,
        "made": as_date(report.made),
        "software": report.software,
        "points_count": len(points),
        "drops_count": sum(len(point.drops) for point in points),
        "passed": counts["pass"],
        "failed": counts["fail"],
        "undecided": counts["undecided"],
        "without_target": counts["none"],
    }


def point_values(point: PointView) -> Values:
    """Return the values of a point: those of the exports, and its settlements."""
    progress, place = point.progress, point.place or {}
    used, diagnosis = used_drops(point), diagnosis_of(point)
    values = judged_values(point)
    if progress.value is None:
        values |= {"quantity": None, "unit": None}
    depths = [drop.facts.peak_deflection for drop in used]
    recorded = [depth for depth in depths if depth is not None]
    speeds = [v for drop in used if (v := drop.facts.peak_velocity) is not None]
    imported = point.setup.extra.get("imported")
    noted = imported if isinstance(imported, Mapping) else {}
    return {
        "point": point.shown_name,
        "chainage_m": noted.get("chainage_m"),
        "latitude": place.get("latitude"),
        "longitude": place.get("longitude"),
        "altitude_m": place.get("altitude_m"),
        "time_local": as_date(time_of(point)),
        **values,
        "diagnosis": None if diagnosis is None else diagnosis.verdict,
        "discarded": point.discarded,
        "note": "; ".join(point.notes) or None,
        **{f"s{n}_m": depths[n - 1] if len(depths) >= n else None for n in (1, 2, 3)},
        "s_mean_m": sum(recorded) / len(recorded) if recorded else None,
        "v_mean_m_s": sum(speeds) / len(speeds) if speeds else None,
        "s_over_v_s": progress.s_over_v,
        "material": point.setup.material,
        "moisture_percent": point.setup.moisture,
        "temperature_c": point.setup.temperature,
    }


def drop_values(point: PointView, drop: DropView) -> Values:
    """Return the values of a drop by key."""
    facts = next(facts for facts in point.facts if facts.number == drop.number)
    result = drop.result
    kinds = dict(point.progress.kinds)
    low, high = (None, None)
    if result is not None and result.modulus_interval_pa is not None:
        low, high = result.modulus_interval_pa
    equivalent_low, equivalent_high = facts.equivalent_interval or (None, None)
    top, bottom = facts.modulus_depth or (None, None)
    return {
        "point": point.shown_name,
        "drop": drop.number,
        "kind": str(kinds.get(drop.number, facts.kind)),
        "time_local": as_date(local_time(drop)),
        "peak_load_n": facts.peak_load,
        "deflection_corrected_m": facts.peak_deflection,
        "pulse_duration_s": facts.pulse_duration,
        "modulus_pa": None if result is None or result.modulus_pa is None else facts.modulus,
        "modulus_interval_low_pa": low,
        "modulus_interval_high_pa": high,
        "modulus_depth_from_m": top,
        "modulus_depth_to_m": bottom,
        "equivalent_modulus_pa": facts.equivalent_modulus,
        "equivalent_modulus_interval_low_pa": equivalent_low,
        "equivalent_modulus_interval_high_pa": equivalent_high,
        "reason": text_of(facts.reason) or None,
        "note": "; ".join(drop.notes) or None,
    }
