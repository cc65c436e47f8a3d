"""Units on the screen: SI or US customary, always shown with the number; values inside are SI."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from pfwd.digits import rounded, with_ends
from pfwd.procedures import Quantity
from pfwd_plugins.quantities import INCH_M, POUND_FORCE_N, Measurand, Unit

UnitsName = Literal["si", "us"]
QuantityName = Literal[
    "modulus",
    "load",
    "deflection",
    "settlement",
    "length",
    "depth",
    "mass",
    "pressure",
    "viscosity",
    "density",
]

NO_VALUE = "-"

_PSI = POUND_FORCE_N / INCH_M**2  # Pa

_SI: Mapping[str, Unit] = {
    **{quantity: quantity.display_unit for quantity in Measurand},
    "modulus": Unit("MPa", 1e6),
    "deflection": Measurand.DISPLACEMENT.display_unit,
    "settlement": Unit("mm", 1e-3),  # the judged quantity, as its standard writes it
    "length": Unit("mm", 1e-3),
    "depth": Unit("m", 1.0),
    "mass": Unit("kg", 1.0),
    "pressure": Unit("kPa", 1e3),
    "viscosity": Unit("kPa s", 1e3),
    "density": Unit("kg/m³", 1.0),
}
_US: Mapping[str, Unit] = {
    **{quantity: quantity.us_display_unit for quantity in Measurand},
    "modulus": Unit("ksi", 1e3 * _PSI),
    "deflection": Measurand.DISPLACEMENT.us_display_unit,
    "settlement": Unit("mil", 1e-3 * INCH_M),
    "length": Unit("in", INCH_M),
    "depth": Unit("ft", 12 * INCH_M),
    "mass": Unit("lb", 0.45359237),
    "pressure": Unit("psi", _PSI),
    "viscosity": Unit("psi s", _PSI),
    "density": Unit("lb/ft³", 0.45359237 / (12 * INCH_M) ** 3),
}


@dataclass(frozen=True, slots=True)
class Units:
    """System of units of the screen, SI or US customary."""

    name: UnitsName

    def of(self, quantity: QuantityName | Measurand) -> Unit:
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
        """Convert a value in the unit of the screen to SI."""
        return value * self.of(quantity).scale

    def text(self, quantity: QuantityName, si: float | None, digits: int = 3) -> str:
        """Format a value with significant digits, without its unit."""
        return format_number(self.value(quantity, si), digits)

    def with_unit(self, quantity: QuantityName, si: float | None, digits: int = 3) -> str:
        """Format a value with its unit."""
        text = self.text(quantity, si, digits)
        return text if text == NO_VALUE else f"{text} {self.unit(quantity)}"

    def value_and_ends(
        self, quantity: QuantityName, si: float | None, interval: Sequence[float] | None
    ) -> tuple[str, str]:
        """Format a value and its interval, without the unit, as the commands print them.

        Parameters
        ----------
        quantity : QuantityName
        si : float or None
            Value in SI units.
        interval : pair of float or None
            Lower and upper end in SI units.

        Returns
        -------
        tuple of str
            Value with the digits that the interval supports, and "low to high"; "" without an
            interval.

        Examples
        --------
        >>> SI.value_and_ends("modulus", 81.2e6, (71.6e6, 112.3e6))
        ('81', '72 to 112')
        """
        value = self.value(quantity, si)
        ends = [] if interval is None else [self.value(quantity, end) for end in interval]
        low, high = ends if len(ends) == 2 else (None, None)
        if value is None or low is None or high is None:
            return format_number(value), ""
        text, *end_texts = with_ends(value, (low, high))
        return text, " to ".join(end_texts)

    def with_interval(
        self,
        quantity: QuantityName,
        si: float | None,
        interval: Sequence[float] | None,
        mark: str = "",
    ) -> str:
        """Format a value with unit and interval, as `pfwd.digits.modulus_text` does for a modulus.

        The mark stands behind the value; the other parameters are those of `value_and_ends`.

        Examples
        --------
        >>> SI.with_interval("modulus", 81.2e6, (71.6e6, 112.3e6))
        '81 MPa (72 to 112)'
        """
        text, ends = self.value_and_ends(quantity, si, interval)
        if text == NO_VALUE:
            return text
        return f"{text}{mark} {self.unit(quantity)}" + (f" ({ends})" if ends else "")

    def with_deviation(
        self, quantity: QuantityName, si: float, deviation: float, spread: float
    ) -> str:
        """Format a value with its standard deviation and unit.

        Neither has digits beyond `spread`, the uncertainty from all sources, which is at least the
        deviation. A deviation that rounds to zero is not shown.
        """
        scale = self.of(quantity).scale
        value, around = (rounded(part / scale, spread / scale) for part in (si, deviation))
        text = value if float(around) == 0.0 else f"{value} ± {around}"
        return f"{text} {self.unit(quantity)}"


def judged_quantity(quantity: Quantity) -> QuantityName:
    """Return the entry of the units for the quantity that a procedure judges."""
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
