"""The formats that a survey is exported to. Nothing heavy is imported here."""

from importlib import import_module
from typing import Any

FORMATS = {
    "h5": "whole_survey",
    "csv": "trace_files",
    "table": "table",
    "jsonl": "json_lines",
    "parquet": "parquet",
    "geojson": "geojson",
    "gpx": "gpx",
    "pddx": "pddx",
}
"""By name the module of this package with the function ``write(order, path)``."""

WITH_RESULTS = frozenset(["table", "jsonl", "parquet", "geojson", "gpx"])
"""The formats that hold results."""


def writer_of(form: str) -> Any:
    """The function ``write(order, path)`` of a format."""
    return import_module(f"pfwd_survey.exporting.{FORMATS[form]}").write
