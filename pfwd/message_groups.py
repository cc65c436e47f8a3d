"""Groups of equal messages about several things, with their numbers as ranges."""

import re
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from inversion.notices import Notice, fill_template, templates, text_notice

Place = TypeVar("Place", bound=Hashable)

_NUMBER_PATTERN = r"[+-]?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?"
_NUMBER = re.compile(
    rf"(?<![\w.:+/-]){_NUMBER_PATTERN}(?: to {_NUMBER_PATTERN})?(?![\w+/-]|[.:]\w)"
)
"""A number, or two with a "to" between them. What is part of a name, a date, a time or a chainage
(12-points.prjz, 2022-01-21, 14:05, 12+320) is none."""

GAP = "{}"
"""Stands for a number in a pattern."""

DASH = "\N{EN DASH}"
"""Between the ends of a range; a "to" may stand in the message already."""

MAX_LISTED_VALUES = 2
"""Different values that are listed; more become a range."""


@dataclass(frozen=True, slots=True)
class MessageGroup(Generic[Place]):
    """One message and the places that it belongs to."""

    code: str
    """Code of the warning; ``other`` of any other message."""
    patterns: Mapping[str, str]
    """Text of each gap of the message by name, with ``{}`` in place of its numbers: equal for all
    that mean the same."""
    numbers: Mapping[str, tuple[str, ...]]
    """Numbers by name of the gap, at each ``{}``: one number, two, or a range of them."""
    words: Mapping[str, tuple[str, ...]]
    """Values that are words of a list, by name of the gap."""
    places: tuple[Place, ...]
    """Each once, in the order in which they came."""

    @property
    def key(self) -> Hashable:
        """Equal for messages that mean the same."""
        return (self.code, *self.patterns.items())

    @property
    def texts(self) -> dict[str, str]:
        """Return the text of each gap in full, by name."""
        return {name: fill(text, self.numbers[name]) for name, text in self.patterns.items()}

    @property
    def text(self) -> str:
        """The message in full, in English."""
        return fill_template(templates()[self.code], self.texts)


def group_messages(messages: Iterable[tuple[Place, str]]) -> list[MessageGroup[Place]]:
    """Messages that differ in nothing but their numbers as one.

    Parameters
    ----------
    messages : iterable of (place, warning or other message)

    Returns
    -------
    list of MessageGroup
        In the order in which they came first.

    Examples
    --------
    >>> groups = group_messages([("A", "load 53.1 kN is low"), ("B", "load 51 kN is low")])
    >>> [(group.text, group.places) for group in groups]
    [('load 51 and 53.1 kN is low', ('A', 'B'))]
    """
    groups: dict[Hashable, MessageGroup[Place]] = {}
    places: dict[Hashable, dict[Place, None]] = {}
    numbers: dict[Hashable, list[Mapping[str, tuple[str, ...]]]] = {}
    for place, message in messages:
        group = _single_group(
            message if isinstance(message, Notice) else text_notice(message), place
        )
        groups.setdefault(group.key, group)
        places.setdefault(group.key, {})[place] = None
        numbers.setdefault(group.key, []).append(group.numbers)
    return [
        replace(
            group,
            numbers={
                name: tuple(
                    map(_together, zip(*(each[name] for each in numbers[key]), strict=True))
                )
                for name in group.numbers
            },
            places=(*places[key],),
        )
        for key, group in groups.items()
    ]


def _single_group(notice: Notice, place: Place) -> MessageGroup[Place]:
    split = {name: split_numbers(text) for name, text in notice.texts().items()}
    return MessageGroup(
        notice.code,
        {name: pattern for name, (pattern, _) in split.items()},
        {name: numbers for name, (_, numbers) in split.items()},
        notice.words(),
        (place,),
    )


def split_numbers(text: str) -> tuple[str, tuple[str, ...]]:
    """A message as a pattern and its numbers.

    Examples
    --------
    >>> split_numbers("12-points.prjz: peaks are +0.0 to +194.8 % off (12+320)")
    ('12-points.prjz: peaks are {} % off (12+320)', ('+0.0 to +194.8',))
    """
    return _NUMBER.sub(lambda _: GAP, text.replace(GAP, "( )")), tuple(_NUMBER.findall(text))


def fill(pattern: str, numbers: Sequence[str]) -> str:
    """A pattern with its gaps filled from the left."""
    parts = pattern.split(GAP)
    return parts[0] + "".join(
        number + part for number, part in zip(numbers, parts[1:], strict=True)
    )


def _together(values: Sequence[str]) -> str:
    different = list(dict.fromkeys(values))
    if len(different) == 1:
        return different[0]
    ends = sorted((end for value in different for end in value.split(" to ")), key=float)
    if len(different) <= MAX_LISTED_VALUES and len(ends) == len(different):
        return " and ".join(ends)
    signed = any(end.startswith(("+", "-")) for end in ends)
    return f"{ends[0]}{' to ' if signed else DASH}{ends[-1]}"


def as_ranges(chosen: Iterable[str], order: Sequence[str]) -> str:
    """Names as ranges of an order, so that many do not become a list.

    Parameters
    ----------
    chosen : iterable of str
        Among the names of the order.
    order : sequence of str
        All names, each once.

    Examples
    --------
    >>> as_ranges(["A", "B", "C", "E"], ["A", "B", "C", "D", "E"])
    'A to C, E'
    >>> as_ranges(["A", "B"], ["A", "B", "C"])
    'A, B'
    """
    chosen_names = set(chosen)
    runs: list[list[str]] = []
    before = None
    for index, name in enumerate(order):
        if name in chosen_names:
            if before == index - 1 and runs:
                runs[-1].append(name)
            else:
                runs.append([name])
            before = index
    return ", ".join(
        f"{run[0]} to {run[-1]}" if len(run) > MAX_LISTED_VALUES else ", ".join(run) for run in runs
    )
