"""Groups of equal messages about several points or drops, with their numbers joined to ranges.

"load 53.1 kN is low" of one point and "load 51 kN is low" of another become one message with two
places: "load 51 and 53.1 kN is low".
"""

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
"""Pattern of a number, or of two numbers with "to" between them. Numbers that are part of a name, a
date, a time or a chainage (12-points.prjz, 2022-01-21, 14:05, 12+320) do not match."""

GAP = "{}"
"""Placeholder of a number in a pattern."""

DASH = "\N{EN DASH}"
"""Character between the ends of a range; not "to", which may be in the message already."""

MAX_LISTED_VALUES = 2
"""Largest number of different values that are listed; more are written as a range."""


@dataclass(frozen=True, slots=True)
class MessageGroup(Generic[Place]):
    """One message and the places (points, drops) to which it applies."""

    code: str
    """Code of the warning; ``other``: a message without a code."""
    patterns: Mapping[str, str]
    """Texts of the message's parts by name, with ``{}`` in place of numbers; messages with equal
    patterns belong to one group."""
    numbers: Mapping[str, tuple[str, ...]]
    """Texts for the ``{}`` of each part by name: a number, two numbers, or a range."""
    words: Mapping[str, tuple[str, ...]]
    """Words of a fixed list in the message, by the name of the part, for translations."""
    places: tuple[Place, ...]
    """Places to which the message applies, in the order of their first message."""

    @property
    def key(self) -> Hashable:
        """Value that is equal for messages of one group."""
        return (self.code, *self.patterns.items())

    @property
    def texts(self) -> dict[str, str]:
        """Texts of the message's parts with numbers, by name."""
        return {name: fill(text, self.numbers[name]) for name, text in self.patterns.items()}

    @property
    def text(self) -> str:
        """Complete message in English."""
        return fill_template(templates()[self.code], self.texts)


def group_messages(messages: Iterable[tuple[Place, str]]) -> list[MessageGroup[Place]]:
    """Join messages that differ only in their numbers.

    Parameters
    ----------
    messages : iterable of (place, warning or other message)

    Returns
    -------
    list of MessageGroup
        In the order of the first message of each group.

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
    """Return a text with ``{}`` in place of its numbers, and the numbers.

    Examples
    --------
    >>> split_numbers("12-points.prjz: peaks are +0.0 to +194.8 % off (12+320)")
    ('12-points.prjz: peaks are {} % off (12+320)', ('+0.0 to +194.8',))
    """
    return _NUMBER.sub(lambda _: GAP, text.replace(GAP, "( )")), tuple(_NUMBER.findall(text))


def fill(pattern: str, numbers: Sequence[str]) -> str:
    """Return a pattern with each ``{}`` replaced by a number, from the left."""
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
    """Return names as text, with three or more consecutive ones as a range.

    Parameters
    ----------
    chosen : iterable of str
        Names, in any order.
    order : sequence of str
        All names in their order, each once.

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
