"""Units in other programs' files, as factors from the unit to SI."""

from collections.abc import Mapping

from pfwd_plugins.quantities import MOTIONS, Measurand

TIME_UNITS: Mapping[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
COLUMN_UNITS: Mapping[str, Mapping[str, float]] = {
    "time": TIME_UNITS,
    **{quantity: quantity.units for quantity in (Measurand.LOAD, *MOTIONS)},
}
"""Units of a column of numbers, by what it has."""


def celsius(fahrenheit: float) -> float:
    """Convert degrees Fahrenheit to degrees Celsius."""
    return (fahrenheit - 32.0) / 1.8
