"""TOML that would take minutes is refused first, and none that files of this program hold."""

import contextlib
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfwd.toml_reading import LARGEST_TOML, LONGEST_INTEGER, MOST_KEY_PARTS, parse_toml

TOP = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("a." * MOST_KEY_PARTS + "a = 1", "a key of more than 16 parts"),
        ("[" + "a . " * MOST_KEY_PARTS + "a]", "a key of more than 16 parts"),
        ("x = {" + '"a".' * MOST_KEY_PARTS + "a = 1}", "a key of more than 16 parts"),
        ("x = '''it's'''\n" + "'='." * MOST_KEY_PARTS + "a = 1", "a key of more than 16 parts"),
        ('x = """a\\""""\n' + "a." * MOST_KEY_PARTS + "a = 1", "a key of more than 16 parts"),
        ("x = 0x" + "f" * (LONGEST_INTEGER + 1), "a whole number of more than 64 bits"),
        ("x = 0b" + "1_" * LONGEST_INTEGER + "1", "a whole number of more than 64 bits"),
        ("x = " + "1" * 5000, "digits"),
        ("x = " + "[" * 100_000, "too many nested brackets"),
        ("#" * (LARGEST_TOML + 1), "over 1000000 characters"),
        ("x = 'a", "Expected"),
        ('x = "' + '\\"' * (LARGEST_TOML // 2 - 3), "Unterminated"),
    ],
)
def test_slow_toml_is_rejected(text: str, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        parse_toml(text)


@pytest.mark.parametrize(
    "text",
    [
        "a." * (MOST_KEY_PARTS - 1) + "a = 1",
        "x = '" + "a." * 100 + "'",
        'x = "' + "a." * 100 + '\\""',
        'x = """\n' + "a." * 100 + '\n"quoted" """',
        "x = '''" + "a." * 100 + "''''",
        "# " + "a." * 100,
        "x = 0b" + "1" * LONGEST_INTEGER,
        "x = 0xffff_ffff_ffff_ffff",
        "x = [" + "1.5, " * 1000 + "]",
        "t = 2024-05-06T08:01:02.123Z",
    ],
)
def test_harmless_toml_is_read(text: str) -> None:
    assert parse_toml(text) == tomllib.loads(text)


@given(st.text(alphabet="a.='\"\\#[]{}\n 1", max_size=60))
def test_any_short_text_is_read_as_the_standard_library_reads_it(text: str) -> None:
    try:
        expected = tomllib.loads(text)
    except ValueError:
        with pytest.raises(ValueError, match=r"."):
            parse_toml(text)
        return
    parsed = None
    with contextlib.suppress(ValueError):  # a key of many parts
        parsed = parse_toml(text)
    assert parsed == expected or text.count(".") >= MOST_KEY_PARTS


def test_the_files_of_the_project_are_read() -> None:
    files = [
        *TOP.glob("examples/*.toml"),
        *TOP.glob("pfwd/procedures/**/*.toml"),
    ]
    assert files
    for file in files:
        text = file.read_text(encoding="utf-8")
        assert parse_toml(text) == tomllib.loads(text)
