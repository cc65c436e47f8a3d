"""No text of a survey, an instrument or a folder's name reaches a report as it came."""

import contextlib
import dataclasses
import os
import re
import shutil
import unicodedata
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import pypdf
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from inversion.notices import Notice, text_notice, text_of
from pfwd.errors import TraceError
from pfwd.files.editing import Edit, edit_survey
from pfwd.report.blocks import Picture
from pfwd.report.composing import compose
from pfwd.report.content import Report
from pfwd.report.fonts import Letters
from pfwd.report.gathering import ReportOptions, gather
from pfwd.report.html_file import render_html
from pfwd.report.report import write_report
from pfwd.report.texts import load_texts
from pfwd_device.recording import read_survey
from tests.pfwd.report.surveys import flat

ESCAPES = "\x1b]0;owned\x07\x1b[2J\u202e\u2028\u2029\ud800\x00\r\x85\u200b<script>$\\frac{x}$"
"""A terminal's title, a cleared screen, another direction, ends of lines, half a letter."""

HARMFUL = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}

TEXTS = st.text(
    st.one_of(
        st.sampled_from(ESCAPES + "<>&\"'{}%\n\t"), st.characters(categories=list(HARMFUL)),
        st.characters(),
    ),
    max_size=30,
)  # fmt: skip


def harmful_of(text: str) -> set[str]:
    return {letter for letter in text if unicodedata.category(letter) in HARMFUL} - {"\n"}


def with_text(value: Any, text: str, places: list[int]) -> Any:
    """The same with a text before each of its texts; `places` counts them."""
    if isinstance(value, Enum):
        return value
    if isinstance(value, Notice):
        places.append(1)
        return text_notice(f"{text}{text_of(value)}")
    if isinstance(value, str):
        places.append(1)
        return f"{text}{value}"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        for item in dataclasses.fields(value):
            changed = with_text(getattr(value, item.name), text, places)
            with contextlib.suppress(TraceError):  # not every header takes any text
                value = dataclasses.replace(value, **{item.name: changed})
        return value
    if isinstance(value, Mapping):
        return {key: with_text(item, text, places) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return type(value)(with_text(item, text, places) for item in value)
    return value


class Gathered:
    """A report whose representation is short."""

    def __init__(self, report: Report) -> None:
        self.report = report


@pytest.fixture(scope="module")
def gathered(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Gathered:
    """A report with something in every place."""
    folder = tmp_path_factory.mktemp("hostile") / "survey"
    shutil.copytree(made, folder)
    edits = [
        Edit("note", "a note"), Edit("operator", "somebody"),
        Edit("position", {"latitude": 48.1, "longitude": 11.5}), Edit("target", 45e6),
    ]  # fmt: skip
    edit_survey(folder, edits, "A")
    edit_survey(folder, [Edit("note", "of a drop")], "A", 1)
    report = gather(folder, ReportOptions(procedure="astm-e2835"))
    full = dataclasses.replace(
        report, damage=("lost",), check={"zero_n": 1.0, "span_ratio": None, "faults": ["a fault"]}
    )
    return Gathered(full)


@settings(max_examples=12, suppress_health_check=list(HealthCheck), deadline=None)
@given(text=TEXTS)
@example(text=ESCAPES)
def test_whatever_stands_in_every_text_the_page_is_harmless(text: str, gathered: Gathered) -> None:
    places: list[int] = []
    hostile = with_text(gathered.report, text, places)
    assert len(places) > 100
    blocks = compose(hostile, load_texts("en"), Letters())
    page = render_html(
        [b for b in flat(blocks) if not isinstance(b, Picture)], load_texts("en"), "t"
    )
    assert harmful_of(page) == set()
    if harmful_of(text) - set("\t\r"):
        assert page.count("\N{REPLACEMENT CHARACTER}") > 20
    page.encode("utf-8")
    assert "<script" not in page


@pytest.mark.parametrize("ending", ["html", "pdf"])
def test_the_name_of_a_folder_is_made_harmless(ending: str, survey: Path, tmp_path: Path) -> None:
    name = ESCAPES.replace("\x00", "").replace("\ud800", "")
    for letter in '<>"\\|\r\x07':  # which some systems do not take
        name = name.replace(letter, "")
    if os.name == "nt":
        name = re.sub("[\x01-\x1f]", "", name)
    folder = survey.rename(tmp_path / name)
    edit_survey(folder, [Edit("declared", {"site": ESCAPES.replace("\ud800", "")})], "A")
    target = tmp_path / f"report.{ending}"
    report = write_report(folder, target, ReportOptions(title=None, point="A"))
    if ending == "html":
        text = target.read_text(encoding="utf-8")
        (title,) = re.findall("<title>(.*)</title>", text, re.DOTALL)
        assert "\N{REPLACEMENT CHARACTER}" in title
    else:
        pages = pypdf.PdfReader(target).pages
        text = "".join(page.extract_text() for page in pages)
        assert text.startswith("?")  # a letter that no font has
    assert harmful_of(text) == set()
    assert report.title
    assert read_survey(folder).points, "the survey itself is not changed"


def test_lines_stay_lines() -> None:
    from pfwd.report.blocks import Code, Mark, Table

    assert Code("a\r\n\tb\x1b\n").text == "a\n    b\N{REPLACEMENT CHARACTER}\n"
    table = Table(("\x07",), (("\u202e", Mark("pass", "\x00")),), (1,))
    assert harmful_of(repr(table)) == set()
    assert table.right == (1,)
