"""Errors of this package; a message states what was expected, what was found, where, and what to
try.

`refusal` composes such a message, `quote` cuts a value from a file to a short text on one line.
"""

from pfwd_device.errors import DeviceError, PortError, RecordingError, quote, refusal

__all__ = [
    "DeviceError",
    "OptionError",
    "PortError",
    "RecordingError",
    "SurveyError",
    "TraceError",
    "quote",
    "refusal",
]


class SurveyError(Exception):
    """Base of the errors of this package: a survey, file, or request is refused."""


class TraceError(SurveyError, ValueError):
    """A trace file, a header, or another program's file is refused; the message names file and
    line.
    """


class OptionError(SurveyError, ValueError):
    """An option is outside its range, or options contradict each other."""
