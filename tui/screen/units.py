"""Units on the screen: SI or US customary, always shown with the number; values inside are SI."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pfwd.procedures import Quantity

UnitsName = Literal["si", "us"]
QuantityName = Literal[
    "modulus",
    "load",
    "deflection",
    "settlement",
    "velocity",
    "length",
    "depth",
    "mass",
    "pressure",
    "viscosity",
    "density",
]

NO_VALUE = "-"

_POUND_FORCE = 4.4482216152605  # N, exact by definition
_INCH = 0.0254  # m
_PSI = _POUND_FORCE / _INCH**2  # Pa


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of the screen."""

    name: str
    scale: float
    """Size of the unit in SI units."""


_SI: Mapping[QuantityName, Unit] = {
    "modulus": Unit("MPa", 1e6),
    "load": Unit("kN", 1e3),
    "deflection": Unit("µm", 1e-6),
    "settlement": Unit("mm", 1e-3),  # the judged quantity, as its standard writes it
    "velocity": Unit("mm/s", 1e-3),
    "length": Unit("mm", 1e-3),
    "depth": Unit("m", 1.0),
    "mass": Unit("kg", 1.0),
    "pressure": Unit("kPa", 1e3),
    "viscosity": Unit("kPa s", 1e3),
    "density": Unit("kg/m³", 1.0),
}
_US: Mapping[QuantityName, Unit] = {
    "modulus": Unit("ksi", 1e3 * _PSI),
    "load": Unit("lbf", _POUND_FORCE),
    "deflection": Unit("mil", 1e-3 * _INCH),
    "settlement": Unit("mil", 1e-3 * _INCH),
    "velocity": Unit("in/s", _INCH),
    "length": Unit("in", _INCH),
    "depth": Unit("ft", 12 * _INCH),
    "mass": Unit("lb", 0.45359237),
    "pressure": Unit("psi", _PSI),
    "viscosity": Unit("psi s", _PSI),
    "density": Unit("lb/ft³", 0.45359237 / (12 * _INCH) ** 3),
}


@dataclass(frozen=True, slots=True)
class Units:
    """A system of units."""

    name: UnitsName

    def of(self, quantity: QuantityName) -> Unit:
        """Return the unit in which a quantity is shown."""
        return (_US if self.name == "us" else _SI)[quantity]

    def unit(self, quantity: QuantityName) -> str:
        """Return the name of the unit of a quantity."""
        return self.of(quantity).name

    def value(self, quantity: QuantityName, si: float | None) -> float | None:
        """Convert a value from SI; None when it is missing or not finite."""
        if si is None or not math.isfinite(si):
            return None
        return si / self.of(quantity).scale

    def si(self, quantity: QuantityName, value: float) -> float:
        """Convert a value to SI."""
        return value * self.of(quantity).scale

    def text(self, quantity: QuantityName, si: float | None, digits: int = 3) -> str:
        """Format a value with significant digits, without its unit."""
        return format_number(self.value(quantity, si), digits)

    def with_unit(self, quantity: QuantityName, si: float | None, digits: int = 3) -> str:
        """Format a value with its unit."""
        text = self.text(quantity, si, digits)
        return text if text == NO_VALUE else f"{text} {self.unit(quantity)}"

    def with_uncertainty(
        self, quantity: QuantityName, si: float | None, sd: float | None, digits: int = 4
    ) -> tuple[str, str]:
        """Format a value and its uncertainty with the same decimals; "" without an uncertainty."""
        value, deviation = self.value(quantity, si), self.value(quantity, sd)
        if value is None:
            return NO_VALUE, ""
        if deviation is None:
            return format_number(value, 3), ""
        # No more digits than the value supports, however small the noise of its fit.
        decimals = min(_decimals(deviation or value, 2), _decimals(value, digits))
        last_digit = 10.0**-decimals
        is_small = 0 < deviation < 0.5 * last_digit
        error = f"<{last_digit:.{decimals}f}" if is_small else f"{deviation:.{decimals}f}"
        return f"{value:.{decimals}f}", error


def judged_quantity(quantity: Quantity) -> QuantityName:
    """Return the quantity that gives the judged value its unit."""
    return "settlement" if quantity is Quantity.DEFLECTION else "modulus"


SI, US = Units("si"), Units("us")
UNITS_BY_NAME: Mapping[str, Units] = {"si": SI, "us": US}


def format_number(value: float | None, digits: int = 3) -> str:
    """Format a number with significant digits; all digits before the point are kept.

    Examples
    --------
    >>> format_number(47.26), format_number(1234.5), format_number(0.0312), format_number(None)
    ('47.3', '1234', '0.0312', '-')
    """
    if value is None or not math.isfinite(value):
        return NO_VALUE
    return f"{value:.{_decimals(value, digits)}f}"


def percent(part: float | None) -> str:
    """Format a fraction in percent with two significant digits."""
    return (
        NO_VALUE if part is None or not math.isfinite(part) else f"{format_number(100 * part, 2)} %"
    )


def _decimals(value: float, digits: int) -> int:
    if value == 0:
        return 0
    return min(6, max(0, digits - 1 - math.floor(math.log10(abs(value)))))
