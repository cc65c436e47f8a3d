"""Blocks of a report, which are written as HTML or laid out on pages.

Every text of a report is in a block. A block makes its texts harmless, whatever a survey, an
instrument or the name of a folder holds.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

from pfwd_device.text import harmless

Draw = Callable[[Any], None]
"""Function that receives an empty figure of matplotlib and draws a picture into it."""


def _harmless(value: Any) -> Any:
    """Return a value with its control characters replaced; line breaks stay."""
    if isinstance(value, str):
        lines = value.replace("\r\n", "\n").replace("\t", "    ").split("\n")
        return "\n".join(map(harmless, lines))
    if isinstance(value, tuple):
        return tuple(map(_harmless, value))
    return value  # a number, or a block that is harmless already


class _Harmless:
    """Base of blocks: replaces the control characters in all text fields."""

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
    """List of labels, each with its value beside it."""

    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Mark(_Harmless):
    """A verdict in a cell, with a word and a sign, never with its colour alone."""

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
    """Height at the full width of a page, mm."""
    caption: str
    alternative: str
    """Description for those who cannot see it."""


@dataclass(frozen=True, slots=True)
class Together:
    """Blocks that are kept on one page if they fit on one."""

    blocks: tuple["Block", ...]


Block = Heading | Paragraph | Pairs | Table | Listing | Code | Picture | Together

SIGNS = {"pass": "✓", "fail": "✗", "undecided": "?", "none": "–"}
"""Signs of a `Mark`; all of them are in DejaVu Sans, which comes with matplotlib."""
