"""Catalogues of texts, numbers as they are shown, text laid out on pages."""

import json
import math
import re
import tomllib
from pathlib import Path

import pytest

import pfwd.report as package
from pfwd.errors import OptionError
from pfwd.procedures import PointValue, Quantity
from pfwd.report import formatting
from pfwd.report.fonts import Letters
from pfwd.report.texts import _catalogues, _filled_in, languages, load_texts
from pfwd.units import DECLARED, Fact

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
        (
            catalogue(summary=None),
            r"fr\.toml: expected every text, got none for summary; en",
        ),
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
    keys = set()
    for path in Path(package.__path__[0]).glob("*.py"):
        keys |= set(re.findall(r'texts(?:\[|\.say\(\s*)"(\w+)"', path.read_text("utf-8")))
    assert len(keys) > 40
    for key in keys:
        assert EN[key]


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
    from matplotlib.font_manager import FontProperties, findfont

    from pfwd.matplotlib_start import start_matplotlib

    start_matplotlib()
    findfont(FontProperties(family=["no such family at all", "DejaVu Sans"], weight="bold"))
    findfont(FontProperties(family="another family that is not there"))
    assert "findfont" not in caplog.text
