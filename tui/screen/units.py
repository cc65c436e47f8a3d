"""Units on the screen: SI inside, SI or US customary outside, always shown beside the number."""

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

NOTHING = "-"

_POUND_FORCE = 4.4482216152605  # N, exact by definition
_INCH = 0.0254  # m
_PSI = _POUND_FORCE / _INCH**2  # Pa


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of the screen."""

    name: str
    scale: float
    """SI units in one of it."""


_SI: Mapping[QuantityName, Unit] = {
    "modulus": Unit("MPa", 1e6),
    "load": Unit("kN", 1e3),
    "deflection": Unit("µm", 1e-6),
    "settlement": Unit("mm", 1e-3),  # what a procedure judges, as its document writes it
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
        """The unit that a quantity is shown in."""
        return (_US if self.name == "us" else _SI)[quantity]

    def unit(self, quantity: QuantityName) -> str:
        """Its name."""
        return self.of(quantity).name

    def value(self, quantity: QuantityName, si: float | None) -> float | None:
        """A value of SI in the unit; None when there is none or it is not finite."""
        if si is None or not math.isfinite(si):
            return None
        return si / self.of(quantity).scale

    def si(self, quantity: QuantityName, value: float) -> float:
        """A value of the unit in SI."""
        return value * self.of(quantity).scale

    def text(self, quantity: QuantityName, si: float | None, digits: int = 3) -> str:
        """A value, without its unit, with so many digits that count."""
        return figures(self.value(quantity, si), digits)

    def with_unit(self, quantity: QuantityName, si: float | None, digits: int = 3) -> str:
        """A value with its unit."""
        text = self.text(quantity, si, digits)
        return text if text == NOTHING else f"{text} {self.unit(quantity)}"

    def measured(
        self, quantity: QuantityName, si: float | None, sd: float | None, digits: int = 4
    ) -> tuple[str, str]:
        """A value and its uncertainty with the same decimals; the latter "" when there is none."""
        value, deviation = self.value(quantity, si), self.value(quantity, sd)
        if value is None:
            return NOTHING, ""
        if deviation is None:
            return figures(value, 3), ""
        # Never more digits than the value is worth, however small the noise of its fit.
        decimals = min(_decimals(deviation or value, 2), _decimals(value, digits))
        least = 10.0**-decimals
        small = 0 < deviation < 0.5 * least
        error = f"<{least:.{decimals}f}" if small else f"{deviation:.{decimals}f}"
        return f"{value:.{decimals}f}", error


def judged_quantity(quantity: Quantity) -> QuantityName:
    """In which of the units what a procedure judges is shown."""
    return "settlement" if quantity is Quantity.DEFLECTION else "modulus"


SI, US = Units("si"), Units("us")
BY_NAME: Mapping[str, Units] = {"si": SI, "us": US}


def figures(value: float | None, digits: int = 3) -> str:
    """Digits that count, or all digits before the point when there are more.

    Examples
    --------
    >>> figures(47.26), figures(1234.5), figures(0.0312), figures(None)
    ('47.3', '1234', '0.0312', '-')
    """
    if value is None or not math.isfinite(value):
        return NOTHING
    return f"{value:.{_decimals(value, digits)}f}"


def percent(part: float | None) -> str:
    """A part of one in percent, two digits that count."""
    return NOTHING if part is None or not math.isfinite(part) else f"{figures(100 * part, 2)} %"


def _decimals(value: float, digits: int) -> int:
    if value == 0:
        return 0
    return min(6, max(0, digits - 1 - math.floor(math.log10(abs(value)))))
