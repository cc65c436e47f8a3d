"""What a report is made of: written as HTML or laid out on pages, from the same blocks.

Every text that a report shows stands in one of them, and there each is made harmless, whatever a
survey, an instrument or the name of a folder holds.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

from pfwd_device.text import harmless

Draw = Callable[[Any], None]
"""Draws into a figure of matplotlib, or a part of one."""


def _harmless(value: Any) -> Any:
    """The same with its texts made harmless; the lines of a text stay lines."""
    if isinstance(value, str):
        lines = value.replace("\r\n", "\n").replace("\t", "    ").split("\n")
        return "\n".join(map(harmless, lines))
    if isinstance(value, tuple):
        return tuple(map(_harmless, value))
    return value  # numbers, and what has been made harmless when it was made


class _Harmless:
    """A block, or a part of one."""

    __slots__ = ()

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]
            object.__setattr__(self, field.name, _harmless(getattr(self, field.name)))


@dataclass(frozen=True, slots=True)
class Heading(_Harmless):
    """A heading."""

    text: str
    level: int = 2
    new_page: bool = False


@dataclass(frozen=True, slots=True)
class Paragraph(_Harmless):
    """Running text."""

    text: str
    style: str = "plain"
    """plain, note (small), warning, or small warning."""


@dataclass(frozen=True, slots=True)
class Pairs(_Harmless):
    """Labels with their values."""

    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Mark(_Harmless):
    """A verdict in a cell: told by its word and by its sign, never by its colour alone."""

    kind: str
    """pass, fail, undecided or none."""
    text: str


@dataclass(frozen=True, slots=True)
class Table(_Harmless):
    """A table."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str | Mark, ...], ...]
    right: tuple[int, ...] = ()
    """Columns that are aligned to the right."""


@dataclass(frozen=True, slots=True)
class Listing(_Harmless):
    """Items, one below the other."""

    items: tuple[str, ...]
    style: str = "plain"
    """plain or warning."""


@dataclass(frozen=True, slots=True)
class Code(_Harmless):
    """Text of fixed width."""

    text: str


@dataclass(frozen=True, slots=True)
class Picture(_Harmless):
    """A drawing."""

    draw: Draw
    height: float
    """mm, at the full width of a page."""
    caption: str
    alternative: str
    """What it shows, for those who cannot see it."""


@dataclass(frozen=True, slots=True)
class Together:
    """Blocks that stand on one page where they fit on one; what they hold is harmless already."""

    blocks: tuple["Block", ...]


Block = Heading | Paragraph | Pairs | Table | Listing | Code | Picture | Together

SIGNS = {"pass": "✓", "fail": "✗", "undecided": "?", "none": "–"}
"""Of a `Mark`; all of them are in DejaVu Sans, which comes with matplotlib."""
