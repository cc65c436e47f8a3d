"""Curves, axes, digits, bars: as text, without an application."""

import numpy as np
import pytest

from tui.screen.drawing.digits import LETTER_ROWS, digit_lines, digit_width, largest_size
from tui.screen.drawing.glyphs import ASCII, BRAILLE, glyphs_of_terminal
from tui.screen.drawing.lines import text_of, width_of
from tui.screen.drawing.plot import (
    Curve,
    DotCurve,
    Figure,
    draw_dots,
    min_max_columns,
    plot_lines,
    tick_text,
    ticks,
)
from tui.screen.drawing.profile import Bar, profile_lines


def test_a_peak_of_one_sample_survives_the_reduction() -> None:
    time = np.arange(100_000) / 100_000
    values = np.zeros(100_000)
    values[31_234] = 5.0
    low, high = min_max_columns(time, values, 0.0, 1.0, 240)
    assert high.max() == 5.0
    assert int(np.argmax(high)) == pytest.approx(0.31234 * 240, abs=1)
    assert low.min() == 0.0


def test_neighbouring_columns_touch() -> None:
    time = np.linspace(0, 1, 1000)
    low, high = min_max_columns(time, 50 * time, 0.0, 1.0, 20)
    assert np.all(high[:-1] >= low[1:])


def test_a_gap_stays_empty_and_outside_is_nothing() -> None:
    time = np.linspace(0, 1, 1000)
    values = np.where((time > 0.4) & (time < 0.6), np.nan, 1.0)
    low, _ = min_max_columns(time, values, 0.0, 2.0, 40)
    assert np.isnan(low[9:11]).all()
    assert np.isnan(low[21:]).all()
    assert np.isfinite(low[:7]).all()


def test_a_gap_between_few_samples_is_not_bridged() -> None:
    time = np.arange(10.0)
    values = np.where(time == 5, np.nan, 1.0)
    low, _ = min_max_columns(time, values, 0.0, 9.0, 90)
    assert np.isnan(low[45:58]).all()
    assert np.isfinite(low[2:38]).all()


def trace(values: list[float], *, dashed: bool = False) -> DotCurve:
    array = np.array(values)
    return DotCurve(array, array, "measured", dashed)


def test_one_dot_is_where_it_belongs() -> None:
    (line,) = draw_dots([trace([0.0, np.nan])], 1, 1, 0.0, 1.0, BRAILLE)
    assert text_of(line) == chr(0x2840)  # the lowest dot on the left
    (line,) = draw_dots([trace([np.nan, 1.0])], 1, 1, 0.0, 1.0, BRAILLE)
    assert text_of(line) == chr(0x2808)  # the highest on the right


def test_ascii_has_no_other_letters() -> None:
    lines = draw_dots([trace([0.0, 1.0, 2.0, 3.0])], 4, 4, 0.0, 3.0, ASCII)
    assert [text_of(one) for one in lines] == ["   *", "  * ", " *  ", "*   "]


def test_a_dashed_curve_has_gaps_so_that_form_tells_it_from_a_whole_one() -> None:
    whole = text_of(draw_dots([trace([0.5] * 48)], 24, 1, 0.0, 1.0, BRAILLE)[0])
    dashed = text_of(draw_dots([trace([0.5] * 48, dashed=True)], 24, 1, 0.0, 1.0, BRAILLE)[0])
    assert " " not in whole
    assert dashed.count(" ") == 12


def test_ticks_are_round_and_inside() -> None:
    for low, high in ((0.0, 9.94), (-12.0, 640.0), (0.0, 1e-3), (-5.0, 0.0)):
        found = ticks(low, high, 6)
        assert 2 <= len(found) <= 6
        assert all(low <= one <= high for one in found)
        step = found[1] - found[0]
        assert float(f"{step:.0e}") == pytest.approx(step)
    assert tick_text(0.25, 0.05) == "0.25"


def figure() -> Figure:
    time = np.linspace(0, 20, 500)
    curve = Curve(time, 10 * np.sin(np.pi * time / 20), "load", "measured")
    other = Curve(time, 9.5 * np.sin(np.pi * time / 20), "fitted", "half-sine", True)
    return Figure("load", "kN", (curve, other), 0.0, 20.0, note="peak 10.0", cursor=5.0)


@pytest.mark.parametrize("width", [20, 40, 77, 150])
@pytest.mark.parametrize("height", [3, 8, 30])
@pytest.mark.parametrize("glyphs", [ASCII, BRAILLE])
def test_a_plot_fills_just_its_place(width: int, height: int, glyphs: object) -> None:
    lines = plot_lines(figure(), width, height, glyphs)  # type: ignore[arg-type]
    assert len(lines) == height
    assert all(width_of(one) <= width for one in lines)


def test_a_plot_says_what_it_shows_with_units_and_forms() -> None:
    text = "\n".join(text_of(one) for one in plot_lines(figure(), 90, 12, BRAILLE))
    for part in ("load kN", "peak 10.0", "─── measured", "- - half-sine", "ms", "10 ┤", "0 ┤"):
        assert part in text


@pytest.mark.parametrize("height", range(4, 30))
@pytest.mark.parametrize("glyphs", [ASCII, BRAILLE])
def test_a_tick_stands_where_a_curve_of_its_value_is_drawn(height: int, glyphs: object) -> None:
    time = np.linspace(0, 20, 500)
    curve = Curve(time, np.full(500, 5.0), "load", "")
    flat = Figure("load", "kN", (curve,), 0.0, 20.0, bottom=-1.0, top=11.0)
    lines = [text_of(one) for one in plot_lines(flat, 60, height, glyphs)]  # type: ignore[arg-type]
    drawn = [one for one in lines[1:-1] if one[6:].strip(" ─")]
    assert len(drawn) == 1
    marked = [one for one in lines if one.strip().startswith("5 ┤")]
    assert marked in ([], drawn)


def test_the_cursor_is_a_column() -> None:
    lines = [text_of(one) for one in plot_lines(figure(), 90, 12, BRAILLE)]
    marked = [one[6:].find("│") for one in lines[2:-1]]
    assert len({at for at in marked if at >= 0}) == 1


def test_figures_are_as_large_as_fits_and_never_cut() -> None:
    assert largest_size("47.3", 100, 12) == (4, 2)
    assert largest_size("47.3", 40, 6) == (2, 1)
    assert largest_size("47.3", 17, 5) == (1, 1)
    assert largest_size("47.3", 10, 5) is None
    for wide, high in ((4, 2), (2, 1), (1, 1)):
        lines = digit_lines("47.3±0.6", "strong", wide, high)
        assert len(lines) == LETTER_ROWS * high
        assert {width_of(one) for one in lines} == {digit_width("47.3±0.6", wide)}


def test_digits_differ_from_each_other() -> None:
    forms = {tuple(text_of(one) for one in digit_lines(digit)) for digit in "0123456789.-"}
    assert len(forms) == 12


def test_a_bar_is_as_high_as_its_value_and_the_target_is_a_line() -> None:
    bars = [Bar("1", 10.0), Bar("2", 20.0, chosen=True), Bar("3", None)]
    lines = [text_of(one) for one in profile_lines(bars, 60, 12, "modulus, MPa", 15.0)]
    assert len(lines) == 12
    first, second = (sum(line[column] in "█▇▆▅▄▃▂▁" for line in lines) for column in (7, 11))
    assert 1.6 < second / first < 2.4
    assert any("─" in line for line in lines[1:])
    assert "?" in lines[10]


def test_the_console_without_dots_gets_ascii() -> None:
    assert glyphs_of_terminal({"TERM": "linux"}) is ASCII
    assert glyphs_of_terminal({"TERM": "xterm", "PFWD_GLYPHS": "ascii"}) is ASCII
    assert glyphs_of_terminal({"TERM": "linux", "PFWD_GLYPHS": "braille"}) is BRAILLE


def test_ascii_letters_take_as_many_columns() -> None:
    text = "▶ ± µ ─│┤ ■□ ● ² \N{REPLACEMENT CHARACTER}"
    assert len(ASCII.to_terminal(text)) == len(text)
    assert ASCII.to_terminal(text).isascii()
    assert ASCII.to_terminal("→ lift the plate") == "> lift the plate"


def test_bars_become_narrower_before_a_point_is_left_out() -> None:
    bars = [Bar(f"km 12+{300 + 25 * n}", 40.0 + n, chosen=n == 20) for n in range(24)]
    rows = [text_of(one) for one in profile_lines(bars, 80, 14, "modulus, MPa")]
    assert len(rows[-2].rpartition("┤")[2].split()) == 24
    assert "km 12+800" in rows[-1], "the chosen one has its name"
    assert max(map(len, rows)) <= 80
