"""A report as a PDF, laid out on pages by this module and drawn by matplotlib.

A renderer of HTML would need libraries of the system (Pango, a browser), which a field computer
often lacks; matplotlib is there anyway.
"""

import io
from collections.abc import Sequence
from typing import Any

from pfwd.matplotlib_start import start_matplotlib
from pfwd.report.blocks import (
    SIGNS,
    Block,
    Code,
    Heading,
    Listing,
    Mark,
    Pairs,
    Paragraph,
    Picture,
    Table,
    Together,
)
from pfwd.report.drawing import VERDICT_COLOURS
from pfwd.report.fonts import Letters, families
from pfwd.report.texts import Texts

PAGE_WIDTH, PAGE_HEIGHT = 595.28, 841.89
"""Points; A4 upright."""

MARGIN, FOOT = 42.5, 34.0
"""Points; 15 mm and 12 mm."""

_POINTS_PER_MM = 72 / 25.4
_INK, _SOFT, _BLUE, _LINE, _TINT, _BROWN = (
    "#1c2430",
    "#5b6675",
    "#0b3c5d",
    "#c9d1da",
    "#f3f6f9",
    "#7a3b00",
)
_SIZES = {1: 20.0, 2: 13.0, 3: 10.0}
_TEXT, _NOTE, _CELL = 9.0, 7.6, 7.0
_LEADING = 1.38
_CHECKSUM = 64
"""Letters of a SHA-256, which has no place to break."""

_MANY_COLUMNS, _SMALL_CELL = 9, 6.2
"""Columns from which a table has smaller letters, and their size."""

_GAP = 6.0
"""Points between the columns of a table."""

_BOLD = 1.17
"""Width of bold letters over plain ones."""

_LABEL = 112.0
"""Points; width of the labels of pairs."""

_TOGETHER = 6
"""Lines of a pair that stand on one page."""

_BEFORE_HEADING, _BELOW_PICTURE = 8.0, 30.0
"""Points left free above a heading within a page, and asked for below a picture."""

_KEEP = 90.0
"""Points that have to be left below a heading; it goes to the next page otherwise."""


def render_pdf(blocks: Sequence[Block], texts: Texts, title: str, letters: Letters) -> bytes:
    """The bytes of the file.

    Parameters
    ----------
    blocks : sequence of Block
    texts : Texts
    title : str
        For the foot of the pages.
    letters : Letters

    Returns
    -------
    bytes
    """
    start_matplotlib()
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import PdfPages

    # Outlines of type 3: the only ones that collections of Chinese fonts can be embedded as.
    with rc_context({"font.family": families(), "pdf.fonttype": 3}):
        pages = _Pages(letters)
        for block in blocks:
            pages.add(block)
        if letters.missing:
            pages.add(Paragraph(texts.say("missing_letters", count=letters.missing), "warning"))
        stream = io.BytesIO()
        information = {"Title": letters.drawable(title), "CreationDate": None}
        with PdfPages(stream, metadata=information) as document:
            for number, page in enumerate(pages.finished(), 1):
                foot = texts.say("page", page=number, pages=len(pages.finished()))
                _foot(page, letters.drawable(title), foot)
                document.savefig(page)
    return stream.getvalue()


def _foot(page: Any, title: str, number: str) -> None:
    y = FOOT * 0.6 / PAGE_HEIGHT
    left, right = MARGIN / PAGE_WIDTH, 1 - MARGIN / PAGE_WIDTH
    short = title if len(title) <= 90 else f"{title[:89]}…"
    page.text(left, y, short, fontsize=7, color=_SOFT, parse_math=False)
    page.text(right, y, number, fontsize=7, color=_SOFT, ha="right", parse_math=False)


class _Region:
    """Part of a page that is drawn into like a figure of its own."""

    def __init__(self, page: Any, bottom: float, top: float) -> None:
        self._page = page
        self._bottom, self._top = bottom, top

    def subplots(self, *counts: int, gridspec_kw: dict[str, float], **style: Any) -> Any:
        """Axes with margins that are parts of the region."""
        left, right = MARGIN / PAGE_WIDTH, 1 - MARGIN / PAGE_WIDTH
        ends = {"left": (left, right), "bottom": (self._bottom, self._top)}
        ends |= {"right": ends["left"], "top": ends["bottom"]}
        placed = {
            name: ends[name][0] + value * (ends[name][1] - ends[name][0]) if name in ends else value
            for name, value in gridspec_kw.items()
        }
        return self._page.subplots(*counts, gridspec_kw=placed, **style)

    def add_axes(self, place: tuple[float, float, float, float], **style: Any) -> Any:
        """Axes at left, bottom, width, height, as parts of the region."""
        left, bottom, width, height = place
        wide, high = 1 - 2 * MARGIN / PAGE_WIDTH, self._top - self._bottom
        x, y = MARGIN / PAGE_WIDTH + left * wide, self._bottom + bottom * high
        return self._page.add_axes((x, y, width * wide, height * high), **style)

    def align_ylabels(self, axes: Sequence[Any]) -> None:
        """Labels of axes above each other in one line."""
        self._page.align_ylabels(axes)


class _Pages:
    """Pages that are filled from the top."""

    def __init__(self, letters: Letters, *, measuring: bool = False) -> None:
        self._letters = letters
        self._measuring = measuring
        self._done: list[Any] = []
        self._page: Any = None
        self._y = 0.0
        self._size = _CELL
        self._new_page()

    def finished(self) -> list[Any]:
        return self._done

    def add(self, block: Block) -> None:
        match block:
            case Heading():
                self._heading(block)
            case Paragraph(text, style):
                small = style in ("note", "small warning")
                colour = _SOFT if style == "note" else _BROWN if "warning" in style else _INK
                self._paragraph(text, _NOTE if small else _TEXT, colour)
            case Pairs(rows):
                for label, value in rows:
                    self._pair(label, value)
                self._y -= 4
            case Table():
                self._table(block)
            case Listing(items, style):
                for item in items:
                    colour = _BROWN if style == "warning" else _INK
                    self._paragraph(f"• {item}", 8.0, colour, indent=6.0, after=1.5)
                self._y -= 3
            case Code(text):
                self._paragraph(text, 7.0, _INK)
            case Picture():
                self._picture(block)
            case Together(blocks):
                self._together(blocks)

    def _together(self, blocks: Sequence[Block]) -> None:
        """On a new page when there is no room for them here, and a page has it."""
        trial = _Pages(self._letters, measuring=True)
        missing = self._letters.missing
        for block in blocks:
            trial.add(block)
        self._letters.missing = missing
        if len(trial.finished()) == 1:
            below = _BELOW_PICTURE if isinstance(blocks[-1], Picture) else 0.0
            self._room(PAGE_HEIGHT - MARGIN - trial._y + _BEFORE_HEADING + below)
        elif self._y < PAGE_HEIGHT - MARGIN:
            self._new_page()
        for block in blocks:
            self.add(block)

    def _new_page(self) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self._page = Figure(figsize=(PAGE_WIDTH / 72, PAGE_HEIGHT / 72))
        FigureCanvasAgg(self._page)
        self._done.append(self._page)
        self._y = PAGE_HEIGHT - MARGIN

    def _room(self, height: float) -> None:
        if self._y - height < FOOT and self._y < PAGE_HEIGHT - MARGIN:
            self._new_page()

    @property
    def _width(self) -> float:
        return PAGE_WIDTH - 2 * MARGIN

    def _write(self, x: float, y: float, text: str, size: float, colour: str, **style: Any) -> None:
        # What comes from a survey is never read as a formula.
        self._page.text(
            x / PAGE_WIDTH,
            y / PAGE_HEIGHT,
            text,
            fontsize=size,
            color=colour,
            va="baseline",
            parse_math=False,
            **style,
        )

    def _rule(self, y: float, colour: str, width: float) -> None:
        from matplotlib.lines import Line2D

        xs = [MARGIN / PAGE_WIDTH, 1 - MARGIN / PAGE_WIDTH]
        line = Line2D(xs, [y / PAGE_HEIGHT] * 2, color=colour, linewidth=width)
        self._page.add_artist(line)

    def _heading(self, block: Heading) -> None:
        top = PAGE_HEIGHT - MARGIN
        if block.new_page and self._y < top:
            self._new_page()
        size = _SIZES[block.level]
        self._room(_KEEP if block.level > 1 else size)
        if self._y < top:
            self._y -= _BEFORE_HEADING if block.level == 2 else 4
        for line in self._letters.wrap(
            self._letters.drawable(block.text), size * _BOLD, self._width
        ):
            self._y -= size * 1.25
            colour = _INK if block.level == 3 else _BLUE
            self._write(MARGIN, self._y, line, size, colour, weight="bold")
        if block.level < 3:
            self._y -= 5
            self._rule(
                self._y, _BLUE if block.level == 1 else _LINE, 2 if block.level == 1 else 0.8
            )
        self._y -= 3

    def _paragraph(
        self, text: str, size: float, colour: str, indent: float = 0.0, after: float = 4.0
    ) -> None:
        lines = self._letters.wrap(self._letters.drawable(text), size, self._width - indent)
        for index, line in enumerate(lines):
            self._room(size * _LEADING)
            self._y -= size * _LEADING
            self._write(MARGIN + (indent if index else 0.0), self._y, line, size, colour)
        self._y -= after

    def _pair(self, label: str, value: str) -> None:
        size, letters = 8.4, self._letters
        names = letters.wrap(letters.drawable(label), size, _LABEL - 6)
        lines = letters.wrap(letters.drawable(value), size, self._width - _LABEL)
        # A label stays with its value; what is longer than that may run over the page.
        self._room(min(max(len(names), len(lines)), _TOGETHER) * size * _LEADING)
        for index in range(max(len(names), len(lines))):
            self._room(size * _LEADING)
            self._y -= size * _LEADING
            if index < len(names):
                self._write(MARGIN, self._y, names[index], size, _SOFT)
            if index < len(lines):
                self._write(MARGIN + _LABEL, self._y, lines[index], size, _INK)

    def _picture(self, block: Picture) -> None:
        height = block.height * _POINTS_PER_MM * self._width / (180.0 * _POINTS_PER_MM)
        self._room(height + _BELOW_PICTURE)
        bottom = self._y - height
        if not self._measuring:
            block.draw(_Region(self._page, bottom / PAGE_HEIGHT, self._y / PAGE_HEIGHT))
        self._y = bottom
        if block.caption:
            self._paragraph(block.caption, _NOTE, _SOFT)

    def _table(self, table: Table) -> None:
        longest = max(
            (len(cell) for row in table.rows for cell in row if isinstance(cell, str)), default=0
        )
        full = len(table.columns) >= _MANY_COLUMNS or longest == _CHECKSUM
        self._size = _SMALL_CELL if full else _CELL
        cells = [[self._cell(cell) for cell in row] for row in table.rows]
        head = [self._letters.drawable(column) for column in table.columns]
        marked = [_bold_cells(row) for row in table.rows]
        bold = [any(row[column] for row in marked) for column in range(len(head))]
        widths = self._widths(head, cells, bold)
        self._row(head, widths, table, None, header=True)
        for row, marks, bolds in zip(cells, table.rows, marked, strict=True):
            height = self._height(row, widths, bolds)
            if self._y - height < FOOT:
                self._new_page()
                self._row(head, widths, table, None, header=True)
            self._row(row, widths, table, marks)
        self._y -= 6

    def _cell(self, cell: str | Mark) -> str:
        text = f"{SIGNS[cell.kind]} {cell.text}" if isinstance(cell, Mark) else cell
        return self._letters.drawable(text)

    def _widths(
        self, head: Sequence[str], rows: Sequence[Sequence[str]], bold: Sequence[bool]
    ) -> list[float]:
        """As wide as its longest cell, the wide columns narrowed until all fit."""
        room = self._width - _GAP * (len(head) - 1)
        wanted = []
        for heavy, title, *texts in zip(bold, head, *rows, strict=True):
            size = self._size * (_BOLD if heavy else 1.05)
            words = [self._letters.width(word, self._size * _BOLD) for word in title.split()]
            wanted.append(max([0.0, *words, *(self._letters.width(text, size) for text in texts)]))
        if sum(wanted) <= room:
            rest = (room - sum(wanted)) / len(wanted)
            return [width + rest for width in wanted]
        # The widest give first: a limit that no column exceeds.
        low, high = 0.0, max(wanted)
        for _ in range(40):
            middle = (low + high) / 2
            if sum(min(width, middle) for width in wanted) > room:
                high = middle
            else:
                low = middle
        return [min(width, low) for width in wanted]

    def _lines(
        self, row: Sequence[str], widths: Sequence[float], bold: Sequence[bool]
    ) -> list[list[str]]:
        return [
            self._letters.wrap(text, self._size * (_BOLD if heavy else 1.03), width + 0.5)
            for text, width, heavy in zip(row, widths, bold, strict=True)
        ]

    def _height(self, row: Sequence[str], widths: Sequence[float], bold: Sequence[bool]) -> float:
        most = max(len(lines) for lines in self._lines(row, widths, bold))
        return most * self._size * _LEADING + 4

    def _row(
        self,
        row: Sequence[str],
        widths: Sequence[float],
        table: Table,
        marks: Sequence[str | Mark] | None,
        *,
        header: bool = False,
    ) -> None:
        bold = [header] * len(row) if marks is None else _bold_cells(marks)
        height = self._height(row, widths, bold)
        self._room(height * (3 if header else 1))
        if header:
            self._shade(self._y - height, height)
        x = MARGIN
        for index, lines in enumerate(self._lines(row, widths, bold)):
            y = self._y - 1
            mark = marks[index] if marks is not None else None
            colour = VERDICT_COLOURS[mark.kind] if isinstance(mark, Mark) else _INK
            for line in lines:
                y -= self._size * _LEADING
                right = index in table.right
                self._write(
                    x + widths[index] if right else x,
                    y,
                    line,
                    self._size,
                    colour,
                    ha="right" if right else "left",
                    weight="bold" if bold[index] else "normal",
                )
            x += widths[index] + _GAP
        self._y -= height
        self._rule(self._y, _LINE, 0.9 if header else 0.4)

    def _shade(self, bottom: float, height: float) -> None:
        from matplotlib.patches import Rectangle

        patch = Rectangle(
            (MARGIN / PAGE_WIDTH, bottom / PAGE_HEIGHT),
            self._width / PAGE_WIDTH,
            height / PAGE_HEIGHT,
            color=_TINT,
            zorder=-1,
        )
        self._page.add_artist(patch)


def _bold_cells(row: Sequence[str | Mark]) -> list[bool]:
    """Which cells are drawn in bold letters: verdicts."""
    return [isinstance(cell, Mark) for cell in row]
