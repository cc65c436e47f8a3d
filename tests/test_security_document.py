"""Attacks in docs/security.md, each with the tests that try it."""

from pathlib import Path

TOP = Path(__file__).resolve().parents[1]


def test_every_attack_has_a_result_and_a_test() -> None:
    text = (TOP / "docs" / "security.md").read_text(encoding="utf-8")
    table = text[text.index("## Attacks that the tests try") :]
    rows = [line for line in table.splitlines() if "|" in line]
    for row in rows[2:]:
        _, attack, result, tests, _ = (cell.strip() for cell in row.split("|"))
        assert attack
        assert result
        assert "`tests/" in tests or tests == "the same", row
