"""Names beside markers that hide neither each other nor a marker."""

from collections.abc import Sequence
from typing import Any, NamedTuple


class Box(NamedTuple):
    """A rectangle, points of the page."""

    left: float
    bottom: float
    right: float
    top: float

    def hits(self, other: "Box") -> bool:
        """Whether two of them share something."""
        return (
            self.left < other.right
            and other.left < self.right
            and self.bottom < other.top
            and other.bottom < self.top
        )


GAP = 6.0
"""Points between a marker and its name."""

_AROUND = (
    *((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)),
    *((0.8, 0.8), (0.8, -0.8), (-0.8, 0.8), (-0.8, -0.8)),
)
"""Directions that a name is tried in."""

_STEPS = (1.0, 2.0, 3.5, 5.5, 8.0)
"""Distances, in gaps; from the third on a line leads to the name."""

LED_FROM = 3.0


class Placed(NamedTuple):
    """Where a name goes."""

    number: int
    """Place among the markers."""
    dx: float
    """Points from the marker to the middle of the name."""
    dy: float
    led: bool
    """Whether it is so far that a line leads to it."""


def place_labels(
    markers: Sequence[tuple[float, float]],
    sizes: Sequence[tuple[float, float]],
    room: Box,
    radius: float = 4.5,
) -> list[Placed]:
    """Places for names, the first ones first; a name that fits nowhere has none.

    Parameters
    ----------
    markers : sequence of (x, y), points of the page
    sizes : sequence of (width, height), points
        Of the names.
    room : Box
        That a name has to stay within.
    radius : float, points
        Of a marker.

    Returns
    -------
    list of Placed
    """
    taken = [Box(x - radius, y - radius, x + radius, y + radius) for x, y in markers]
    found = []
    for index, ((x, y), (width, height)) in enumerate(zip(markers, sizes, strict=True)):
        place = _place(x, y, width, height, room, taken)
        if place is None:
            continue
        dx, dy, step = place
        taken.append(_box(x + dx, y + dy, width, height))
        found.append(Placed(index, dx, dy, step >= LED_FROM))
    return found


def _place(
    x: float, y: float, width: float, height: float, room: Box, taken: Sequence[Box]
) -> tuple[float, float, float] | None:
    for step in _STEPS:
        for along, up in _AROUND:
            dx = along * (GAP * step) + along * width / 2
            dy = up * (GAP * step) + up * height / 2
            box = _box(x + dx, y + dy, width, height)
            inside = (
                box.left >= room.left
                and box.right <= room.right
                and box.bottom >= room.bottom
                and box.top <= room.top
            )
            if inside and not any(box.hits(other) for other in taken):
                return dx, dy, step
    return None


def _box(x: float, y: float, width: float, height: float) -> Box:
    return Box(x - width / 2, y - height / 2, x + width / 2, y + height / 2)


def room_of(axes: Any) -> Box:
    """The rectangle of axes, points of the page."""
    box, scale = axes.get_window_extent(), 72.0 / axes.figure.dpi
    return Box(box.x0 * scale, box.y0 * scale, box.x1 * scale, box.y1 * scale)


def on_page(axes: Any, points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Places of data, points of the page; the limits of the axes have to stand."""
    scale = 72.0 / axes.figure.dpi
    return [(float(x) * scale, float(y) * scale) for x, y in axes.transData.transform(list(points))]


def common_beginning(names: Sequence[str]) -> str:
    """What all names begin with, up to a blank or a slash; it says nothing beside each marker.

    Examples
    --------
    >>> common_beginning(["2022-01-21 1", "2022-01-21 12"]), common_beginning(["12+300", "12+320"])
    ('2022-01-21 ', '')
    """
    if len(names) < 2:
        return ""
    first, last = min(names), max(names)
    same = 0
    while same < min(len(first), len(last)) and first[same] == last[same]:
        same += 1
    cut = max(first.rfind(" ", 0, same), first.rfind("/", 0, same))
    return first[: cut + 1]
