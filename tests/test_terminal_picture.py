"""Pictures of the screen: the same file from the same screen, with every kind of letter drawn."""

from pathlib import Path

import pytest
from rich.style import Style

from benchmarks.terminal_picture import Run, runs_of, save_picture


def test_runs_keep_place_and_look() -> None:
    first, second = runs_of([("ab", Style.parse("bold red on blue")), ("c", None)])
    assert (first.column, first.bold, second.column) == (0, True, 2)
    assert first.background != second.background
    (turned,) = runs_of([("x", Style.parse("#010203 on #040506 reverse"))])
    assert (turned.foreground, turned.background) == ("#040506", "#010203")


@pytest.mark.parametrize("letters", ["E 47.3 MPa", "\u2847", "█▄", "│─┤", "±µ²"])
def test_every_letter_leaves_something_in_the_picture(tmp_path: Path, letters: str) -> None:
    def picture(text: str, name: str) -> bytes:
        file = tmp_path / name
        save_picture([[Run(0, text, "#ffffff", "#000000", False, False)]], 12, file)
        return file.read_bytes()

    drawn = picture(letters, "a.svg")
    assert drawn == picture(letters, "b.svg")
    assert drawn != picture(" ", "c.svg")
    assert b"<text" not in drawn  # no font of the reader's machine is needed
    assert picture(letters, "d.png").startswith(b"\x89PNG")
