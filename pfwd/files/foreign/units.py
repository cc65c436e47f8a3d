"""Units of other programs' files as factors to SI."""

from collections.abc import Mapping

POUND_FORCE = 4.4482216152605
"""N; exact by the international definitions of pound and standard gravity."""

INCH = 0.0254
"""m; exact."""

TIME: Mapping[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
FORCE: Mapping[str, float] = {
    "N": 1.0,
    "daN": 10.0,
    "kN": 1e3,
    "MN": 1e6,
    "kgf": 9.80665,
    "lbf": POUND_FORCE,
    "kip": 1e3 * POUND_FORCE,
}
DISPLACEMENT: Mapping[str, float] = {
    "m": 1.0,
    "mm": 1e-3,
    "um": 1e-6,
    "in": INCH,
    "mil": 1e-3 * INCH,
}
VELOCITY: Mapping[str, float] = {
    "m/s": 1.0,
    "cm/s": 1e-2,
    "mm/s": 1e-3,
    "um/s": 1e-6,
    "in/s": INCH,
}


def celsius(fahrenheit: float) -> float:
    """Degrees Celsius of degrees Fahrenheit."""
    return (fahrenheit - 32.0) / 1.8
