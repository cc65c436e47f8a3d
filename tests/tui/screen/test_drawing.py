"""Curves, axes, digits, bars: as text, without an application."""

import io
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.color import Color, ColorSystem

from tui.output import SPELLED
from tui.screen.drawing.digits import LETTER_ROWS, digit_lines, digit_width, largest_size
from tui.screen.drawing.glyphs import ASCII, BRAILLE, Glyphs, glyphs_of_terminal
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
from tui.screen.themes import THEMES


def test_columns_have_the_extremes_and_no_gap_between_them() -> None:
    time = np.arange(100_000) / 100_000
    values = np.zeros(100_000)
    values[31_234] = 5.0
    low, high = min_max_columns(time, values, 0.0, 1.0, 240)
    assert (high.max(), low.min()) == (5.0, 0.0)
    assert int(np.argmax(high)) == pytest.approx(0.31234 * 240, abs=1)
    low, high = min_max_columns(time, 50 * time, 0.0, 1.0, 20)
    assert np.all(high[:-1] >= low[1:])


def test_gaps_and_times_outside_the_data_stay_empty() -> None:
    time = np.linspace(0, 1, 1000)
    values = np.where((time > 0.4) & (time < 0.6), np.nan, 1.0)
    low, _ = min_max_columns(time, values, 0.0, 2.0, 40)
    assert np.isnan(low[9:11]).all()
    assert np.isnan(low[21:]).all()
    assert np.isfinite(low[:7]).all()
    time = np.arange(10.0)  # sparse: a sample in every tenth column
    low, _ = min_max_columns(time, np.where(time == 5, np.nan, 1.0), 0.0, 9.0, 90)
    assert np.isnan(low[45:58]).all()
    assert np.isfinite(low[2:38]).all()


def trace(values: list[float], *, dashed: bool = False) -> DotCurve:
    array = np.array(values)
    return DotCurve(array, array, "measured", dashed)


def test_a_dot_has_the_right_cell() -> None:
    (line,) = draw_dots([trace([0.0, np.nan])], 1, 1, 0.0, 1.0, BRAILLE)
    assert text_of(line) == chr(0x2840)  # the lowest dot on the left
    (line,) = draw_dots([trace([np.nan, 1.0])], 1, 1, 0.0, 1.0, BRAILLE)
    assert text_of(line) == chr(0x2808)  # the highest on the right
    lines = draw_dots([trace([0.0, 1.0, 2.0, 3.0])], 4, 4, 0.0, 3.0, ASCII)
    assert [text_of(row) for row in lines] == ["   *", "  * ", " *  ", "*   "]


def test_a_dashed_curve_has_gaps() -> None:
    solid = text_of(draw_dots([trace([0.5] * 48)], 24, 1, 0.0, 1.0, BRAILLE)[0])
    dashed = text_of(draw_dots([trace([0.5] * 48, dashed=True)], 24, 1, 0.0, 1.0, BRAILLE)[0])
    assert " " not in solid
    assert dashed.count(" ") == 12


def test_ticks_are_round_and_inside() -> None:
    for low, high in ((0.0, 9.94), (-12.0, 640.0), (0.0, 1e-3), (-5.0, 0.0)):
        marks = ticks(low, high, 6)
        assert 2 <= len(marks) <= 6
        assert all(low <= row <= high for row in marks)
        step = marks[1] - marks[0]
        assert float(f"{step:.0e}") == pytest.approx(step)
    assert tick_text(0.25, 0.05) == "0.25"


def figure() -> Figure:
    time = np.linspace(0, 20, 500)
    curve = Curve(time, 10 * np.sin(np.pi * time / 20), "load", "measured")
    neighbour = Curve(time, 9.5 * np.sin(np.pi * time / 20), "fitted", "half-sine", True)
    return Figure("load", "kN", (curve, neighbour), 0.0, 20.0, note="peak 10.0", cursor=5.0)


@given(st.integers(10, 150), st.integers(1, 30), st.sampled_from([ASCII, BRAILLE]))
def test_a_plot_fills_just_its_place(width: int, height: int, glyphs: Glyphs) -> None:
    lines = plot_lines(figure(), width, height, glyphs)
    assert len(lines) == height
    assert all(width_of(row) <= width for row in lines)


def test_a_plot_has_title_units_and_curve_forms() -> None:
    text = "\n".join(text_of(row) for row in plot_lines(figure(), 90, 12, BRAILLE))
    for part in ("load kN", "peak 10.0", "─── measured", "- - half-sine", "ms", "10 ┤", "0 ┤"):
        assert part in text


@given(st.integers(4, 30), st.sampled_from([ASCII, BRAILLE]))
def test_a_tick_stands_where_a_curve_of_its_value_is_drawn(height: int, glyphs: Glyphs) -> None:
    time = np.linspace(0, 20, 500)
    curve = Curve(time, np.full(500, 5.0), "load", "")
    flat = Figure("load", "kN", (curve,), 0.0, 20.0, bottom=-1.0, top=11.0)
    lines = [text_of(row) for row in plot_lines(flat, 60, height, glyphs)]
    drawn = [row for row in lines[1:-1] if row[6:].strip(" ─")]
    assert len(drawn) == 1
    marked = [row for row in lines if row.strip().startswith("5 ┤")]
    assert marked in ([], drawn)


def test_a_curve_of_zeros_is_in_the_middle_of_its_plot() -> None:
    time = np.linspace(0, 20, 500)
    zeros = Figure("load", "kN", (Curve(time, np.zeros(500), "load", ""),), 0.0, 20.0)
    rows = [text_of(row) for row in plot_lines(zeros, 60, 13, ASCII)][1:-1]
    (tick,) = (number for number, row in enumerate(rows) if row.strip().startswith("0 ┤"))
    assert tick == len(rows) // 2


def test_the_cursor_is_a_column() -> None:
    lines = [text_of(row) for row in plot_lines(figure(), 90, 12, BRAILLE)]
    marked = [row[6:].find("│") for row in lines[2:-1]]
    assert len({at for at in marked if at >= 0}) == 1


def test_figures_are_as_large_as_fits_and_never_cut() -> None:
    assert largest_size("47.3", 100, 12) == (4, 2)
    assert largest_size("47.3", 40, 6) == (2, 1)
    assert largest_size("47.3", 17, 5) == (1, 1)
    assert largest_size("47.3", 10, 5) is None
    for wide, high in ((4, 2), (2, 1), (1, 1)):
        lines = digit_lines("47.3±0.6", "strong", wide, high)
        assert len(lines) == LETTER_ROWS * high
        assert {width_of(row) for row in lines} == {digit_width("47.3±0.6", wide)}


def test_large_digits_are_distinct() -> None:
    forms = {tuple(text_of(row) for row in digit_lines(digit)) for digit in "0123456789.-"}
    assert len(forms) == 12


def test_a_bar_is_as_high_as_its_value_and_the_target_is_a_line() -> None:
    bars = [Bar("1", 10.0), Bar("2", 20.0, chosen=True), Bar("3", None)]
    lines = [text_of(row) for row in profile_lines(bars, 60, 12, "modulus, MPa", 15.0)]
    assert len(lines) == 12
    first, second = (sum(line[column] in "█▇▆▅▄▃▂▁" for line in lines) for column in (7, 11))
    assert 1.6 < second / first < 2.4
    assert any("─" in line for line in lines[1:])
    assert "?" in lines[10]


def test_the_console_without_dots_gets_ascii() -> None:
    assert glyphs_of_terminal({"TERM": "linux"}) is ASCII
    assert glyphs_of_terminal({"TERM": "xterm", "PFWD_GLYPHS": "ascii"}) is ASCII
    assert glyphs_of_terminal({"TERM": "linux", "PFWD_GLYPHS": "braille"}) is BRAILLE


@pytest.mark.parametrize(
    ("page", "shown"),
    [
        (850, "─ │ ■ ° µ ² ± v n > * __# ."),
        (1252, "- | # ° µ ² ± v n > * __# …"),
        (65001, "─ │ ■ ° µ ² ± ν η > * __# …"),
        (936, "- | # d u 2 ~ v n > * __# ."),
        (708, "- | # d u 2 ~ v n > * __# ."),  # which Python does not know
    ],
)
def test_the_console_of_windows_gets_the_signs_of_its_code_page(
    page: int, shown: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tui.screen.drawing.glyphs.console_code_page", lambda: page)
    monkeypatch.setattr(sys, "__stdout__", io.TextIOWrapper(io.BytesIO(), encoding="utf-8"))
    glyphs = glyphs_of_terminal({})
    assert not glyphs.has_dots
    assert glyphs.to_terminal("─ │ ■ ° µ ² ± ν η ▶ ● ▁▂▆ …") == shown
    assert glyphs.to_terminal("Straße 中") == "Straße 中"
    for terminal in ("WT_SESSION", "TERM_PROGRAM"):
        assert glyphs_of_terminal({terminal: "1"}) is BRAILLE
    assert glyphs_of_terminal({"PFWD_GLYPHS": "braille"}) is BRAILLE


def test_an_output_in_a_code_page_has_only_its_characters(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "__stdout__", io.TextIOWrapper(io.BytesIO(), encoding="cp850"))
    assert glyphs_of_terminal({}).to_terminal("─ ν µ") == "─ v µ"


def test_ascii_replacements_keep_the_columns() -> None:
    text = "▶ ─│┤ ■□ ●" + "".join(SPELLED)
    shown = ASCII.to_terminal(text)
    assert len(shown) == len(text)
    assert shown.isascii()
    assert shown.count("?") == 1, "the replacement character"
    assert ASCII.to_terminal("50 µm ± 2 %, ν 0.35") == "50 um ~ 2 %, v 0.35"
    assert ASCII.to_terminal("→ lift the plate") == "> lift the plate"


def test_bars_become_narrower_before_points_are_dropped() -> None:
    bars = [Bar(f"km 12+{300 + 25 * n}", 40.0 + n, chosen=n == 20) for n in range(24)]
    rows = [text_of(row) for row in profile_lines(bars, 80, 14, "modulus, MPa")]
    assert len(rows[-2].rpartition("┤")[2].split()) == 24
    assert "km 12+800" in rows[-1], "the chosen one has its name"
    assert max(map(len, rows)) <= 80


@pytest.mark.parametrize(
    "system", [ColorSystem.TRUECOLOR, ColorSystem.EIGHT_BIT, ColorSystem.STANDARD]
)
@pytest.mark.parametrize("theme", THEMES)
def test_every_role_is_readable_with_the_colours_of_a_terminal(
    theme: str, system: ColorSystem
) -> None:
    """Contrast as WCAG defines it, which demands 3 for large type."""

    def luminance(colour: Color) -> float:
        shares = [part / 255 for part in colour.downgrade(system).get_truecolor()]
        linear = [s / 12.92 if s <= 0.03928 else ((s + 0.055) / 1.055) ** 2.4 for s in shares]
        return float(np.dot((0.2126, 0.7152, 0.0722), linear))

    for role, style in THEMES[theme].styles.items():
        assert style.color is not None
        assert style.bgcolor is not None
        dark, light = sorted(map(luminance, (style.color, style.bgcolor)))
        assert (light + 0.05) / (dark + 0.05) > 3.5, role
