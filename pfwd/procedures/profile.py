"""Procedure as it was read: numbers with their sources, nothing computed."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import NamedTuple


class Quantity(StrEnum):
    """Quantity by which a procedure judges a point. The four are different quantities."""

    E_VD = "E_vd"
    """Dynamic modulus of deformation: factor x radius x nominal pressure over mean deflection."""
    E_LWD = "E_LWD"
    """Surface modulus: factor x (1 - nu^2) x measured pressure x radius over mean deflection."""
    MODULUS = "modulus"
    """Modulus of the ground from the inversion of the full time history."""
    DEFLECTION = "deflection"
    """Mean peak deflection itself; smaller is better."""


@dataclass(frozen=True, slots=True)
class Number:
    """Number of a procedure with its source."""

    value: float
    """Value in the SI unit that the key names."""
    source: str
    """Document and place that state the number."""
    verified: bool
    """True when a public text confirms the number."""


@dataclass(frozen=True, slots=True)
class Target:
    """Value that a point has to reach."""

    value: Number
    """Pa, or m for a deflection."""
    material: str | None = None
    """Material that it applies to; None: any."""
    moisture_from: float | None = None
    """Percent by mass, inclusive; None: from any."""
    moisture_to: float | None = None
    """Percent by mass, exclusive; None: to any."""


class Check(NamedTuple):
    """Check that a profile can require."""

    unit: str
    """Unit in which people read the limit."""
    scale: float
    """Value in that unit over SI value."""
    words: str
    """Description of the limited quantity."""


CHECKS: Mapping[str, Check] = MappingProxyType(
    {
        "false_trigger_load_n": Check("kN", 1e-3, "peak load below which nothing fell"),
        "least_peak_load_n": Check("kN", 1e-3, "peak load, at least"),
        "most_peak_load_n": Check("kN", 1e-3, "peak load, at most"),
        "shortest_pulse_s": Check("ms", 1e3, "pulse duration, at least"),
        "longest_pulse_s": Check("ms", 1e3, "pulse duration, at most"),
        "least_deflection_m": Check("mm", 1e3, "peak deflection, at least"),
        "most_deflection_m": Check("mm", 1e3, "peak deflection, at most"),
        "most_offset_over_peak": Check("%", 1e2, "deflection before the drop over its peak"),
        "most_return_over_peak": Check("%", 1e2, "deflection left at the end over its peak"),
        "most_load_deviation": Check("%", 1e2, "peak load, deviation from the presumed one"),
        "most_radius_deviation": Check("%", 1e2, "plate radius, deviation from the presumed one"),
        "most_residual": Check("%", 1e2, "residual of a supported modulus over the peak"),
        "most_load_spread": Check("%", 1e2, "peak loads, largest less smallest over mean"),
        "most_deflection_spread": Check("%", 1e2, "deflections, largest less smallest over mean"),
        "most_modulus_spread": Check("%", 1e2, "moduli, largest less smallest over mean"),
        "least_value_pa": Check("MPa", 1e-6, "range of the method, from"),
        "most_value_pa": Check("MPa", 1e-6, "range of the method, to"),
        "most_s_over_v_s": Check("ms", 1e3, "s/v, above which more compaction is possible"),
    }
)
"""Checks by their keys in a profile."""


OUR_TOLERANCES: Mapping[str, float] = MappingProxyType(
    {
        # E_vd changes in proportion to the load; drops of one height repeat within a few percent.
        "most_load_deviation": 0.10,
        # The same plate given in other units; the next size in use differs by a fifth.
        "most_radius_deviation": 0.01,
        # Base models leave 1 to 9 % of the contact of sound records, fits of damaged ones 11 to 78.
        "most_residual": 0.10,
    }
)
"""Relative tolerances of checks that a profile does not state."""


class Tolerance(NamedTuple):
    """Relative tolerance, and whether this program chose it."""

    value: float
    is_ours: bool
    """False: a verified source states it."""

    @property
    def words(self) -> str:
        """Text for messages.

        Examples
        --------
        >>> Tolerance(0.1, is_ours=True).words
        'within 10 %, our tolerance'
        """
        origin = ", our tolerance" if self.is_ours else ""
        return f"within {100 * self.value:.3g} %{origin}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Procedure:
    """Requirements of a standard or a contract on the drops of a point."""

    name: str
    """Short name, by which a user chooses the procedure."""
    title: str
    source: str
    """The document."""
    about: str = ""
    """Remarks for the user, above all on numbers that could not be verified."""
    seating: Number | None = None
    """Number of drops before the measured ones; None: the document does not state it."""
    measured: Number | None = None
    """Number of drops that are averaged; None: the document does not state it."""
    quantity: Quantity = Quantity.MODULUS
    """The judged quantity."""
    average: str = "deflection"
    """"deflection": the modulus of the mean deflection; "modulus": the mean of the moduli."""
    factor: Number | None = None
    """Plate factor: 1.5 in E_vd; 2 (uniform), pi/2 (rigid), 8/3 (parabolic) in E_LWD."""
    nominal_pressure: Number | None = None
    """Pa; the stress that the procedure presumes. E_vd uses it in place of the measured one."""
    nominal_load: Number | None = None
    """N; the peak load that the procedure presumes."""
    poisson_ratio: Number | None = None
    """Poisson's ratio of the formula; None: that of the setup."""
    plate_radius: Number | None = None
    """m; the plate that the procedure presumes."""
    checks: Mapping[str, Number] = field(default_factory=dict)
    """Limits by the keys of `CHECKS`."""
    targets: tuple[Target, ...] = ()
    """Targets by material and moisture."""
    enforce_unverified: bool = False
    """True: numbers that are not verified are enforced, too."""
    text: str = field(default="", repr=False)
    """The TOML from which it was read; a survey records it."""
    file: str | None = None
    """Path of that text; None: shipped with the program."""

    def tolerance(self, check: str) -> "Tolerance":
        """Return a tolerance, which applies whether or not its source is verified.

        Parameters
        ----------
        check : str
            Key of `OUR_TOLERANCES`, which has the default.
        """
        number = self.checks.get(check)
        if number is None:
            return Tolerance(OUR_TOLERANCES[check], is_ours=True)
        return Tolerance(number.value, is_ours=not number.verified)

    def enforced(self, number: Number | None) -> float | None:
        """Return the value of a number that is enforced; None: absent or not verified."""
        if number is None or not (number.verified or self.enforce_unverified):
            return None
        return number.value

    def limit(self, check: str) -> float | None:
        """Return an enforced limit by its key, SI unit; None: not checked."""
        return self.enforced(self.checks.get(check))

    @property
    def seating_drops(self) -> int | None:
        """Enforced number of drops before the measured ones; None: no number is enforced."""
        value = self.enforced(self.seating)
        return None if value is None else int(value)

    @property
    def measured_drops(self) -> int | None:
        """Enforced number of drops that are averaged; None: no number is enforced."""
        value = self.enforced(self.measured)
        return None if value is None else int(value)

    def as_recorded(self) -> dict[str, object]:
        """Return the values that a survey records, from which its points can be judged again."""
        return {
            "name": self.name,
            "text": self.text,
            "file": self.file,
            "enforce_unverified": self.enforce_unverified,
        }

    def numbers(self) -> dict[str, Number]:
        """Return every number of the profile by its key."""
        numbers: dict[str, Number | None] = {
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

    def target_for(self, moisture: float | None, material: str | None) -> Target | None:
        """Return the enforced target for a moisture (percent) and a material, or None.

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
