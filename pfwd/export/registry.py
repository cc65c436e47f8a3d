"""The formats that a survey is exported to, by the name that the command line has for them.

A new one is a function ``write(order, path)`` in a module and one entry in ``OWN``; in another
package, an entry point of the group ``pfwd.export_formats``. Nothing heavy is imported here.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

import pfwd_plugins

if TYPE_CHECKING:
    from pfwd.export.rows import Order

    Write = Callable[[Order, str | os.PathLike[str]], list[str]]


@dataclass(frozen=True, slots=True)
class ExportFormat:
    """A kind of files that a survey can be written as."""

    name: str
    """On the command line; small letters."""
    holds: str
    """What such a file holds, in a few words for the help."""
    write: str | Write
    """Writes an order to a path and returns what was left out, a sentence each; or where that
    function is, as ``"module:function"``: imported when it is used."""
    with_results: bool = False
    """Whether it holds results, so that drops may be inverted for it."""
    by_parts: bool = False
    """Whether it makes a text of its rows with `row_texts`, so that a second process may help."""
    delimited: bool = False
    """Whether it is a text whose delimiter and decimal sign may be chosen."""

    def writer(self) -> Write:
        """The function ``write(order, path)``."""
        if not isinstance(self.write, str):
            return self.write
        module, _, function = self.write.partition(":")
        found: Write = getattr(import_module(module), function)
        return found


_HERE = __name__.rpartition(".")[0]

OWN: Mapping[str, ExportFormat] = MappingProxyType(
    {
        form.name: form
        for form in (
            ExportFormat("h5", "the whole survey", f"{_HERE}.surveys:write_h5"),
            ExportFormat("csv", "a folder of trace files", f"{_HERE}.surveys:write_csv"),
            ExportFormat(
                "table", "results as CSV", f"{_HERE}.tables:write_table", True, True, True
            ),
            ExportFormat(
                "points",
                "points with verdicts as CSV",
                f"{_HERE}.tables:write_points",
                True,
                delimited=True,
            ),
            ExportFormat("jsonl", "results as JSON", f"{_HERE}.tables:write_jsonl", True, True),
            ExportFormat("parquet", "results", f"{_HERE}.tables:write_parquet", True),
            ExportFormat("geojson", "results on the map", f"{_HERE}.maps:write_geojson", True),
            ExportFormat(
                "points-geojson",
                "the points on the map",
                f"{_HERE}.maps:write_points_geojson",
                True,
            ),
            ExportFormat("xlsx", "a workbook for Excel", f"{_HERE}.workbook:write_xlsx", True),
            ExportFormat("gpkg", "the points for GIS", f"{_HERE}.geopackage:write_gpkg", True),
            ExportFormat("gpx", "results as way points", f"{_HERE}.maps:write_gpx", True),
            ExportFormat("pddx", "peaks for pavement programs", f"{_HERE}.pddx:write_pddx"),
        )
    }
)
"""Those of this program."""


def find_format(name: str) -> ExportFormat | None:
    """The format of a name; None when there is none."""
    return OWN.get(name) or pfwd_plugins.load(pfwd_plugins.EXPORT_FORMATS, name, ExportFormat)


def format_names() -> tuple[str, ...]:
    """Names of all formats, those of other packages last."""
    others = pfwd_plugins.names(pfwd_plugins.EXPORT_FORMATS)
    return tuple(dict.fromkeys((*OWN, *others)))
