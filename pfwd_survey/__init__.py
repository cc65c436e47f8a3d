"""Joins instrument and inversion: files, points and drops, results.

The names below are loaded on first use, so that the command line answers before scipy is in.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pfwd_survey.analysis import analyse_files, analyse_point, record_of
    from pfwd_survey.options import AnalysisOptions
    from pfwd_survey.traces import read_traces, write_traces

__all__ = [
    "AnalysisOptions",
    "analyse_files",
    "analyse_point",
    "read_traces",
    "record_of",
    "write_traces",
]

_HOMES = {
    "AnalysisOptions": "options",
    "analyse_files": "analysis",
    "analyse_point": "analysis",
    "read_traces": "traces",
    "record_of": "analysis",
    "write_traces": "traces",
}


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
