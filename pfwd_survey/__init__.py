"""Joins instrument and inversion: files, points and drops, results.

The names below are loaded on first use, so that the command line answers before scipy is in.
"""

from typing import TYPE_CHECKING

from inversion import notices
from pfwd_plugins.lazy_names import lazy_getattr
from pfwd_survey import notice_texts

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
    "AnalysisOptions": "pfwd_survey.inverting.options",
    "analyse_files": "pfwd_survey.inverting.analysis",
    "analyse_point": "pfwd_survey.inverting.analysis",
    "read_traces": "pfwd_survey.files.traces",
    "record_of": "pfwd_survey.inverting.analysis",
    "write_traces": "pfwd_survey.files.traces",
}

notices.register(notice_texts.TEMPLATES, notice_texts.TERMS, notice_texts.EARLIER)

__getattr__ = lazy_getattr(globals(), _HOMES)
