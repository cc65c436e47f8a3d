"""Pages of a survey for a browser: an overview with map and profile, and one page for each point.

They contain no script and load nothing from other servers. The page of a point is the same as in
the report, which also draws the pictures. Nothing is inverted.
"""

import urllib.parse
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

from pfwd.files.photos import photos_of
from tui.output import counted
from tui.screen.opened.rows import PointRow, judged_cells, shares

if TYPE_CHECKING:
    import jinja2

MAX_PICTURE_POINTS = 400
"""Largest number of points in map and profile; more would overlap and take too long to draw."""

Photos = Literal["keep", "strip"]
"""What to do with the position that a camera stores in an uploaded photo: keep or remove ("strip")
it."""

_UPLOAD_NOTES = {
    "keep": "JPEG or PNG. The position in the photo is kept.",
    "strip": "JPEG or PNG. The position in the photo is removed.",
}

OVERVIEW_PICTURES = {
    "profile": "Judged value of each point with its interval and target",
    "map": "Points from above, by their verdict",
}
"""Captions of the pictures by name. A name with "-small" appended is the picture for a phone."""

_PICTURE_SIZES = {"": (180.0, 80.0), "-small": (95.0, 75.0)}
"""Width and height, mm, by the ending of the name: letters have the same size on a phone."""


PICTURE_NAMES = [name + size for name in OVERVIEW_PICTURES for size in _PICTURE_SIZES]


def point_address(name: str) -> str:
    """Return the path of a point's page in the URL."""
    return f"/point/{urllib.parse.quote(name, '', errors='surrogatepass')}"


def parse_point_address(path: str) -> tuple[str, str]:
    """Return the name of a point and the rest of a URL's path; two empty texts: another page."""
    parts = path.split("/", 3)
    if len(parts) < 3 or parts[:2] != ["", "point"]:
        return "", ""
    return urllib.parse.unquote(parts[2], errors="surrogatepass"), "".join(parts[3:])


def plain_row(row: PointRow) -> dict[str, Any]:
    """Return a point as JSON data in SI units."""
    return {
        "point": row.title,
        "chainage_m": row.chainage_m,
        "latitude": row.latitude,
        "longitude": row.longitude,
        "quantity": row.quantity,
        "value": row.value,
        "interval": None if row.low is None else [row.low, row.high],
        "unit": row.unit,
        "target": row.target,
        "verdict": row.verdict,
        "drops": row.drops,
        "discarded": row.discarded,
    }


def overview_page(folder: str, title: str, rows: Sequence[PointRow]) -> str:
    """Return the page with all points as HTML: counts, pictures, and a table with links.

    Parameters
    ----------
    folder : path of the survey
    title : str
    rows : sequence of PointRow
    """
    counts = ", ".join(f"{count} {state}" for state, count in shares(rows))
    is_drawable = {
        "profile": sum(row.value is not None for row in rows) > 1,
        "map": any(row.latitude is not None for row in rows),
    }
    is_drawn = len(rows) <= MAX_PICTURE_POINTS
    return _render(
        "overview.html.j2",
        title=title,
        refresh=True,
        summary=f"{counted(len(rows), 'point')}: {counts}",
        pictures=[item for item in OVERVIEW_PICTURES.items() if is_drawn and is_drawable[item[0]]],
        rows=[_overview_row(folder, row) for row in rows],
        any_marked=any(row.value_marked and row.value is not None for row in rows),
    )


def _overview_row(folder: str, row: PointRow) -> dict[str, str]:
    photos = len(photos_of(folder, row.name))
    remarks = (row.notes, row.diagnosis_text, counted(photos, "photo") if photos else "")
    cells = judged_cells(row)
    return {
        **cells,
        "address": point_address(row.name),
        "title": row.title,
        "remark": "; ".join(filter(None, remarks)),
        "interval": cells["interval"] or "-",
        "kind": row.state.lower() if row.state in ("PASS", "FAIL", "UNDECIDED") else "none",
        "state": row.state,
    }


def point_page(folder: str, row: PointRow, rows: Sequence[PointRow], photos: Photos | None) -> str:
    """Return the page of a point as HTML: its part of the report, and its photos.

    Parameters
    ----------
    folder : path of the survey
    row : PointRow
        The point.
    rows : sequence of PointRow
        All points, for links to the previous and the next one.
    photos : {"keep", "strip"}, optional
        The page has a form to add photos. None: photos are only shown.
    """
    from markupsafe import Markup

    from pfwd.report.gathering import gather_stored
    from pfwd.report.html_file import render_part
    from pfwd.report.point_blocks import point_blocks

    report = gather_stored(folder, row.name)
    texts = _texts()
    parts = [render_part(point_blocks(point, report, texts)) for point in report.points]
    place = rows.index(row)
    neighbours = {
        "previous": rows[place - 1] if place > 0 else None,
        "following": rows[place + 1] if place + 1 < len(rows) else None,
    }
    links = {
        key: None if point is None else (point.title, point_address(point.name))
        for key, point in neighbours.items()
    }
    return _render(
        "point.html.j2",
        title=row.title,
        refresh=False,
        body=Markup("\n".join(parts)),
        address=point_address(row.name),
        photos=[photo.name for photo in photos_of(folder, row.name)],
        uploads=None if photos is None else _UPLOAD_NOTES[photos],
        **links,
    )


def draw_overview_picture(folder: str, name: str) -> str:
    """Draw a picture of all points and return it as SVG.

    Parameters
    ----------
    folder : path of the survey
    name : str
        One of `PICTURE_NAMES`.
    """
    from functools import partial

    from pfwd.report import drawing
    from pfwd.report.blocks import Picture
    from pfwd.report.fonts import Letters
    from pfwd.report.gathering import gather_stored
    from pfwd.report.pictures_as_svg import svg_of

    kind = name.removesuffix("-small")
    draw = drawing.draw_map if kind == "map" else drawing.draw_profile
    width, height = _PICTURE_SIZES[name.removeprefix(kind)]
    report = gather_stored(folder)
    drawn = partial(draw, report=report, texts=_texts(), letters=Letters())
    return svg_of(Picture(drawn, height, "", OVERVIEW_PICTURES[kind]), width)


@cache
def _texts() -> Any:
    from pfwd.report.texts import load_texts

    return load_texts("en")


@cache
def _environment() -> "jinja2.Environment":
    import jinja2

    return jinja2.Environment(
        loader=jinja2.PackageLoader("tui.page"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _render(template: str, **values: Any) -> str:
    from markupsafe import Markup

    from pfwd.report.html_file import style_sheet

    style = Markup(style_sheet())
    return _environment().get_template(template).render(style=style, **values)


FORM = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>pfwd</title>
<meta name="viewport" content="width=device-width, initial-scale=1"></head>
<body><form><p><label>Code that the terminal of the survey shows:
<input name="code" inputmode="numeric" autofocus></label>
<button>Open</button></p></form></body></html>
"""
