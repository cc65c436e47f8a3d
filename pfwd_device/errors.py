"""Exceptions of the package `pfwd_device`, and the common form of their messages.

A message to the user says where the problem is, what was expected, what was found and what to do.
"""


class DeviceError(Exception):
    """Base class of the exceptions of the package `pfwd_device`."""


class DeviceLost(DeviceError, ConnectionError):
    """The link to the instrument failed after it was opened.

    The instrument was unplugged or switched off, or it sends nothing any more.
    """


class PortError(DeviceError, OSError):
    """A port cannot be opened: it does not exist, is in use or is not a port."""


class DeviceRefused(DeviceError):
    """The instrument refused a command."""


class ProtocolError(DeviceError, ValueError):
    """A message to the instrument cannot be encoded, or its reply breaks the protocol.

    Bytes that were damaged on the link raise no error: they are counted in `LinkCounters`.
    """


class SetupError(DeviceError, ValueError):
    """The description of the instrument is incomplete or out of range.

    The description is the setup file or the identity that the instrument reports. The message
    names the key.
    """


class RecordingError(DeviceError):
    """A survey cannot be read or written."""


class SurveyLocked(RecordingError):
    """Another program writes this survey."""


class StorageFull(RecordingError, OSError):
    """The disk is full: the data to be saved are only in memory and not reported as saved."""


MAX_QUOTE_LENGTH = 60
"""Characters of foreign text in a message: enough to find it, too few to flood a line."""


def refusal(where: str, expected: str, got: str, hint: str = "") -> str:
    """Return the message of an error in the form that all messages share.

    Parameters
    ----------
    where : str
        Place of the error: file and line, or an option.
    expected, got : str
        Description of the accepted values, and the value that was refused.
    hint : str
        Advice to the user; may be empty.

    Returns
    -------
    str
        ``where: expected ..., got ...; hint``
    """
    return f"{where}: expected {expected}, got {got}" + (f"; {hint}" if hint else "")


def quote(value: object) -> str:
    """Return a value from outside the program for use in a message.

    The text is in ASCII on one line, with escapes for all other characters, and at most
    `MAX_QUOTE_LENGTH` characters long.
    """
    try:
        text = ascii(value)
    except ValueError:  # Python does not convert integers of more than 4300 digits to text
        text = "a number of thousands of digits"
    return text if len(text) <= MAX_QUOTE_LENGTH else text[: MAX_QUOTE_LENGTH - 3] + "..."
