"""Errors of the survey. A message says what was expected, what came, where, and what to try."""

from pfwd_device.errors import DeviceError, RecordingError

__all__ = [
    "DeviceError",
    "OptionError",
    "RecordingError",
    "SurveyError",
    "TraceError",
    "quote",
    "refusal",
]

LONGEST_QUOTE = (
    60  # characters of foreign text in a message: enough to find it, too few to flood a line
)


class SurveyError(Exception):
    """Base of everything the survey refuses."""


class TraceError(SurveyError, ValueError):
    """A trace file or its header is refused; the message names the file and the line."""


class OptionError(SurveyError, ValueError):
    """The options of an analysis are outside their range or contradict each other."""


def refusal(where: str, expected: str, got: str, hint: str = "") -> str:
    """One line for an error, in the form that all messages of the survey share.

    Parameters
    ----------
    where : str
        File and line, or the option.
    expected, got : str
    hint : str
        What to try; may be empty.

    Returns
    -------
    str
        ``where: expected ..., got ...; hint``
    """
    return f"{where}: expected {expected}, got {got}" + (f"; {hint}" if hint else "")


def quote(value: object) -> str:
    """A foreign value as it may stand in a message: escaped, on one line, of bounded length."""
    try:
        text = ascii(value)
    except ValueError:  # Python writes no whole number of more than 4300 digits
        text = "a number of thousands of digits"
    return text if len(text) <= LONGEST_QUOTE else text[: LONGEST_QUOTE - 3] + "..."
