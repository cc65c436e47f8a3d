"""Pictures of the screen: equal files for equal screens, with every kind of letter."""

from pathlib import Path

import pytest
from rich.style import Style

from benchmarks.terminal_picture import Run, runs_of, save_picture


def test_runs_have_position_and_style() -> None:
    first, second = runs_of([("ab", Style.parse("bold red on blue")), ("c", None)])
    assert (first.column, first.bold, second.column) == (0, True, 2)
    assert first.background != second.background
    (turned,) = runs_of([("x", Style.parse("#010203 on #040506 reverse"))])
    assert (turned.foreground, turned.background) == ("#040506", "#010203")


@pytest.mark.parametrize("letters", ["E 47.3 MPa", "\u2847", "█▄", "│─┤", "±µ²"])
def test_every_letter_is_drawn(tmp_path: Path, letters: str) -> None:
    def picture(text: str, name: str) -> bytes:
        file = tmp_path / name
        save_picture([[Run(0, text, "#ffffff", "#000000", False, False)]], 12, file)
        return file.read_bytes()

    drawn = picture(letters, "a.svg")
    assert drawn == picture(letters, "b.svg")
    assert drawn != picture(" ", "c.svg")
    assert b"<text" not in drawn  # no font is needed
    assert picture(letters, "d.png").startswith(b"\x89PNG")
