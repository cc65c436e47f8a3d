"""Lines of text: harmless, fitted, no number cut."""

from hypothesis import given
from hypothesis import strategies as st

from tui.screen.drawing.lines import (
    TableColumn,
    TableRow,
    cell,
    fit,
    flow,
    piece,
    shorten,
    table_lines,
    text_of,
    width_of,
    window,
    wrap,
)


def test_control_characters_are_replaced_where_text_enters() -> None:
    rendered = cell("a\x1b]0;owned\x07b").text
    assert rendered == "a?]0;owned?b".replace("?", "\N{REPLACEMENT CHARACTER}")


def test_the_piece_with_the_highest_rank_is_dropped_first() -> None:
    pieces = [piece(0, "lost 0"), piece(2, "battery 7.4 V"), piece(1, "10 kHz")]
    assert text_of(fit(pieces, 80)) == "lost 0  battery 7.4 V  10 kHz"
    assert text_of(fit(pieces, 20)) == "lost 0  10 kHz"
    assert text_of(fit(pieces, 10)) == "lost 0"


@given(st.integers(1, 120), st.integers(1, 4))
def test_fitted_lines_keep_the_width_and_cut_no_piece(width: int, rows: int) -> None:
    texts = ["alpha 1.25", "beta 2", "gamma 333.1", "delta"]
    lines = flow([piece(rank, text) for rank, text in enumerate(texts)], width, rows)
    assert len(lines) <= rows
    assert all(width_of(text_row) <= width for text_row in lines)
    rendered = [part for text_row in lines for part in text_of(text_row).split("  ") if part]
    assert set(rendered) <= set(texts)


@given(st.text(max_size=200), st.integers(3, 60))
def test_wrapped_text_fits_and_loses_no_word(text: str, width: int) -> None:
    safe = cell(text).text
    lines = wrap(safe, width)
    assert all(width_of([cell(text_row)]) <= width for text_row in lines)
    if all(len(word) <= width and word.isascii() for word in safe.split()):
        assert " ".join(lines).split() == safe.split()


def test_only_free_text_is_shortened_and_it_shows() -> None:
    assert shorten("a very long name of a place", 12) == "a very lon.."
    assert shorten("short", 12) == "short"
    assert shorten("3 rebounds (4.6, 1.75, 0.59 kN)", 21) == "3 rebounds (4.6,.."


COLUMNS = [
    TableColumn("drop", 0),
    TableColumn("E MPa", 1),
    TableColumn("defl µm", 3),
    TableColumn("remark", 2, is_flexible=True),
]
ROWS = [
    TableRow(("1", "47.31", "641", "permanent set of the plate")),
    TableRow(("12", "1234.5", "12.25", "safe"), chosen=True),
]


@given(st.integers(10, 80))
def test_no_number_of_a_table_is_cut_at_any_width(width: int) -> None:
    lines = [text_of(text_row) for text_row in table_lines(COLUMNS, ROWS, width)]
    for numbers in zip(*(row.texts[:3] for row in ROWS), strict=True):
        rendered = [any(number in line.split() for line in lines) for number in numbers]
        digits = [number[:3] in " ".join(lines) for number in numbers]
        assert all(rendered) or not any(digits), numbers
    assert all(len(line) <= max(width, 5) for line in lines)


def test_a_narrow_table_omits_columns_by_rank_and_marks_the_chosen_row() -> None:
    wide, narrow = (
        [text_of(row) for row in table_lines(COLUMNS, ROWS, width)] for width in (60, 24)
    )
    assert "defl" in wide[0]
    assert "defl" not in narrow[0]
    assert "E MPa" in narrow[0]
    assert [row.startswith("▶") for row in wide[1:]] == [False, True], "not by colour alone"


def test_the_window_holds_the_chosen_row_and_else_the_newest() -> None:
    assert list(window(10, None, 3)) == [7, 8, 9]
    assert list(window(10, 2, 3)) == [0, 1, 2]
    assert list(window(10, 5, 3)) == [3, 4, 5]
    assert list(window(2, None, 3)) == [0, 1]
