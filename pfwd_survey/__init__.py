"""Joins instrument and inversion: files, points and drops, results.

The names below are loaded on first use, so that the command line answers before scipy is in.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pfwd_survey.files.traces import read_traces, write_traces
    from pfwd_survey.inverting.analysis import analyse_files, analyse_point, record_of
    from pfwd_survey.inverting.options import AnalysisOptions

__all__ = [
    "AnalysisOptions",
    "analyse_files",
    "analyse_point",
    "read_traces",
    "record_of",
    "write_traces",
]

_HOMES = {
    "AnalysisOptions": "inverting.options",
    "analyse_files": "inverting.analysis",
    "analyse_point": "inverting.analysis",
    "read_traces": "files.traces",
    "record_of": "inverting.analysis",
    "write_traces": "files.traces",
}


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
