"""Tests and modules that docs/security.md names exist."""

import re
from pathlib import Path

TOP = Path(__file__).resolve().parents[1]


def test_every_attack_in_the_document_names_a_test_that_exists() -> None:
    text = (TOP / "docs" / "security.md").read_text(encoding="utf-8")
    rows = [
        line
        for line in text[text.index("## Attacks that the tests try") :].splitlines()
        if "|" in line
    ]
    for row in rows[2:]:
        _, attack, happens, tests, _ = (cell.strip() for cell in row.split("|"))
        assert attack
        assert happens
        named = re.findall(r"`(tests/[\w/]+\.py)`", tests)
        assert named or tests == "the same", row
        for name in named:
            assert (TOP / name).is_file(), name


def test_the_files_that_the_document_names_exist() -> None:
    text = (TOP / "docs" / "security.md").read_text(encoding="utf-8")
    for name in re.findall(r"`(pfwd_\w+/[\w/]+\.py)`", text):
        assert (TOP / name).is_file(), name
