"""Errors of the survey. A message says what was expected, what came, where, and what to try."""

from pfwd_device.errors import DeviceError, RecordingError, quote, refusal

__all__ = [
    "DeviceError",
    "OptionError",
    "RecordingError",
    "SurveyError",
    "TraceError",
    "quote",
    "refusal",
]


class SurveyError(Exception):
    """Base of everything the survey refuses."""


class TraceError(SurveyError, ValueError):
    """A trace file or its header is refused; the message names the file and the line."""


class OptionError(SurveyError, ValueError):
    """The options of an analysis are outside their range or contradict each other."""
