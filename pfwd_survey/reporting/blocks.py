"""What a report is made of: written as HTML or laid out on pages, from the same blocks."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Draw = Callable[[Any], None]
"""Draws into a figure of matplotlib, or a part of one."""


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading."""

    text: str
    level: int = 2
    new_page: bool = False


@dataclass(frozen=True, slots=True)
class Paragraph:
    """Running text."""

    text: str
    style: str = "plain"
    """plain, note (small) or warning."""


@dataclass(frozen=True, slots=True)
class Pairs:
    """Labels with their values."""

    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Mark:
    """A verdict in a cell: told by its word and by its sign, never by its colour alone."""

    kind: str
    """pass, fail, undecided or none."""
    text: str


@dataclass(frozen=True, slots=True)
class Table:
    """A table."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str | Mark, ...], ...]
    right: tuple[int, ...] = ()
    """Columns that are aligned to the right."""


@dataclass(frozen=True, slots=True)
class Listing:
    """Items, one below the other."""

    items: tuple[str, ...]
    style: str = "plain"
    """plain or warning."""


@dataclass(frozen=True, slots=True)
class Code:
    """Text of fixed width."""

    text: str


@dataclass(frozen=True, slots=True)
class Picture:
    """A drawing."""

    draw: Draw
    height: float
    """mm, at the full width of a page."""
    caption: str
    alternative: str
    """What it shows, for those who cannot see it."""


Block = Heading | Paragraph | Pairs | Table | Listing | Code | Picture

SIGNS = {"pass": "✓", "fail": "✗", "undecided": "?", "none": "–"}
"""Of a `Mark`; all of them are in DejaVu Sans, which comes with matplotlib."""
