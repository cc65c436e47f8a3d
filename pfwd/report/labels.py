"""Names beside markers that hide neither each other nor a marker."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import takewhile
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from matplotlib.transforms import Bbox


LABEL_GAP_PT = 6.0
"""Distance between a marker and its name."""

_DIRECTIONS = (
    *((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)),
    *((0.8, 0.8), (0.8, -0.8), (-0.8, 0.8), (-0.8, -0.8)),
)
"""Directions from a marker in which a place for its name is tried."""

_STEPS = (1.0, 2.0, 3.5, 5.5, 8.0)
"""Distances that are tried, in gaps."""

LINE_FROM_GAPS = 3.0
"""Distance from which a line leads to the name, in gaps."""


class LabelPlace(NamedTuple):
    """Place of a name beside its marker."""

    number: int
    """Index of the marker."""
    dx: float
    """Points from the marker to the centre of the name, to the right."""
    dy: float
    """The same, upwards."""
    has_line: bool
    """True if it is so distant that a line leads to it."""


def place_labels(
    markers: Sequence[tuple[float, float]],
    sizes: Sequence[tuple[float, float]],
    room: Bbox,
    radius: float = 4.5,
) -> list[LabelPlace]:
    """Return places for names, the first ones first; a name that fits nowhere has none.

    Parameters
    ----------
    markers : sequence of (x, y), points of the page
    sizes : sequence of (width, height), points
        Of the names.
    room : Box
        Rectangle that contains all names.
    radius : float, points
        Of a marker.

    Returns
    -------
    list of LabelPlace
    """
    occupied = [_box(x, y, 2 * radius, 2 * radius) for x, y in markers]
    places = []
    for index, ((x, y), (width, height)) in enumerate(zip(markers, sizes, strict=True)):
        place = _place(x, y, width, height, room, occupied)
        if place is None:
            continue
        dx, dy, step = place
        occupied.append(_box(x + dx, y + dy, width, height))
        places.append(LabelPlace(index, dx, dy, step >= LINE_FROM_GAPS))
    return places


def _place(
    x: float, y: float, width: float, height: float, room: Bbox, occupied: Sequence[Bbox]
) -> tuple[float, float, float] | None:
    for step in _STEPS:
        for along, up in _DIRECTIONS:
            dx = along * (LABEL_GAP_PT * step) + along * width / 2
            dy = up * (LABEL_GAP_PT * step) + up * height / 2
            box = _box(x + dx, y + dy, width, height)
            inside = room.containsx(box.x0) and room.containsx(box.x1)
            inside = inside and room.containsy(box.y0) and room.containsy(box.y1)
            if inside and not any(box.overlaps(obstacle) for obstacle in occupied):
                return dx, dy, step
    return None


def _box(x: float, y: float, width: float, height: float) -> Bbox:
    from matplotlib.transforms import Bbox

    return Bbox.from_bounds(x - width / 2, y - height / 2, width, height)


def room_of(axes: Any) -> Bbox:
    """Return the rectangle of axes, points of the page."""
    from matplotlib.transforms import Bbox

    return Bbox(axes.get_window_extent().get_points() * (72.0 / axes.figure.dpi))


def on_page(axes: Any, points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the places of data, points of the page; the limits of the axes must be final."""
    scale = 72.0 / axes.figure.dpi
    return [(float(x) * scale, float(y) * scale) for x, y in axes.transData.transform(list(points))]


def common_beginning(names: Sequence[str]) -> str:
    """Return the common beginning of names, up to a blank or a slash.

    Examples
    --------
    >>> common_beginning(["2022-01-21 1", "2022-01-21 12"]), common_beginning(["12+300", "12+320"])
    ('2022-01-21 ', '')
    """
    if len(names) < 2:
        return ""
    alike = takewhile(lambda letters: len(set(letters)) == 1, zip(*names, strict=False))
    same = "".join(letters[0] for letters in alike)
    return same[: max(same.rfind(" "), same.rfind("/")) + 1]
