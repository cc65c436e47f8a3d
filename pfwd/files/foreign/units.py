"""Units in other programs' files, as factors from the unit to SI."""

from collections.abc import Mapping

POUND_FORCE_N = 4.4482216152605
"""One pound-force, exact by the definitions of the pound and of standard gravity."""

INCH_M = 0.0254
"""One inch, exact."""

TIME_UNITS: Mapping[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
FORCE_UNITS: Mapping[str, float] = {
    "N": 1.0,
    "daN": 10.0,
    "kN": 1e3,
    "MN": 1e6,
    "kgf": 9.80665,
    "lbf": POUND_FORCE_N,
    "kip": 1e3 * POUND_FORCE_N,
}
DISPLACEMENT_UNITS: Mapping[str, float] = {
    "m": 1.0,
    "mm": 1e-3,
    "um": 1e-6,
    "in": INCH_M,
    "mil": 1e-3 * INCH_M,
}
VELOCITY_UNITS: Mapping[str, float] = {
    "m/s": 1.0,
    "cm/s": 1e-2,
    "mm/s": 1e-3,
    "um/s": 1e-6,
    "in/s": INCH_M,
}


def celsius(fahrenheit: float) -> float:
    """Convert degrees Fahrenheit to degrees Celsius."""
    return (fahrenheit - 32.0) / 1.8
