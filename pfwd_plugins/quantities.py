"""Quantities that a channel of an instrument measures.

A new quantity is one member of :class:`Measurand`: setup files, the protocol, trace files,
column maps and the screen then have it. Instrument and inversion use this module, so it stands in
the lowest package.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any, Literal, NamedTuple, Self

MotionName = Literal["velocity", "displacement", "acceleration"]
"""Names of `MOTIONS`, for the types of arguments."""

POUND_FORCE_N = 4.4482216152605
"""One pound-force, exact by the definitions of the pound and of standard gravity."""

INCH_M = 0.0254
"""One inch, exact."""

_FORCE_UNITS = {
    "N": 1.0,
    "daN": 10.0,
    "kN": 1e3,
    "MN": 1e6,
    "kgf": 9.80665,
    "lbf": POUND_FORCE_N,
    "kip": 1e3 * POUND_FORCE_N,
}
_VELOCITY_UNITS = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "um/s": 1e-6, "in/s": INCH_M}
_ACCELERATION_UNITS = {"m/s2": 1.0, "g": 9.80665, "mg": 9.80665e-3, "mm/s2": 1e-3}
_DISPLACEMENT_UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "in": INCH_M, "mil": 1e-3 * INCH_M}


class Unit(NamedTuple):
    """Unit in which numbers are shown: name and size."""

    name: str
    scale: float
    """Size of the unit in SI units."""


class Measurand(StrEnum):
    """Quantity that a channel measures; the value is its name in files and in JSON."""

    unit: str
    """SI unit."""
    role: str
    """Role of a channel with such a sensor, in setup files and in JSON."""
    code: int
    """The same role in the protocol."""
    column: str
    """Name of its column in a trace file; empty: trace files do not have it."""
    integrations: int
    """Number of integrations to a displacement; -1: it is no motion."""
    units: Mapping[str, float]
    """Units in other programs' files, as factors from the unit to SI."""
    display_unit: Unit
    """Unit on the screen."""
    us_display_unit: Unit
    """Unit on the screen in US customary units."""
    live_range: float
    """Smallest range of the live plot, in the unit on the screen."""

    def __new__(cls, name: str, *properties: Any) -> Self:
        """Return a member with its properties, in the order of the annotations above."""
        member = str.__new__(cls, name)
        member._value_ = name
        vars(member).update(zip(cls.__annotations__, properties, strict=True))
        return member

    LOAD = (
        *("load", "N", "load", 1, "load_N", -1),
        *(_FORCE_UNITS, Unit("kN", 1e3), Unit("lbf", POUND_FORCE_N), 1.0),
    )
    """Force of the load cell."""
    VELOCITY = (
        *("velocity", "m/s", "geophone", 2, "velocity_m_s", 1),
        *(_VELOCITY_UNITS, Unit("mm/s", 1e-3), Unit("in/s", INCH_M), 20.0),
    )
    """Velocity, with the response of the geophone."""
    DISPLACEMENT = (
        *("displacement", "m", "displacement", 3, "displacement_m", 0),
        *(_DISPLACEMENT_UNITS, Unit("µm", 1e-6), Unit("mil", 1e-3 * INCH_M), 1.0),
    )
    """Displacement, as of an integrated accelerometer or a laser."""
    ACCELERATION = (
        *("acceleration", "m/s²", "accelerometer", 4, "acceleration_m_s2", 2),
        *(_ACCELERATION_UNITS, Unit("g", 9.80665), Unit("g", 9.80665), 1.0),
    )
    """Acceleration, without the gravity of the earth."""
    VOLTAGE = (
        *("voltage", "V", "unused", 0, "", -1),
        *({"V": 1.0}, Unit("V", 1.0), Unit("V", 1.0), 1.0),
    )
    """Voltage of a channel that is ignored, and therefore not calibrated."""

    @property
    def is_motion(self) -> bool:
        """True if sensors of motion measure it."""
        return self.integrations >= 0

    @property
    def sensitivity_unit(self) -> str:
        """SI unit of the sensitivity of a sensor; empty: the channel has no sensor."""
        if self is Measurand.VOLTAGE:
            return ""
        return f"V/({self.unit})" if "/" in self.unit else f"V/{self.unit}"


MOTIONS = tuple(quantity for quantity in Measurand if quantity.is_motion)
"""Quantities of the sensors of motion."""

QUANTITY_BY_ROLE = {quantity.role: quantity for quantity in Measurand}
"""Quantity by the role of a channel."""


def motion(name: str) -> Measurand:
    """Return the quantity of motion with a name.

    Raises
    ------
    ValueError
        If a sensor of motion does not measure such a quantity.
    """
    for quantity in MOTIONS:
        if quantity == name:
            return quantity
    raise ValueError(f"expected the quantity {' or '.join(MOTIONS)}, got {name!r:.40}")
