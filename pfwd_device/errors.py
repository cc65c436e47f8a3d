"""Errors of the instrument side. A message has the expected and the actual value and a remedy."""


class DeviceError(Exception):
    """Base class of the errors of the instrument side."""


class DeviceLost(DeviceError, ConnectionError):
    """The instrument does not answer any more: unplugged, switched off or silent."""


class PortError(DeviceError, OSError):
    """A port cannot be opened: it does not exist, is in use or is no port."""


class DeviceRefused(DeviceError):
    """The instrument refused a command."""


class ProtocolError(DeviceError, ValueError):
    """A message cannot be built or read; damaged input is counted, never raised."""


class SetupError(DeviceError, ValueError):
    """The declared instrument is incomplete or out of range; the message names the key."""


class RecordingError(DeviceError):
    """A survey cannot be read or written."""


class SurveyLocked(RecordingError):
    """Another program writes this survey."""


class StorageFull(RecordingError, OSError):
    """The disk is full: the data that were to be saved are in memory and not acknowledged."""


MAX_QUOTE_LENGTH = 60
"""Characters of foreign text in a message: enough to find it, too few to flood a line."""


def refusal(where: str, expected: str, got: str, hint: str = "") -> str:
    """Return the message of an error in the form that all messages share.

    Parameters
    ----------
    where : str
        File and line, or the option.
    expected, got : str
    hint : str
        Advice; may be empty.

    Returns
    -------
    str
        ``where: expected ..., got ...; hint``
    """
    return f"{where}: expected {expected}, got {got}" + (f"; {hint}" if hint else "")


def quote(value: object) -> str:
    """Return a foreign value for a message: escaped, on one line, of bounded length."""
    try:
        text = ascii(value)
    except ValueError:  # Python writes no whole number of more than 4300 digits
        text = "a number of thousands of digits"
    return text if len(text) <= MAX_QUOTE_LENGTH else text[: MAX_QUOTE_LENGTH - 3] + "..."
