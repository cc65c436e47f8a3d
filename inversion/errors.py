"""Errors of the inversion. A message says what was expected, what came, where, and what to try."""


class InversionError(Exception):
    """Base of everything the inversion refuses."""


class ModelError(InversionError, ValueError):
    """A parameter of the model is outside its range; the message names it and the value."""


class RecordError(InversionError, ValueError):
    """The arrays of a record do not fit together or hold no usable drop."""


class RecordFormatError(InversionError, ValueError):
    """Stored JSON is no record; the message names the file and what was found."""
