"""How the pages of a PDF are filled."""

from typing import Any

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from pfwd.report.blocks import Mark, Pairs, Paragraph, Table
from pfwd.report.fonts import Letters
from pfwd.report.pdf_file import FOOT, MARGIN, PAGE_HEIGHT, PAGE_WIDTH, _Pages


def words_of(page: Any) -> list[str]:
    return [text.get_text() for text in page.texts]


@pytest.mark.parametrize("lines", range(48, 56))
def test_a_label_of_two_lines_stays_with_its_value(lines: int) -> None:
    pages = _Pages(Letters())
    for number in range(lines):
        pages.add(Paragraph(f"line {number}", "note"))
    pages.add(Pairs((("Last check of the instrument's load cell", "zero -20 N"),)))
    last = words_of(pages.finished()[-1])
    assert "zero -20 N" in last
    assert sum(word in "Last check of the instrument's load cell" for word in last) == 2
    assert all(
        text.get_position()[1] * PAGE_HEIGHT >= FOOT - 1 for text in pages.finished()[-1].texts
    )


def test_bold_verdicts_stay_within_the_page() -> None:
    """A table as full as it can be, its last column in bold letters."""
    pages = _Pages(Letters())
    long = "rigid-rough plate of 0.15 m on a layer"
    row = (long, long, long, "≥ 45 MPa", Mark("fail", "nicht erfüllt"))
    pages.add(Table(("Point", "Basis", "Model", "Target", "Verdict"), (row,) * 3, ()))
    (page,) = pages.finished()
    canvas = FigureCanvasAgg(page)
    canvas.draw()
    scale = page.dpi / 72
    for text in page.texts:
        box = text.get_window_extent(canvas.get_renderer())
        assert box.x1 / scale <= PAGE_WIDTH - MARGIN + 1, text.get_text()
