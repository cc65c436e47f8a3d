"""Messages in the language of a report."""

import re
import tomllib
from dataclasses import replace
from importlib import resources
from pathlib import Path

import pytest

from inversion.notices import (
    OTHER,
    Notice,
    Value,
    gaps_of,
    of_drops,
    templates,
    terms,
    text_notice,
    text_of,
)
from pfwd.report.blocks import Paragraph, Together
from pfwd.report.composing import compose
from pfwd.report.fonts import Letters
from pfwd.report.gathering import ReportOptions, gather
from pfwd.report.texts import load_texts
from tests.records import sample_notice

pytestmark = pytest.mark.usefixtures("without_curves")

DE, ZH, EN = load_texts("de"), load_texts("zh"), load_texts("en")


@pytest.mark.parametrize("code", ["de", "zh"])
def test_every_language_has_every_message_with_its_values(code: str) -> None:
    folder = resources.files("pfwd.report").joinpath("catalogues", "messages")
    tables = {
        name: tomllib.loads(folder.joinpath(f"{name}.toml").read_text(encoding="utf-8"))
        for name in ("de", "zh")
    }
    assert all(tables[code][part].keys() == tables["de"][part].keys() for part in tables["de"])
    for name, table in tables["de"]["procedures"].items():
        assert tables[code]["procedures"][name].keys() == table.keys()
    english = {key: text for key, text in templates().items() if key != OTHER}
    assert tables[code]["messages"].keys() == english.keys()
    for key, text in tables[code]["messages"].items():
        assert gaps_of(text).keys() == gaps_of(english[key]).keys(), key
    assert terms().keys() <= tables[code]["words"].keys()


def test_numbers_have_the_decimal_sign_of_the_language() -> None:
    text = Notice("depth-not-unique", {"depth_low_m": 0.484, "depth_high_m": 1.3})
    assert "Fels von 0,48 m bis 1,3 m" in DE.message(text)
    assert "0.48 m" in ZH.message(text)
    assert EN.message(text) == text_of(text)


def test_a_file_before_a_message_is_kept() -> None:
    values: dict[str, Value] = {"traces": "stored_traces", "deviation": (0.0, 0.095)}
    values["file"] = "a-12.prjz, database.json"
    notice = Notice("stored-deflection-differs", values)
    assert DE.message(notice).startswith("a-12.prjz, database.json: die größte Setzung")
    assert "+0,0 bis +9,5 %" in DE.message(notice)
    limit: dict[str, Value] = {"quantity": "peak_deflection", "limit": 2.0, "unit": "mm"}
    assert DE.message(of_drops(Notice("values-too-large", limit), 1, 2)) == (
        "Stöße 1, 2: größte Setzung über 2 mm (nicht belegt, nicht angewandt)"
    )
    assert DE.message(text_notice("a text of a person: 4.5")) == "a text of a person: 4.5"


def test_warnings_of_all_points_stand_once(survey: Path) -> None:
    report = gather(survey, ReportOptions())
    first, second = (Notice("plate-radius-suspect", {"plate_radius_m": r}) for r in (15.5, 16.0))
    points = (
        replace(report.points[0], warnings=(first,)),
        replace(report.points[1], warnings=(second, text_notice("its own: 3"))),
    )
    blocks = compose(replace(report, points=points), EN, Letters())
    listed = [item for block in blocks for item in getattr(block, "items", ())]
    assert "units suspect: plate_radius_m = 15.5 and 16 (in metres?) (all 2 points)" in listed
    assert "its own: 3 (point B)" in listed
    pages = [part for block in blocks if isinstance(block, Together) for part in block.blocks]
    notice = [part.text for part in pages if isinstance(part, Paragraph)]
    assert sum("its own: 3" in text for text in notice) == 1
    assert not any("units suspect" in text for text in notice)


def test_several_processes_find_the_same(survey: Path) -> None:
    alone, shared = (gather(survey, ReportOptions(jobs=jobs)) for jobs in (1, 2))
    assert [p.shown_name for p in shared.points] == [p.shown_name for p in alone.points]
    assert [p.progress for p in shared.points] == [p.progress for p in alone.points]
    assert shared.instruments == alone.instruments


@pytest.mark.parametrize("code", sorted(templates().keys() - {OTHER}))
def test_warnings_are_complete_in_every_language(code: str) -> None:
    notice = sample_notice(code)
    english = re.compile(r"\b(the|is|are|of|or|line|left|from|moves|missing|bound|samples)\b")
    for texts in (DE, ZH):
        assert not english.search(texts.message(notice)), texts.message(notice)
    assert EN.message(notice) == text_of(notice)


def test_drops_of_a_message_are_counted_and_not_listed(survey: Path) -> None:
    values: dict[str, Value] = {"quantity": "pulse_duration", "limit": 15.5, "unit": "ms"}
    limit = Notice("values-too-small", values)
    numbers = ", ".join(map(str, range(1, 92)))
    report = gather(survey)
    first, second = report.points
    points = (
        replace(first, warnings=(of_drops(limit, *range(1, 92)),)),
        replace(second, warnings=(of_drops(limit, 3),)),
    )
    for texts, expected in (
        (EN, f"{text_of(limit)} (all 2 points; 92 drops)"),
        (DE, "Stoßdauer unter 15,5 ms (nicht belegt, nicht angewandt) (alle 2 Punkte; 92 Stöße)"),
    ):
        blocks = compose(replace(report, points=points), texts, Letters())
        listed = [item for block in blocks for item in getattr(block, "items", ())]
        assert expected in listed
        assert not any(numbers in item for item in listed)
