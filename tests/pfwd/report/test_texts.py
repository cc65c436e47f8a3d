"""Catalogues of texts, numbers as they are shown, text laid out on pages."""

import json
import math
import re
import tomllib
from collections.abc import Iterable
from dataclasses import replace
from importlib import resources
from pathlib import Path

import pytest
from matplotlib.font_manager import FontProperties, findfont

import pfwd.report as package
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
from pfwd.errors import OptionError
from pfwd.matplotlib_start import start_matplotlib
from pfwd.procedures import PointValue, Quantity
from pfwd.report import formatting
from pfwd.report.blocks import Block, Paragraph, Together
from pfwd.report.composing import compose
from pfwd.report.content import Report
from pfwd.report.fonts import Letters
from pfwd.report.gathering import ReportOptions, gather
from pfwd.report.texts import _catalogues, _filled_in, languages, load_texts
from pfwd.units import DECLARED, Fact
from tests.pfwd.report.surveys import flat
from tests.records import sample_notice

EN = load_texts("en")


def plain(text: str) -> str:
    return text.replace("\N{NO-BREAK SPACE}", " ")


def test_the_languages_are_listed() -> None:
    assert languages() == ("de", "en", "zh")
    with pytest.raises(OptionError, match="one of de, en, zh"):
        load_texts("xx")


@pytest.mark.parametrize("code", languages())
def test_every_language_says_everything_and_fills_in_the_same(code: str) -> None:
    reference = tomllib.loads(_catalogues()["en"])
    table = tomllib.loads(_catalogues()[code])
    assert set(table) == set(reference)
    for key, text in table.items():
        assert text, key
        assert _filled_in(text) == _filled_in(reference[key]), key
    if code != "en":
        same = [key for key, text in table.items() if text == reference[key]]
        assert len(same) < len(table) / 5, "it is translated"


def catalogue(**changes: str | None) -> str:
    table = {**tomllib.loads(_catalogues()["en"]), **changes}
    return "\n".join(
        f"{key} = {json.dumps(text)}" for key, text in table.items() if text is not None
    )


def test_a_custom_language_is_a_file(tmp_path: Path) -> None:
    path = tmp_path / "french.toml"
    path.write_text(catalogue(code="fr", summary="Résumé"), "utf-8")
    texts = load_texts(str(path))
    assert texts.code == "fr"
    assert texts["summary"] == "Résumé"
    assert texts["drops"] == EN["drops"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (catalogue(summary=None), r"fr\.toml: expected every text, got none for summary; en"),
        (catalogue(extra="x"), "expected the keys of the English texts, got extra; en"),
        (catalogue(verdicts="{pass} only"), "verdicts: a text with the words in braces of"),
        (catalogue(summary="{summary.__class__}"), "summary: a text with the words in braces"),
        (catalogue(verdicts=EN["verdicts"].replace("{pass}", "{pass:>9999999999}")), "verdicts: "),
        (catalogue(summary="{"), "summary: a text with the words in braces"),
        (catalogue(code="<script>"), 'code: one such as "fr", got'),
        ("summary = ", "expected TOML, got"),
        ("x" * 1_000_001, "at most 1000000 bytes, got more"),
        ("\ud800", "expected TOML, got"),
    ],
)
def test_a_file_that_is_no_language_is_refused(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "fr.toml"
    path.write_bytes(content.encode("utf-8", "surrogatepass"))
    with pytest.raises(OptionError, match=message):
        load_texts(str(path))
    with pytest.raises(OptionError, match="expected a TOML file, got No such file"):
        load_texts(str(tmp_path / "none.toml"))


def test_every_used_text_exists() -> None:
    pattern = r'texts(?:\[|\.say\(\s*)"(\w+)"'
    files = Path(package.__path__[0]).glob("*.py")
    keys = {key for path in files for key in re.findall(pattern, path.read_text("utf-8"))}
    assert len(keys) > 40
    assert all(EN[key] for key in keys)


@pytest.mark.parametrize(
    ("fact", "expected"),
    [
        (Fact("modulus", 45.0312e6, (44.7731e6, 45.2934e6)), "45.03 MPa (44.77 – 45.29)"),
        (Fact("modulus", 45e6, (30e6, 62e6), mark="*"), "45* MPa (30 – 62)"),
        (Fact("modulus", 45e6, (math.nan, 50e6)), "45.0 MPa"),
        (Fact("modulus", None, (17e6, 180e6)), "left open (17 – 180 MPa)"),
        (Fact("density", 1903.0, deviation=6.4), "1903 ± 6 kg/m³"),
        (Fact("depth", None), "–"),
    ],
)
def test_a_fact_breaks_only_before_its_interval(fact: Fact, expected: str) -> None:
    text = formatting.show(fact, EN)
    assert plain(text) == expected
    assert text.count(" ") == expected.count(" (") + ("left open" in text)


def test_a_fact_has_the_words_and_the_sign_of_its_language() -> None:
    fact = Fact("depth", 0.7, note=DECLARED)
    assert plain(formatting.show(fact, load_texts("de"))) == "0,7 m (angegeben)"


def test_a_value_of_a_single_drop_states_that_it_has_no_interval() -> None:
    value = PointValue(Quantity.E_VD, 45e6, None, 1, factor=1.5, plate_radius=0.15, pressure=1e5)
    assert plain(formatting.value_of(value, EN)) == "45.0 MPa (one drop: no interval)"
    assert plain(formatting.value_basis(value, EN)) == "k = 1.5, r = 0.15 m, σ = 100 kPa, n = 1"


def test_a_deflection_is_written_in_millimetres() -> None:
    value = PointValue(Quantity.DEFLECTION, 5.1e-4, (4.9e-4, 5.3e-4), 3)
    assert plain(formatting.value_of(value, EN)) == "0.510 mm (0.490 – 0.530)"
    assert formatting.target_of(6e-4, Quantity.DEFLECTION, EN) == "≤ 0.6 mm"
    assert formatting.target_of(45e6, Quantity.E_VD, EN) == "≥ 45 MPa"


def test_control_characters_have_no_business_on_paper() -> None:
    letters = Letters()
    assert letters.drawable("a\x1b[31m\u202eb\nc") == "a [31m b\nc"
    assert letters.missing == 0


def test_a_family_without_bold_letters_prints_no_lines(
    caplog: pytest.LogCaptureFixture,
) -> None:
    start_matplotlib()
    findfont(FontProperties(family=["no such family at all", "DejaVu Sans"], weight="bold"))
    findfont(FontProperties(family="another family that is not there"))
    assert "findfont" not in caplog.text


# Messages in the language of a report


DE, ZH = load_texts("de"), load_texts("zh")


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


def with_warnings(report: Report, *warnings: tuple[Notice, ...]) -> Report:
    points = zip(report.points, warnings, strict=True)
    return replace(report, points=tuple(replace(point, warnings=w) for point, w in points))


def items_of(blocks: Iterable[Block]) -> list[str]:
    return [item for block in blocks for item in getattr(block, "items", ())]


@pytest.mark.usefixtures("without_curves")
def test_warnings_of_all_points_stand_once(survey: Path) -> None:
    first, second = (Notice("plate-radius-suspect", {"plate_radius_m": r}) for r in (15.5, 16.0))
    report = with_warnings(gather(survey), (first,), (second, text_notice("its own: 3")))
    blocks = compose(report, EN, Letters())
    listed = items_of(blocks)
    assert "units suspect: plate_radius_m = 15.5 and 16 (in metres?) (all 2 points)" in listed
    assert "its own: 3 (point B)" in listed
    pages = flat(block for block in blocks if isinstance(block, Together))
    notes = [part.text for part in pages if isinstance(part, Paragraph)]
    assert sum("its own: 3" in text for text in notes) == 1
    assert not any("units suspect" in text for text in notes)


@pytest.mark.usefixtures("without_curves")
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


@pytest.mark.usefixtures("without_curves")
def test_drops_of_a_message_are_counted_and_not_listed(survey: Path) -> None:
    values: dict[str, Value] = {"quantity": "pulse_duration", "limit": 15.5, "unit": "ms"}
    limit, numbers = Notice("values-too-small", values), range(1, 92)
    report = with_warnings(gather(survey), (of_drops(limit, *numbers),), (of_drops(limit, 3),))
    places = {EN: "(all 2 points; 92 drops)", DE: "(alle 2 Punkte; 92 Stöße)"}
    for texts, place in places.items():
        listed = items_of(compose(report, texts, Letters()))
        assert f"{texts.message(limit)} {place}" in listed
        assert not any(", ".join(map(str, numbers)) in item for item in listed)
