"""Cleaning of foreign text."""

import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfwd_device.text import LONGEST_TEXT, clean

ANY = st.text(st.characters(codec=None)) | st.binary()


@given(text=ANY, limit=st.integers(1, 80))
def test_cleaned_text_fits_on_a_line(text: str | bytes, limit: int) -> None:
    cleaned = clean(text, limit)
    assert len(cleaned) <= limit
    assert len(cleaned.splitlines()) <= 1
    assert not any(unicodedata.category(letter)[0] == "C" for letter in cleaned)
    cleaned.encode()
    assert clean(cleaned, limit) == cleaned


@pytest.mark.parametrize(
    ("text", "cleaned"),
    [
        ("PFWD-7 µm ÄÖ 日本 🦀 [bold]", "PFWD-7 µm ÄÖ 日本 🦀 [bold]"),
        (b"\x1b]0;x\x07", "�]0;x�"),
        ("a\u202eb\u2066c\u200fd", "a�b�c�d"),
        ("one\r\ntwo\u2028three\u2029four\x85", "one��two�three�four�"),
        ("\ud800\ue000\ufeff\U000e0041", "����"),
        ("e\u0301", "é"),
        (b"\xff\xc0\xaf", "���"),
    ],
)
def test_control_characters_are_replaced(text: str | bytes, cleaned: str) -> None:
    assert clean(text) == cleaned


def test_the_length_of_a_text_is_limited_first() -> None:
    assert clean("x" * 1_000_000) == "x" * LONGEST_TEXT
    assert clean("🦀".encode() * 1_000_000) == "🦀" * LONGEST_TEXT
    assert clean(b"\xf0\x9f\xa6" * 1_000_000) == "�" * LONGEST_TEXT
