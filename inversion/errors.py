"""Errors of the inversion.

A message says what was expected, what was got, where, and what to do.
"""


class InversionError(Exception):
    """Base class of all errors of this package."""


class ModelError(InversionError, ValueError):
    """A parameter of the model is outside of its range; the message names it and the value."""


class RecordError(InversionError, ValueError):
    """The arrays of a record do not fit together, or contain no usable drop."""


class RecordFormatError(InversionError, ValueError):
    """Stored JSON is not a valid record; the message names the key and what was expected."""
