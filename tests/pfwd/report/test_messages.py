"""What the program says in English, in the language of a report."""

import re
import tomllib
from dataclasses import replace
from importlib import resources
from pathlib import Path

import pytest

from inversion.notices import OTHER, Notice, Value, gaps_of, templates, terms
from pfwd.message_groups import group_messages, split_numbers
from pfwd.procedures import find_procedure
from pfwd.procedures.profile import CHECKS
from pfwd.report.blocks import Pairs, Paragraph, Table, Together
from pfwd.report.composing import compose
from pfwd.report.fonts import Letters
from pfwd.report.gathering import ReportOptions, gather
from pfwd.report.localising import localised
from pfwd.report.texts import Texts, load_texts

DE, ZH, EN = load_texts("de"), load_texts("zh"), load_texts("en")


def said_by(texts: Texts, message: str) -> str:
    """A warning or other message in a language."""
    (group,) = group_messages([("", message)])
    return texts.grouped(group)


@pytest.mark.parametrize("code", ["de", "zh"])
def test_every_language_has_the_same_messages_with_as_many_numbers(code: str) -> None:
    folder = resources.files("pfwd.report").joinpath("catalogues", "messages")
    tables = {
        name: tomllib.loads(folder.joinpath(f"{name}.toml").read_text(encoding="utf-8"))
        for name in ("de", "zh")
    }
    assert all(tables[code][part].keys() == tables["de"][part].keys() for part in tables["de"])
    for pattern, text in tables[code]["messages"].items():
        assert text.count("{}") == pattern.count("{}"), pattern
        assert split_numbers(pattern.replace("{}", "( )"))[0].count("{}") == 0, pattern
    english = {key: text for key, text in templates().items() if key != OTHER}
    assert tables[code]["warnings"].keys() == english.keys()
    for key, text in tables[code]["warnings"].items():
        assert gaps_of(text).keys() == gaps_of(english[key]).keys(), key
    assert terms().keys() <= tables[code]["words"].keys()


def test_numbers_have_the_decimal_sign_of_the_language() -> None:
    text = Notice("depth-not-unique", {"depth_low_m": 0.484, "depth_high_m": 1.3})
    assert "Fels von 0,48 m bis 1,3 m" in said_by(DE, text)
    assert "0.48 m" in said_by(ZH, text)
    assert said_by(EN, text) == text


def test_what_stands_before_a_message_stays() -> None:
    values: dict[str, Value] = {"traces": "stored_traces", "deviation": (0.0, 0.095)}
    values["file"] = "a-12.prjz, database.json"
    said = Notice("stored-deflection-differs", values)
    assert said_by(DE, said).startswith("a-12.prjz, database.json: die größte Setzung")
    assert "+0,0 bis +9,5 %" in said_by(DE, said)
    assert DE.message(
        "drops 1, 2: peak deflection more than 2 mm (not verified, not enforced)"
    ) == ("Stöße 1, 2: größte Setzung über 2 mm (nicht belegt, nicht angewandt)")
    assert DE.message("nobody said that: 4.5") == "nobody said that: 4.5"
    assert DE.message("moved to point A, drop 3") == "verschoben zum Messpunkt A, Stoß 3"


def test_checks_of_procedures_are_translated() -> None:
    for check in CHECKS.values():
        assert DE.message(check.words) != check.words
    assert DE.title(find_procedure("tp-bf-stb-b8.3").title).endswith("Teil B 8.3")


def test_versions_dates_and_names_keep_their_points() -> None:
    blocks = [
        Paragraph("E 45.5 MPa, pfwd 0.1.0, drop-1.h5, 2024-05-06 08:01:02.5"),
        Pairs((("a", "0.5"), ("b", "0.5"))),
        Table(("x",), (("-1.25",),)),
    ]
    one, two, three = localised(blocks, DE, {"b"})
    assert isinstance(one, Paragraph)
    assert one.text.startswith("E 45,5 MPa, pfwd 0.1.0, drop-1.h5, 2024-05-06")
    assert two == Pairs((("a", "0,5"), ("b", "0.5")))
    assert three == Table(("x",), (("-1,25",),))
    assert localised(blocks, EN) == blocks
    (named,) = localised([Paragraph("station 168.700 has 0.5 mm")], DE, names=["station 168.700"])
    assert named == Paragraph("station 168.700 has 0,5 mm")


def test_warnings_of_all_points_stand_once(survey: Path) -> None:
    report = gather(survey, ReportOptions())
    points = tuple(
        replace(point, warnings=(f"no plate mass: {number}.5 kg is taken", *own))
        for number, (point, own) in enumerate(
            zip(report.points, ((), ("its own: 3",)), strict=True), start=1
        )
    )
    blocks = compose(replace(report, points=points), EN, Letters())
    listed = [item for block in blocks for item in getattr(block, "items", ())]
    assert "no plate mass: 1.5 and 2.5 kg is taken (all 2 points)" in listed
    assert "its own: 3 (point B)" in listed
    pages = [part for block in blocks if isinstance(block, Together) for part in block.blocks]
    said = [part.text for part in pages if isinstance(part, Paragraph)]
    assert sum("its own: 3" in text for text in said) == 1
    assert not any("no plate mass" in text for text in said)


def test_several_processes_find_the_same(survey: Path) -> None:
    alone, shared = (gather(survey, ReportOptions(jobs=jobs)) for jobs in (1, 2))
    assert [p.shown_name for p in shared.points] == [p.shown_name for p in alone.points]
    assert [p.progress.as_dict() for p in shared.points] == [
        p.progress.as_dict() for p in alone.points
    ]
    assert shared.instruments == alone.instruments


@pytest.mark.parametrize("code", sorted(templates().keys() - {OTHER}))
def test_warnings_are_whole_in_every_language(code: str) -> None:
    samples: dict[str, Value] = {
        "": "a.F25", "words": "density", "list": ("one", "two"), "d": 3, "more": 2,
        "terms": tuple(terms()),
    }  # fmt: skip
    forms = gaps_of(templates()[code])
    notice = Notice(code, {name: samples.get(form, 0.25) for name, form in forms.items()})
    english = re.compile(r"\b(the|is|are|of|or|line|left|from|moves|missing|bound|samples)\b")
    for texts in (DE, ZH):
        assert not english.search(said_by(texts, notice)), said_by(texts, notice)
    assert said_by(EN, notice) == notice


def test_drops_of_a_message_are_counted_and_not_listed(survey: Path) -> None:
    limit = "pulse duration less than 15.5 ms (not verified, not enforced)"
    numbers = ", ".join(map(str, range(1, 92)))
    report = gather(survey)
    first, second = report.points
    points = (
        replace(first, warnings=(f"drops {numbers}: {limit}",)),
        replace(second, warnings=(f"drop 3: {limit}",)),
    )
    for texts, expected in (
        (EN, f"{limit} (all 2 points; 92 drops)"),
        (DE, "Stoßdauer unter 15,5 ms (nicht belegt, nicht angewandt) (alle 2 Punkte; 92 Stöße)"),
    ):
        blocks = compose(replace(report, points=points), texts, Letters())
        listed = [item for block in blocks for item in getattr(block, "items", ())]
        assert expected in listed
        assert not any(numbers in item for item in listed)
