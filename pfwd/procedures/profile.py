"""Contents of a procedure's profile: numbers with their sources. Nothing is computed here."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Literal, NamedTuple

from inversion.notices import Notice, term_text
from pfwd_plugins.quantities import Unit


class Quantity(StrEnum):
    """Quantity by which a procedure judges a point.

    Values of different quantities cannot be compared.
    """

    E_VD = "E_vd"
    """Dynamic modulus of deformation: factor × plate radius × nominal pressure over mean
    deflection.
    """
    E_LWD = "E_LWD"
    """Surface modulus: factor × (1 - nu²) × measured pressure × plate radius over mean deflection.
    """
    MODULUS = "modulus"
    """Modulus of the ground, fitted to the full traces."""
    EQUIVALENT_MODULUS = "equivalent-modulus"
    """Modulus of the half-space that deflects as much under the plate as the fitted ground."""
    DEFLECTION = "deflection"
    """Mean peak deflection; smaller is better."""

    @property
    def other_fitted(self) -> "Quantity":
        """Fitted modulus that is shown beside this quantity as not judged."""
        is_modulus = self is Quantity.MODULUS
        return Quantity.EQUIVALENT_MODULUS if is_modulus else Quantity.MODULUS

    @property
    def unit(self) -> str:
        """SI unit."""
        return "m" if self is Quantity.DEFLECTION else "Pa"

    @property
    def display_unit(self) -> Unit:
        """Unit on screens and in reports."""
        return Unit("mm", 1e-3) if self is Quantity.DEFLECTION else Unit("MPa", 1e6)

    @property
    def dimension(self) -> Literal["settlement", "modulus"]:
        """Entry of `pfwd.units` with the unit in which the quantity is shown."""
        return "settlement" if self is Quantity.DEFLECTION else "modulus"

    @property
    def words(self) -> str:
        """Name of the quantity in a sentence."""
        return self.value.replace("-", " ")

    @property
    def label(self) -> str:
        """Short name, as in the title of a column."""
        return "E_eq" if self is Quantity.EQUIVALENT_MODULUS else self.value

    @property
    def term(self) -> str:
        """Name of the quantity in messages; both fitted moduli are "modulus"."""
        return Quantity.MODULUS if self.is_fitted else self

    @property
    def is_fitted(self) -> bool:
        """True for a modulus that is fitted to the full traces."""
        return self in (Quantity.MODULUS, Quantity.EQUIVALENT_MODULUS)


@dataclass(frozen=True, slots=True)
class SourcedNumber:
    """Number in a procedure's profile, with its source."""

    value: float
    """Value in the SI unit that the key in the profile names."""
    source: str
    """Document and place that state the number."""
    verified: bool
    """True when a public text confirms the number; others are enforced on request only."""


@dataclass(frozen=True, slots=True)
class Target:
    """Target for the judged value of a point, for all or some materials and moistures."""

    value: SourcedNumber
    """Target value, Pa, or m for a deflection."""
    material: str | None = None
    """Material that the target is limited to; None: any material."""
    moisture_from: float | None = None
    """Smallest moisture that the target applies to, percent by mass, inclusive; None: no limit."""
    moisture_to: float | None = None
    """Largest moisture that the target applies to, percent by mass, exclusive; None: no limit."""


class Check(NamedTuple):
    """Description of a limit that a procedure's profile may state."""

    unit: str
    """Unit in which the limit is shown."""
    scale: float
    """Factor from the SI value to the shown value."""


CHECKS: Mapping[str, Check] = MappingProxyType(
    {
        "false_trigger_load_n": Check("kN", 1e-3),
        "least_peak_load_n": Check("kN", 1e-3),
        "most_peak_load_n": Check("kN", 1e-3),
        "shortest_pulse_s": Check("ms", 1e3),
        "longest_pulse_s": Check("ms", 1e3),
        "least_deflection_m": Check("mm", 1e3),
        "most_deflection_m": Check("mm", 1e3),
        "most_offset_over_peak": Check("%", 1e2),
        "most_return_over_peak": Check("%", 1e2),
        "most_load_deviation": Check("%", 1e2),
        "most_radius_deviation": Check("%", 1e2),
        "most_residual": Check("%", 1e2),
        "most_load_spread": Check("%", 1e2),
        "most_deflection_spread": Check("%", 1e2),
        "most_modulus_spread": Check("%", 1e2),
        "least_value_pa": Check("MPa", 1e-6),
        "most_value_pa": Check("MPa", 1e-6),
        "most_s_over_v_s": Check("ms", 1e3),
    }
)
"""Descriptions of all limits that a profile may state, by the keys in the profile."""

_TERMS_OF_NUMBERS = {
    "seating": "seating_drops",
    "measured": "measured_drops",
    "factor": "plate_factor",
    "nominal_pressure_pa": "nominal_pressure",
    "nominal_load_n": "nominal_load",
    "plate_radius_m": "plate_radius",
}
"""Names in messages of the numbers that are no checks, by key."""


_SHOWN_UNITS = {
    "nominal_pressure_pa": (1e-3, "kPa"),
    "nominal_load_n": (1e-3, "kN"),
    "plate_radius_m": (1.0, "m"),
    **{key: (check.scale, check.unit) for key, check in CHECKS.items()},
}
"""Factor to the shown unit of a number, and that unit, by key; others have no unit."""


def term_of_number(key: str) -> str:
    """Return the name of a number of a procedure in messages, by its key."""
    return _TERMS_OF_NUMBERS.get(key, key)


def number_words(key: str) -> str:
    """Return the English name of a number of a procedure by its key."""
    return term_text(term_of_number(key))


OUR_TOLERANCES: Mapping[str, float] = MappingProxyType(
    {
        # E_vd changes in proportion to the load; drops of one height repeat within a few percent.
        "most_load_deviation": 0.10,
        # The same plate given in other units; the next size in use differs by a fifth.
        "most_radius_deviation": 0.01,
        # While the load acts, fits of sound records left a residual of 1 to 9 % of the peak, fits
        # of damaged records 11 to 78 %.
        "most_residual": 0.10,
    }
)
"""Tolerances, as fractions, that apply when a profile does not state them, by their keys in
`CHECKS`.
"""


class Tolerance(NamedTuple):
    """Tolerance as a fraction, and whether this program or a verified source states it."""

    value: float
    is_ours: bool
    """True: this program chose the tolerance; False: a verified source states it."""

    @property
    def message(self) -> Notice:
        """Tolerance as a part of messages, with its origin.

        Examples
        --------
        >>> Tolerance(0.1, is_ours=True).message.code
        'our-tolerance'
        """
        code = "our-tolerance" if self.is_ours else "tolerance"
        return Notice(code, {"tolerance": self.value})


@dataclass(frozen=True, slots=True, kw_only=True)
class Procedure:
    """Requirements of a standard or a contract on the drops of a test point."""

    name: str
    """Short name, the value of the option ``--procedure``."""
    title: str
    source: str
    """Document that states the requirements."""
    about: str = ""
    """Remarks for the user, in particular on numbers that could not be verified."""
    seating: SourcedNumber | None = None
    """Number of seating drops; None: the document does not state it."""
    measured: SourcedNumber | None = None
    """Number of averaged drops; None: the document does not state it."""
    quantity: Quantity = Quantity.MODULUS
    """Quantity by which a point is judged."""
    average: str = "deflection"
    """"deflection": the modulus of the mean deflection; "modulus": the mean of the moduli."""
    factor: SourcedNumber | None = None
    """Plate factor: 1.5 in E_vd; 2 (uniform), pi/2 (rigid), 8/3 (parabolic) in E_LWD."""
    nominal_pressure: SourcedNumber | None = None
    """Contact pressure that the procedure presumes, Pa; the formula of E_vd uses it in place of the
    measured one.
    """
    nominal_load: SourcedNumber | None = None
    """Peak load that the procedure presumes, N."""
    poisson_ratio: SourcedNumber | None = None
    """Poisson's ratio in the formula; None: the declared value of the point is used."""
    plate_radius: SourcedNumber | None = None
    """Plate radius that the procedure presumes, m."""
    centre_sensor: str | None = None
    """Place of the centre sensor that the procedure presumes, "plate" or "ground"; None: any."""
    checks: Mapping[str, SourcedNumber] = field(default_factory=dict)
    """Limits by their keys in `CHECKS`."""
    targets: tuple[Target, ...] = ()
    """Targets by material and moisture."""
    enforce_unverified: bool = False
    """True: numbers without a verified source are enforced, too."""
    text: str = field(default="", repr=False)
    """Text of the TOML file from which the procedure was read; a survey stores it."""
    file: str | None = None
    """Path of the TOML file; None: the procedure comes with the program."""

    def tolerance(self, check: str) -> "Tolerance":
        """Return the tolerance of a check, which is enforced whether or not its source is verified.

        Parameters
        ----------
        check : str
            Key of `OUR_TOLERANCES`, which has the value for a profile that does not state one.
        """
        number = self.checks.get(check)
        if number is None:
            return Tolerance(OUR_TOLERANCES[check], is_ours=True)
        return Tolerance(number.value, is_ours=not number.verified)

    def enforced(self, number: SourcedNumber | None) -> float | None:
        """Return the value of a number if it is enforced.

        The result is None if the profile lacks it, or it is not verified.
        """
        if number is None or not (number.verified or self.enforce_unverified):
            return None
        return number.value

    def limit(self, check: str) -> float | None:
        """Return the limit of a check, in SI units; None: the check is not enforced.

        Parameters
        ----------
        check : str
            Key of `CHECKS`.
        """
        return self.enforced(self.checks.get(check))

    @property
    def seating_drops(self) -> int | None:
        """Required number of seating drops; None: no number is enforced."""
        value = self.enforced(self.seating)
        return None if value is None else int(value)

    @property
    def measured_drops(self) -> int | None:
        """Required number of averaged drops; None: no number is enforced."""
        value = self.enforced(self.measured)
        return None if value is None else int(value)

    def as_recorded(self) -> dict[str, object]:
        """Return the values that a survey stores of its procedure.

        Its points can be judged again from them.

        The keys are ``name``, ``text``, ``file`` and ``enforce_unverified``.
        """
        return {
            "name": self.name,
            "text": self.text,
            "file": self.file,
            "enforce_unverified": self.enforce_unverified,
        }

    def numbers(self) -> dict[str, SourcedNumber]:
        """Return every number that the profile states, by its key.

        Targets have the keys ``target 1``, ``target 2`` and so on.
        """
        numbers: dict[str, SourcedNumber | None] = {
            "seating": self.seating,
            "measured": self.measured,
            "factor": self.factor,
            "nominal_pressure_pa": self.nominal_pressure,
            "nominal_load_n": self.nominal_load,
            "poisson_ratio": self.poisson_ratio,
            "plate_radius_m": self.plate_radius,
            **self.checks,
        }
        for index, target in enumerate(self.targets, 1):
            numbers[f"target {index}"] = target.value
        return {key: number for key, number in numbers.items() if number is not None}

    def shown_number(self, key: str) -> str:
        """Return a number that the profile states as text with its shown unit."""
        scale, unit = _SHOWN_UNITS.get(key, (1.0, ""))
        if key.startswith("target"):
            unit, size = self.quantity.display_unit
            scale = 1.0 / size
        return f"{self.numbers()[key].value * scale:g} {unit}".rstrip()

    def target_for(self, moisture: float | None, material: str | None) -> Target | None:
        """Return the first enforced target for a moisture (percent) and a material, or None.

        A target that is limited to a moisture or a material applies only to a point that declares
        them.
        """
        for target in self.targets:
            if self.enforced(target.value) is None:
                continue
            if target.material is not None and target.material != material:
                continue
            low, high = target.moisture_from, target.moisture_to
            if (low, high) != (None, None) and moisture is None:
                continue
            if moisture is not None and (
                (low is not None and moisture < low) or (high is not None and moisture >= high)
            ):
                continue
            return target
        return None
