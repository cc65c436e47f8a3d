"""Values as text with unit and uncertainty, SI or US customary; values inside are SI."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

from inversion.notices import ENGLISH, Language, term_text
from pfwd.digits import MAX_DIGITS, MISSING, declared, rounded, significant, with_ends
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
    "duration",
]

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
    "duration": Unit("ms", 1e-3),
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
    "duration": Unit("ms", 1e-3),
}
_EFFECTS = {
    "-": Unit("", 1.0),
    "s": Unit("ms", 1e-3),
    "m/s": Unit("mm/s", 1e-3),
    "N/m": Unit("MN/m", 1e6),
    "Pa": Unit("kPa", 1e3),
    "Pa s": Unit("kPa s", 1e3),
}

_MAX_PRINTED_RATIO = 1e4
"""Largest ratio of the ends of an interval that is shown for an undetermined value."""


def unit_of_effect(unit: str) -> Unit:
    """Return the unit in which a value of an effect is shown.

    Parameters
    ----------
    unit : str
        SI unit; "-": a number without a unit.

    Examples
    --------
    >>> unit_of_effect("s").name, unit_of_effect("Hz").name, unit_of_effect("-").name
    ('ms', 'Hz', '')
    """
    return _EFFECTS.get(unit) or Unit(unit, 1.0)


DECLARED = "given"
"""Note of a value that was declared; it is shown as it was given."""


UNDETERMINED = "left_open"
"""Note of a value that the data do not determine."""


class Fact(NamedTuple):
    """Value of a result with its uncertainty, as every output shows it; numbers are in SI units."""

    quantity: QuantityName | Measurand | Unit
    value: float | None
    """None: the data do not determine it, or the model lacks it."""
    interval: tuple[float, float] | None = None
    """95 % interval, or the interval that the note states."""
    deviation: float | None = None
    """Standard deviation of the noise; None: not known."""
    spread: float = 0.0
    """Relative uncertainty from all sources: a smaller deviation supports no more digits."""
    mark: str = ""
    """Mark of a value that the data do not support."""
    note: str = ""
    """Origin of the value or of the interval: a registered phrase."""


@dataclass(frozen=True, slots=True)
class Units:
    """System of units of the screen, SI or US customary."""

    name: UnitsName

    def of(self, quantity: QuantityName | Measurand | Unit) -> Unit:
        """Return the unit in which a quantity is shown."""
        if isinstance(quantity, Unit):
            return quantity
        return (_US if self.name == "us" else _SI)[quantity]

    def unit(self, quantity: QuantityName | Measurand | Unit) -> str:
        """Return the name of the unit of a quantity."""
        return self.of(quantity).name

    def value(self, quantity: QuantityName | Measurand | Unit, si: float | None) -> float | None:
        """Convert a value from SI; None when it is missing or not finite."""
        if si is None or not math.isfinite(si):
            return None
        return si / self.of(quantity).scale

    def si(self, quantity: QuantityName, value: float) -> float:
        """Convert a value in the unit of the screen to SI."""
        return value * self.of(quantity).scale

    def text(self, quantity: QuantityName, si: float | None, digits: int = 3) -> str:
        """Format a value with significant digits, without its unit."""
        return significant(self.value(quantity, si), digits)

    def with_unit(self, quantity: QuantityName, si: float | None, digits: int = 3) -> str:
        """Format a value with its unit."""
        text = self.text(quantity, si, digits)
        return text if text == MISSING else f"{text} {self.unit(quantity)}"

    def value_and_ends(self, fact: Fact, language: Language = ENGLISH) -> tuple[str, str]:
        """Return a value and the ends of its interval as text, without the unit.

        Returns
        -------
        tuple of str
            Value with the digits that its interval or deviation supports, and "low to high"; ""
            without an interval.

        Examples
        --------
        >>> SI.value_and_ends(Fact("modulus", 81.2e6, (71.6e6, 112.3e6)))
        ('81', '72 to 112')
        >>> SI.value_and_ends(Fact("density", 1990.0, deviation=12.3))
        ('1990 ± 12', '')
        """
        value, ends = self._value_and_ends(fact)
        texts = (text.replace(".", language.decimal) for text in (value, *ends))
        return next(texts), f" {language.to} ".join(texts)

    def _value_and_ends(self, fact: Fact) -> tuple[str, list[str]]:
        """Return a value and the ends of its interval, in English."""
        value = self.value(fact.quantity, fact.value)
        low, high = (self.value(fact.quantity, end) for end in fact.interval or (None, None))
        if low is not None and high is not None:
            centre = math.sqrt(low * high) if low > 0.0 else (low + high) / 2.0
            text, *ends = with_ends(centre if value is None else value, (low, high))
            return MISSING if value is None else f"{text}{fact.mark}", ends
        if fact.note == DECLARED and value is not None:
            # Converted to other units, it may have no end.
            return declared(value if self is SI else float(significant(value))), []
        deviation = self.value(fact.quantity, fact.deviation)
        if value is None or not deviation:
            return f"{significant(value)}{'' if value is None else fact.mark}", []
        # More digits than MAX_DIGITS are not supported, however small the deviation is.
        minimum = 10.0 ** (math.floor(math.log10(abs(value))) + 2 - MAX_DIGITS) if value else 0.0
        spread = max(deviation, abs(value) * fact.spread, minimum)
        text, around = rounded(value, spread), rounded(deviation, spread)
        return text if float(around) == 0.0 else f"{text} ± {around}", []

    def show(self, fact: Fact, language: Language = ENGLISH, *, with_unit: bool = True) -> str:
        """Return a value with unit, interval and note as one text in a language.

        Examples
        --------
        >>> SI.show(Fact("modulus", 45.2e6, (43.4e6, 47.1e6))), US.show(Fact("depth", 0.3048))
        ('45.2 MPa (43.4 to 47.1)', '1.00 ft')
        >>> SI.show(Fact("modulus", None, (11.2e6, 561.1e6)))
        'left open (11 to 560 MPa)'
        >>> SI.show(Fact("depth", 0.3, note=DECLARED), with_unit=False)
        '0.3 (given)'
        """
        value, ends = self.value_and_ends(fact, language)
        name = self.unit(fact.quantity)
        unit = f" {name}" if with_unit and name else ""
        if value != MISSING:
            note = ": ".join(filter(None, (fact.note and term_text(fact.note, language), ends)))
            return f"{value}{unit}" + (f" ({note})" if note else "")
        low, high = fact.interval or (0.0, 0.0)
        text = term_text(UNDETERMINED, language)
        if not ends:
            return text if fact.note == UNDETERMINED else MISSING
        return f"{text} ({ends}{unit})" if 0.0 < high < _MAX_PRINTED_RATIO * low else text


SI, US = Units("si"), Units("us")
UNITS_BY_NAME: Mapping[str, Units] = {"si": SI, "us": US}


def modulus_text(modulus: float | None, interval: tuple[float, float] | None) -> str:
    """Return a modulus, Pa, with its 95 % interval as text in MPa; a dash if there is none."""
    return SI.show(Fact("modulus", modulus, interval))


def percent(part: float | None) -> str:
    """Return a fraction as text in percent with two significant digits.

    Examples
    --------
    >>> percent(0.0042), percent(0.0996), percent(1.037), percent(None)
    ('0.42 %', '10 %', '104 %', '-')
    """
    text = significant(None if part is None else 100.0 * part, 2)
    return text if text == MISSING else f"{text} %"
