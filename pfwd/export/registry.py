"""Export formats by their name on the command line.

A new format is a function ``write(order, path)`` and one entry in `BUILT_IN_FORMATS`. In
another package it is an entry point of the group ``pfwd.export_formats`` that names an
`ExportFormat`. Functions are imported when they are used.
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
    """Format of the files to which a survey can be exported."""

    name: str
    """Name on the command line, in lower case."""
    holds: str
    """Content of the file, as a phrase for the help."""
    write: str | Write
    """Function ``write(order, path)`` that writes the file and returns one sentence for each
    omission, or its name ``"module:function"``, which is imported when it is used."""
    with_results: bool = False
    """True: the format holds results, so that drops may be inverted for it."""
    delimited: bool = False
    """True: a text in columns, whose delimiter and decimal sign may be chosen."""

    def writer(self) -> Write:
        """Return the function ``write(order, path)``, imported if necessary."""
        if not isinstance(self.write, str):
            return self.write
        module, _, name = self.write.partition(":")
        function: Write = getattr(import_module(module), name)
        return function


_PACKAGE = __name__.rpartition(".")[0]

BUILT_IN_FORMATS: Mapping[str, ExportFormat] = MappingProxyType(
    {
        form.name: form
        for form in (
            ExportFormat(
                "survey", "the survey in one file, .pfwdz", f"{_PACKAGE}.surveys:write_survey"
            ),
            ExportFormat("h5", "all data for other programs", f"{_PACKAGE}.hdf5:write_h5"),
            ExportFormat("csv", "a folder of trace files", f"{_PACKAGE}.surveys:write_csv"),
            ExportFormat("table", "results as CSV", f"{_PACKAGE}.tables:write_table", True, True),
            ExportFormat(
                "points",
                "points with verdicts as CSV",
                f"{_PACKAGE}.tables:write_points",
                True,
                delimited=True,
            ),
            ExportFormat("jsonl", "results as JSON", f"{_PACKAGE}.tables:write_jsonl", True),
            ExportFormat("parquet", "results", f"{_PACKAGE}.tables:write_parquet", True),
            ExportFormat("geojson", "results on the map", f"{_PACKAGE}.maps:write_geojson", True),
            ExportFormat(
                "points-geojson",
                "the points on the map",
                f"{_PACKAGE}.maps:write_points_geojson",
                True,
            ),
            ExportFormat("xlsx", "a workbook for Excel", f"{_PACKAGE}.workbook:write_xlsx", True),
            ExportFormat("gpkg", "the points for GIS", f"{_PACKAGE}.geopackage:write_gpkg", True),
            ExportFormat("gpx", "results as way points", f"{_PACKAGE}.maps:write_gpx", True),
            ExportFormat("pddx", "peaks for pavement programs", f"{_PACKAGE}.pddx:write_pddx"),
        )
    }
)
"""Formats of this program, by name."""

NAME_BY_ENDING = {"pfwdz": "survey"}
"""Formats with another name than the ending of their files."""


def find_format(name: str) -> ExportFormat | None:
    """Return a format by its name, or the ending of its files; None: there is no such format."""
    name = NAME_BY_ENDING.get(name, name)
    return BUILT_IN_FORMATS.get(name) or pfwd_plugins.load(
        pfwd_plugins.EXPORT_FORMATS, name, ExportFormat
    )


def format_names() -> tuple[str, ...]:
    """Return the names of all formats; those of plug-ins follow those of this program."""
    added = pfwd_plugins.names(pfwd_plugins.EXPORT_FORMATS)
    return tuple(dict.fromkeys((*BUILT_IN_FORMATS, *added)))
