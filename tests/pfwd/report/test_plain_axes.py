"""Ticks, numbers and titles of axes that are drawn without those of matplotlib."""

from typing import Any

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pfwd.report.plain_axes import draw_axes_plainly


def curve(high: float = 47.3, **params: Any) -> tuple[Any, Any]:
    figure = Figure(figsize=(6, 3), dpi=72)  # a pixel is a point
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.2, 0.2, 0.7, 0.7))
    axes.plot([-3.0, 12.0], [1.0, high])
    axes.set_xlabel("time, ms", fontsize=8)
    axes.set_ylabel("load\nkN", fontsize=8)
    axes.grid(alpha=0.25)
    axes.tick_params(labelsize=7)
    axes.tick_params(**params)
    return figure, axes


def boxes(texts: Any) -> dict[str, tuple[float, float, float, float]]:
    return {text.get_text(): text.get_window_extent().extents for text in texts if text.get_text()}


@pytest.mark.parametrize("params", [{}, {"labelbottom": False}, {"axis": "x", "labelrotation": 90}])
def test_numbers_and_titles_stand_where_matplotlib_has_them(params: dict[str, Any]) -> None:
    figure, axes = curve(**params)
    figure.canvas.draw()
    ends = {axis: sorted(axis.get_view_interval()) for axis in (axes.xaxis, axes.yaxis)}
    labels = [
        tick.label1
        for axis, (low, high) in ends.items()
        for tick in axis.get_major_ticks()
        if tick.label1.get_visible() and low <= tick.get_loc() <= high
    ]
    expected = boxes([*labels, axes.xaxis.label, axes.yaxis.label])
    assert len(expected) >= 7

    figure, axes = curve(**params)
    draw_axes_plainly(figure)
    figure.canvas.draw()
    drawn = boxes(axes.texts)
    assert drawn.keys() == expected.keys()
    for name, box in expected.items():
        assert drawn[name] == pytest.approx(box, abs=2.0), name
    assert not axes.xaxis.get_visible()


def test_grid_and_ticks_are_at_the_numbers() -> None:
    figure, axes = curve()
    draw_axes_plainly(figure)
    upright, level = axes.collections
    xs = [float(text.get_text().replace("\N{MINUS SIGN}", "-")) for text in axes.texts[:4]]
    assert [line[0][0] for line in upright.get_segments()][:4] == xs
    assert all(line[0][1] == line[1][1] for line in level.get_segments())
    ticks = axes.artists or [line for line in axes.lines if line.get_marker() not in ("None", None)]
    assert list(ticks[0].get_xdata())[:4] == xs


def test_numbers_with_a_common_factor_are_left_to_matplotlib() -> None:
    figure, axes = curve(high=3e9)
    draw_axes_plainly(figure)
    assert not axes.xaxis.get_visible()
    assert axes.yaxis.get_visible()


def test_axes_that_are_switched_off_stay_empty() -> None:
    figure, axes = curve()
    axes.set_axis_off()
    draw_axes_plainly(figure)
    assert not axes.texts
