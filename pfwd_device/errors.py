"""Errors of the instrument side. A message says what was expected, what came, and what to try."""


class DeviceError(Exception):
    """Base of everything the instrument side refuses."""


class DeviceLost(DeviceError, ConnectionError):
    """The instrument does not answer any more: unplugged, switched off or silent."""


class PortError(DeviceError, OSError):
    """A port cannot be opened: it does not exist, is in use or is no port."""


class DeviceRefused(DeviceError):
    """The instrument answered that it will not do what was asked."""


class ProtocolError(DeviceError, ValueError):
    """A message cannot be built or read; damaged input is counted, never raised."""


class SetupError(DeviceError, ValueError):
    """What is declared about the instrument is incomplete or outside its range; names the key."""


class RecordingError(DeviceError):
    """A survey cannot be read or written."""


class SurveyLocked(RecordingError):
    """Another program writes this survey."""


class StorageFull(RecordingError, OSError):
    """The disk took no more; what was to be saved is not acknowledged and still in memory."""
