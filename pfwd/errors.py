"""Errors of this package; a message states what was expected, what was found, where, and what to
try.

`refusal` composes such a message, `quote` cuts a value from a file to a short text on one line.
"""

import sys

from pfwd_device.errors import DeviceError, PortError, RecordingError, quote, refusal

__all__ = [
    "DeviceError",
    "OptionError",
    "PortError",
    "RecordingError",
    "SurveyError",
    "TraceError",
    "how_to_install",
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


def how_to_install(extra: str) -> str:
    """Return the command that adds an extra of this program; it ends the line of a refusal."""
    if getattr(sys, "frozen", False):  # the one-folder program has no pip
        return f"use the program of a Python environment, with pfwd[{extra}]"
    return f'python -m pip install "pfwd[{extra}]"'
