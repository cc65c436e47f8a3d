"""A procedure as it was read: numbers with their sources, nothing computed."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import NamedTuple


class Quantity(StrEnum):
    """What a procedure judges a point by. None of them is another's synonym."""

    E_VD = "E_vd"
    """Dynamic modulus of deformation: factor x radius x nominal pressure over mean deflection."""
    E_LWD = "E_LWD"
    """Surface modulus: factor x (1 - nu^2) x measured pressure x radius over mean deflection."""
    MODULUS = "modulus"
    """Modulus of the ground from the full time history, as the inversion finds it."""
    DEFLECTION = "deflection"
    """Mean peak deflection itself; smaller is better."""


@dataclass(frozen=True, slots=True)
class Number:
    """A number of a procedure and where it is from."""

    value: float
    """SI unit, named in the key."""
    source: str
    """Where the number can be read."""
    verified: bool
    """Whether a public text was found that says so."""


@dataclass(frozen=True, slots=True)
class Target:
    """What a point has to reach."""

    value: Number
    """Pa, or m for a deflection."""
    material: str | None = None
    """What it applies to; None: everything."""
    moisture_from: float | None = None
    """Percent by mass, inclusive; None: from any."""
    moisture_to: float | None = None
    """Percent by mass, exclusive; None: to any."""


class Check(NamedTuple):
    """One check that a profile can ask for."""

    unit: str
    """Of the limit, as shown to people."""
    scale: float
    """Shown value over SI value."""
    words: str
    """What is limited."""


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
"""By the key of the profile."""


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
    """A relative tolerance and whether this program chose it."""

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
    """What a standard or a contract asks of the drops of a point."""

    name: str
    """Short name, as it is chosen by."""
    title: str
    source: str
    """The document."""
    about: str = ""
    """What a user should know of the profile, above all what could not be verified."""
    seating: Number | None = None
    """Drops before the measured ones; None: the document does not say."""
    measured: Number | None = None
    """Drops that are averaged; None: the document does not say."""
    quantity: Quantity = Quantity.MODULUS
    """What is judged."""
    average: str = "deflection"
    """"deflection": the modulus of the mean deflection; "modulus": the mean of the moduli."""
    factor: Number | None = None
    """Plate factor: 1.5 in E_vd; 2 (uniform), pi/2 (rigid), 8/3 (parabolic) in E_LWD."""
    nominal_pressure: Number | None = None
    """Pa; the stress that the procedure presumes. E_vd takes it in place of the measured one."""
    nominal_load: Number | None = None
    """N; the peak load that the procedure presumes."""
    poisson_ratio: Number | None = None
    """None: what the setup declares."""
    plate_radius: Number | None = None
    """m; the plate that the procedure presumes."""
    checks: Mapping[str, Number] = field(default_factory=dict)
    """Limits by the keys of `CHECKS`."""
    targets: tuple[Target, ...] = ()
    """To choose from by material and moisture."""
    enforce_unverified: bool = False
    """Whether numbers that are not verified are enforced too."""
    text: str = field(default="", repr=False)
    """The TOML it was read from, to be kept with a survey."""
    file: str | None = None
    """Where that stands; None: shipped with the program."""

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
        """The value of a number that is enforced; None: there is none, or it is not verified."""
        if number is None or not (number.verified or self.enforce_unverified):
            return None
        return number.value

    def limit(self, check: str) -> float | None:
        """An enforced limit by its key, SI; None: not checked."""
        return self.enforced(self.checks.get(check))

    @property
    def seating_drops(self) -> int | None:
        """Drops before the measured ones, as enforced."""
        value = self.enforced(self.seating)
        return None if value is None else int(value)

    @property
    def measured_drops(self) -> int | None:
        """Drops that are averaged, as enforced."""
        value = self.enforced(self.measured)
        return None if value is None else int(value)

    def as_kept(self) -> dict[str, object]:
        """What a survey keeps of it: everything that is needed to judge its points again."""
        return {
            "name": self.name,
            "text": self.text,
            "file": self.file,
            "enforce_unverified": self.enforce_unverified,
        }

    def numbers(self) -> dict[str, Number]:
        """Every number of the profile by its key."""
        found: dict[str, Number | None] = {
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
            found[f"target {index}"] = target.value
        return {key: number for key, number in found.items() if number is not None}

    def target_for(self, moisture: float | None, material: str | None) -> Target | None:
        """The enforced target for a moisture (percent) and a material; None: there is none.

        A target that is limited to a moisture or a material is never taken for a point of which
        these are not known.
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
