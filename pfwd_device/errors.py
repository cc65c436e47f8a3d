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
