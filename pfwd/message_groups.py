"""Groups of equal messages about several points or drops, with their numbers joined to ranges.

"load 53.1 kN is low" of one point and "load 51 kN is low" of another become one message with two
places: "load 51 and 53.1 kN is low".
"""

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from inversion.notices import (
    MAX_LISTED_VALUES,
    TEXT_FORMS,
    Joined,
    Notice,
    Value,
    form_of,
    text_of,
)

__all__ = ["MessageGroup", "Notice", "as_ranges", "group_messages", "text_of"]

Place = TypeVar("Place", bound=Hashable)


@dataclass(frozen=True, slots=True)
class MessageGroup(Generic[Place]):
    """One message and the places (points, drops) to which it applies."""

    message: Notice
    """The message, with the numbers of all places joined."""
    key: Hashable
    """Value that is equal for messages of one group."""
    places: tuple[Place, ...]
    """Places to which the message applies, in the order of their first message."""

    @property
    def text(self) -> str:
        """The message in English."""
        return text_of(self.message)


def group_messages(messages: Iterable[tuple[Place, Notice]]) -> list[MessageGroup[Place]]:
    """Join messages that differ only in their numbers.

    Parameters
    ----------
    messages : iterable of (place, message)

    Returns
    -------
    list of MessageGroup
        In the order of the first message of each group.

    Examples
    --------
    >>> from inversion.notices import Notice
    >>> first = Notice("plate-radius-suspect", {"plate_radius_m": 15.0})
    >>> second = Notice("plate-radius-suspect", {"plate_radius_m": 30.0})
    >>> groups = group_messages([("A", first), ("B", second)])
    >>> [(group.text, group.places) for group in groups]
    [('units suspect: plate_radius_m = 15 and 30 (in metres?)', ('A', 'B'))]
    """
    groups: dict[Hashable, tuple[list[Notice], dict[Place, None]]] = {}
    for place, message in messages:
        equal, places = groups.setdefault(_key(message), ([], {}))
        equal.append(message)
        places[place] = None
    return [
        MessageGroup(_joined(equal), key, (*places,)) for key, (equal, places) in groups.items()
    ]


def _key(message: Notice) -> Hashable:
    """Return the code of a message with its values that are no numbers."""
    return (message.code, *((name, _key_of(message, name)) for name in message.values))


def _key_of(message: Notice, name: str) -> Hashable:
    value, form = message.values[name], form_of(message.code, name)
    if isinstance(value, Notice):
        return _key(value)
    if form == "digits":
        return None
    if form == "more":
        return bool(value)
    return value if form in (*TEXT_FORMS, "drops") or isinstance(value, str) else None


def _joined(messages: Sequence[Notice]) -> Notice:
    """Return messages with the same key as one, with their different numbers in its values."""
    first = messages[0]
    values: dict[str, Value] = {}
    for name, value in first.values.items():
        different = tuple(dict.fromkeys(message.values[name] for message in messages))
        if isinstance(value, Notice):
            values[name] = _joined([inner for inner in different if isinstance(inner, Notice)])
        else:
            values[name] = Joined(different) if len(different) > 1 else value
    return Notice(first.code, values)


def as_ranges(chosen: Iterable[str], order: Sequence[str], to: str = "to") -> str:
    """Return names as text, with three or more consecutive ones as a range.

    Parameters
    ----------
    chosen : iterable of str
        Names, in any order.
    order : sequence of str
        All names in their order, each once.
    to : str
        Word between the ends of a range.

    Examples
    --------
    >>> as_ranges(["A", "B", "C", "E"], ["A", "B", "C", "D", "E"])
    'A to C, E'
    >>> as_ranges(["A", "B"], ["A", "B", "C"])
    'A, B'
    """
    return ", ".join(f" {to} ".join(ends) for ends in ranges_of(chosen, order))


def ranges_of(chosen: Iterable[str], order: Sequence[str]) -> list[tuple[str, ...]]:
    """Return names, with the first and the last of three or more consecutive ones as a pair.

    Parameters
    ----------
    chosen, order
        As for `as_ranges`.
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
    return [
        ends
        for run in runs
        for ends in ([(run[0], run[-1])] if len(run) > MAX_LISTED_VALUES else [(n,) for n in run])
    ]
