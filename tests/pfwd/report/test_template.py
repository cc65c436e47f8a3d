"""A workbook of one's own, filled; read back by a program that did not write it."""

import datetime
from pathlib import Path
from typing import Any

import pytest
from openpyxl import Workbook
from openpyxl.workbook.defined_name import DefinedName
from python_calamine import CalamineWorkbook

from pfwd.errors import OptionError
from pfwd.files.editing import Edit, edit_survey
from pfwd.report.report import ReportOptions, write_report
from pfwd_device.recording import read_survey
from tests.pfwd.report.surveys import result_of, save_results

pytestmark = pytest.mark.usefixtures("without_curves")


def template(path: Path, cells: dict[str, Any], names: dict[str, str] | None = None) -> Path:
    book = Workbook()
    sheet = book.active
    sheet.title = "Form"
    for place, value in cells.items():
        sheet[place] = value
    for name, place in (names or {}).items():
        book.defined_names[name] = DefinedName(name, attr_text=f"Form!{place}")
    book.save(path)
    return path


def filled(survey: Path, tmp_path: Path, *form: Any, **options: Any) -> list[list[Any]]:
    made = template(tmp_path / "T.xlsx", *form)
    write_report(survey, tmp_path / "out.xlsx", ReportOptions(template=str(made), **options))
    return CalamineWorkbook.from_path(tmp_path / "out.xlsx").get_sheet_by_index(0).to_python()


def test_cells_in_braces_and_named_cells_are_filled(survey: Path, tmp_path: Path) -> None:
    cells = {
        "A1": "Report {{ title }}: {{points_count}} points",
        "A2": "{{ drops_count }}",
        "A4": "{{ points.point }}",
        "B4": "{{ points.modulus_pa | MPa }}",
        "C4": "{{ points.verdict }}",
    }
    names = {"made": "$B$1", "points_target_MPa": "$D$4", "their_own": "$E$1"}
    rows = filled(survey, tmp_path, cells, names, target=40e6, title="km 12")
    assert rows[0][0] == "Report km 12: 2 points"
    assert isinstance(rows[0][1], datetime.datetime)
    assert rows[1][0] == 8.0
    assert [row[0] for row in rows[3:5]] == ["A", "B"]
    assert rows[3][1] == pytest.approx(45.25, abs=0.05)
    assert [row[2] for row in rows[3:5]] == ["pass", "pass"]
    assert [row[3] for row in rows[3:5]] == [40.0, 40.0]


def test_rows_of_drops_and_the_company(survey: Path, tmp_path: Path) -> None:
    cells = {"A1": "{{ company }}", "A2": "{{ drops.peak_load_n | kN }}", "B2": "{{ drops.kind }}"}
    cells |= {"C2": "{{ drops.pulse_duration_s }}", "D2": "{{ drops.pulse_duration_s | ms }}"}
    rows = filled(survey, tmp_path, cells, company="Muster GmbH")
    assert rows[0][0] == "Muster GmbH"
    assert len(rows) == 1 + 8
    assert rows[1][0] == pytest.approx(8.0, abs=0.1)
    assert (rows[1][1], rows[4][1]) == ("seating", "measured")
    assert rows[1][2] > 0.01
    assert rows[1][3] == pytest.approx(1e3 * rows[1][2])


@pytest.mark.parametrize("kind", ["points", "drops"])
def test_the_equivalent_modulus_has_its_interval_and_the_modulus_its_depth(
    kind: str, survey: Path, tmp_path: Path
) -> None:
    above_rock = {"modulus_depth_m": [0.0, 1.4]}
    saved = read_survey(survey).drops
    save_results(survey, {drop.number: result_of(drop.drop) | above_rock for drop in saved})
    keys = ("equivalent_modulus", "equivalent_modulus_interval_low")
    cells = {
        f"{column}1": f"{{{{ {kind}.{key}_pa | MPa }}}}"
        for column, key in zip("ABC", (*keys, "equivalent_modulus_interval_high"), strict=True)
    }
    cells |= {"D1": f"{{{{ {kind}.modulus_depth_from_m }}}}"}
    names = {f"{kind}_modulus_depth_to_m": "$E$1", f"{kind}_modulus_pa_MPa": "$F$1"}
    *_, last = filled(survey, tmp_path, cells, names)
    equivalent, low, high, top, bottom, modulus = last
    assert (low, equivalent, high) == pytest.approx((0.98 * modulus, modulus, 1.02 * modulus))
    assert (top, bottom) == (0.0, 1.4)


def test_a_note_is_never_a_formula(survey: Path, tmp_path: Path) -> None:
    edit_survey(survey, [Edit("note", "=HYPERLINK(1)")], "A")
    rows = filled(survey, tmp_path, {"A1": "{{ points.note }}"})
    assert rows[0][0] == "=HYPERLINK(1)"


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        ({"A1": "{{ nothing }}"}, r"Form!A1: expected one of title, .* got 'nothing'"),
        ({"B2": "{{ points.nothing }}"}, r"Form!B2: expected one of points.point"),
        ({"A1": "{{ points.value | inch }}"}, "a unit among"),
        ({"A1": "no braces"}, "named cells or"),
    ],
)
def test_an_unknown_key_in_a_template_is_rejected(
    cells: dict[str, str], message: str, survey: Path, tmp_path: Path
) -> None:
    with pytest.raises(OptionError, match=message):
        filled(survey, tmp_path, cells)
    assert not (tmp_path / "out.xlsx").exists()


def test_an_unusable_template_is_rejected(survey: Path, tmp_path: Path) -> None:
    (tmp_path / "T.xlsx").write_bytes(b"PK\x03\x04 no zip")
    for name, options, message in (
        ("out.xlsx", ReportOptions(template=str(tmp_path / "T.xlsx")), "a workbook"),
        ("out.xlsx", ReportOptions(template=str(tmp_path / "none.xlsx")), "no such file"),
        ("out.pdf", ReportOptions(template=str(tmp_path / "T.xlsx")), "--output with .xlsx"),
        ("T.xlsx", ReportOptions(template=str(tmp_path / "T.xlsx")), "another file than the"),
        ("out.xlsx", ReportOptions(), "expected --template"),
    ):
        with pytest.raises(OptionError, match=message):
            write_report(survey, tmp_path / name, options)
