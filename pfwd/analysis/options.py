"""Options of an analysis, checked for their ranges and for contradictions."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

from pfwd.errors import OptionError, refusal
from pfwd.files.header import HEADER_KEYS, MAX_BEDROCK_DEPTH_M, MIN_BEDROCK_DEPTH_M
from pfwd_device.schema import (
    AnyOf,
    Array,
    Choice,
    Flag,
    Integer,
    Key,
    Number,
    Text,
    declared,
    keys_of,
)
from pfwd_device.text import clean

if TYPE_CHECKING:
    from pfwd.analysis.results import DropResult

Model = Literal["layer", "half-space"]
Load = Literal["measured", "half-sine"]
Plate = Literal["rigid-rough", "rigid-smooth", "published", "uniform"]
Sensors = Literal["all", "centre"]
Method = Literal["mpga", "posterior", "least-squares"]
Depth = float | Literal["unknown", "none"]
Layers = int | Literal["auto"]
Thickness = tuple[float, ...] | Literal["unknown"]

PLATE_WORDS = {
    "rigid-rough": "rigid plate without slip",
    "rigid-smooth": "rigid plate without friction",
    "published": "plate of the published method",
    "uniform": "plate with even pressure",
}
METHOD_WORDS = {
    "mpga": "genetic search",
    "posterior": "local fits",
    "published": "published method",
}
"""Texts for plates and methods, as people read them, by the name of the option."""

MOST_LAYERS = 4
"""Largest number of layers with a modulus of their own, the half-space below included."""

AS_DECLARED = "as declared"
"""Label of an analysis with the default settings."""

OPTION_OF_KEY = {
    "plate_radius_m": "plate_radius",
    "plate_mass_kg": "plate_mass",
    "poisson_ratio": "poisson_ratio",
    "density_kg_m3": "density",
}
"""Field of AnalysisOptions that overrides a key of a header, by the key."""

DEFAULT = {"load": "measured", "plate": "rigid-rough", "sensors": "all", "method": "mpga"}
"""Load, plate, sensors and method with the smallest error of the modulus."""

PUBLISHED = {"load": "half-sine", "plate": "published", "sensors": "centre", "method": "mpga"}
"""Those of the published method, doi 10.11835/j.issn.2096-6717.2022.021."""


_LABELS = {
    "published": "published method",
    "model": "{}",
    "bedrock_depth": "bedrock {}{}",
    "layers": "{} layers",
    "thickness": "thickness {}{}",
    "elastic": "elastic",
    "priors": "no priors",
    "joint": "one ground for the drops of a point",
    "load": "{} load",
    "plate": "{} plate",
    "sensors": "{} sensors",
    "method": "{}",
    "poisson_ratio": "Poisson's ratio {}",
    "density": "density {} kg/m3",
    "plate_mass": "plate mass {} kg",
    "plate_radius": "plate radius {} m",
    "header": "a header file",
    "seed": "seed {}",
}
"""Text of each option in a label, for a value that is not the default."""


class _Numbers(Array):
    """Array whose items are checked together with it."""

    def accepts(self, value: Any) -> bool:
        return super().accepts(value) and all(map(self.item.accepts, value))


_DEPTH = AnyOf(
    (
        Number(minimum=MIN_BEDROCK_DEPTH_M, maximum=MAX_BEDROCK_DEPTH_M),
        Choice(("unknown", "none")),
    ),
    f"a number from {MIN_BEDROCK_DEPTH_M:g} to {MAX_BEDROCK_DEPTH_M:g}, in m, or unknown or none",
)
_LAYERS = AnyOf(
    (Integer(1, MOST_LAYERS), Choice(("auto",))), f"a whole number from 1 to {MOST_LAYERS}, or auto"
)
_THICKNESS = AnyOf(
    (_Numbers(Number(above=0.0, maximum=MAX_BEDROCK_DEPTH_M), 1), Choice(("unknown",))),
    f"a list of numbers > 0 up to {MAX_BEDROCK_DEPTH_M:g}, in m, or unknown",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class AnalysisOptions:
    """Options of an analysis as the user stated them; None: not stated.

    Each field has its accepted values and its help on the command line, see `OPTIONS`.

    Raises
    ------
    OptionError
        If a value is outside of its range, or two options contradict each other.
    """

    model: Model | None = declared(
        None,
        Choice(get_args(Model)),
        "soil on bedrock, or soil without end (default: layer, unless --bedrock-depth none)",
    )
    """"layer": layer on a rigid base; "half-space"; None: decided by the declared depth of the
    base."""
    bedrock_depth: Depth | None = declared(
        None,
        _DEPTH,
        "depth of bedrock in m, or unknown, or none (default: as declared, else fitted)",
    )
    """Depth of the rigid base, m; "unknown": fitted; "none": there is no rigid base."""
    layers: Layers | None = declared(
        None,
        _LAYERS,
        "number of layers, the ground below them included, 1 to 4 (default: 1), or auto: as many "
        "as the record supports",
    )
    """Number of layers with a modulus; "auto": as many as the record supports; None: 1."""
    thickness: Thickness | None = declared(
        None,
        _THICKNESS,
        "thickness of all layers but the lowest, from the top, m, or unknown (default: fitted)",
    )
    """Thickness of each layer but the lowest, from the top, m; "unknown" or None: fitted."""
    elastic: bool = declared(False, Flag(), "model of the soil without viscosity")
    """True: the model of the ground has no viscosity."""
    load: Load | None = declared(
        None, Choice(get_args(Load)), "load in the model (default: measured)"
    )
    """"measured": the measured load; "half-sine": a half-sine fitted to it."""
    plate: Plate | None = declared(
        None,
        Choice(get_args(Plate)),
        "contact of plate and ground: a rigid plate that sticks to it or slides on it, the static "
        "pressure of the published method, or an even pressure (default: rigid-rough)",
    )
    """Contact of plate and ground: stiffness of the plate, friction."""
    sensors: Sensors | None = declared(
        None, Choice(get_args(Sensors)), "sensors that are fitted (default: all)"
    )
    """"all": all sensors are fitted; "centre": the centre sensor only."""
    joint: bool = declared(False, Flag(), "fit all drops of a point with the same soil")
    """True: one ground is fitted to all drops of a point."""
    method: Method | None = declared(
        None,
        Choice(get_args(Method)),
        "search of the parameters: by a genetic algorithm and from several starting points (mpga), "
        "or from these alone (posterior; least-squares is another name) (default: mpga)",
    )
    """Method of the search for the parameters; "least-squares" is another name of "posterior"."""
    published: bool = declared(
        False, Flag(), "the published method as a whole (doi 10.11835/j.issn.2096-6717.2022.021)"
    )
    """True: the published method, see `PUBLISHED`."""
    diagnose: bool = False
    """True: points are diagnosed; while measuring in addition to the inversion, for an archive in
    its place."""
    priors: bool = declared(
        True, Flag(), "do not prefer usual soils where the record leaves the depth of bedrock open"
    )
    """True: prior knowledge of soils decides between parameters that fit equally well."""
    seed: int = declared(0, Integer(0), "seed of random numbers (default: 0)")
    """Seed of all random numbers, >= 0."""
    header: str | None = declared(None, Text(), "header keys in a file of their own")
    """TOML file whose keys override those of the trace files."""
    plate_radius: float | None = declared(
        None, HEADER_KEYS["plate_radius_m"].value, "radius of the load plate, m"
    )
    """Radius of the load plate, m; this field and the following override every header."""
    poisson_ratio: float | None = declared(
        None,
        HEADER_KEYS["poisson_ratio"].value,
        "of the soil, 0 <= NU < 0.5",
        hint=HEADER_KEYS["poisson_ratio"].hint,
    )
    """Poisson's ratio of the ground."""
    density: float | None = declared(None, HEADER_KEYS["density_kg_m3"].value, "of the soil, kg/m3")
    """Density of the ground, kg/m3."""
    plate_mass: float | None = declared(
        None, HEADER_KEYS["plate_mass_kg"].value, "mass below the load cell, kg"
    )
    """Mass between load cell and ground, kg."""

    def __post_init__(self) -> None:
        if self.method == "least-squares":
            object.__setattr__(self, "method", "posterior")
        for name, option in OPTIONS.items():
            value = getattr(self, name)
            if value is not None:
                option.check(value, flag_of(name), OptionError)
        self._check_layers()
        self._refuse_contradictions()

    def _check_layers(self) -> None:
        if self.thickness is None or self.thickness == "unknown":
            return
        listed = ",".join(f"{value:g}" for value in self.thickness)
        n_thicknesses = None if self.layers == "auto" else (self.layers or 1) - 1
        if len(self.thickness) != n_thicknesses:
            expected = "a value for each layer but the lowest, from the top, with --layers"
            got = f"--thickness {listed} and --layers {self.layers or 1}"
            raise OptionError(refusal("--thickness", expected, got))
        depth = self.bedrock_depth
        if isinstance(depth, float | int) and sum(self.thickness) >= depth:
            expected = f"layers that end above the rock at {depth:g} m"
            raise OptionError(refusal("--thickness", expected, f"{sum(self.thickness):g} m"))

    def _refuse_contradictions(self) -> None:
        depth = self.bedrock_depth
        if not self.priors and self.layers not in (None, 1):
            why = f"--layers {self.layers}"
            expected = "one of the two: a fit of layers rests on what nature gives"
            raise OptionError(refusal(f"--no-priors and {why}", expected, "both"))
        if self.model == "half-space" and depth not in (None, "none"):
            raise _contradiction("--model half-space", f"--bedrock-depth {depth}")
        if self.model == "layer" and depth == "none":
            raise _contradiction("--model layer", "--bedrock-depth none")
        if not self.published:
            return
        for name, published in PUBLISHED.items():
            if getattr(self, name) not in (None, published):
                raise _contradiction("--published", f"--{name} {getattr(self, name)}")
        if self.joint:
            raise _contradiction("--published", "--joint")
        if self.layers not in (None, 1):
            raise _contradiction("--published", f"--layers {self.layers}")
        if depth == "unknown":
            raise _contradiction("--published", "--bedrock-depth unknown")

    @property
    def label(self) -> str:
        """Settings that differ from the default, as text.

        Examples
        --------
        >>> AnalysisOptions(elastic=True, layers=2).label, AnalysisOptions().label
        ('2 layers, elastic', 'as declared')
        """
        defaults = {item.name: item.default for item in dataclasses.fields(self)}
        parts = []
        for name, text in _LABELS.items():
            value = getattr(self, name)
            if value != defaults[name] and (name, value) != ("thickness", "unknown"):
                numbers = value if isinstance(value, tuple) else (value,)
                words = ", ".join(n if isinstance(n, str) else f"{n:.10g}" for n in numbers)
                parts.append(text.format(words, "" if isinstance(value, str) else " m"))
        return ", ".join(parts) or AS_DECLARED

    @property
    def choices(self) -> dict[str, Any]:
        """Load, plate, sensors and method as stated, completed as published or by default."""
        base = PUBLISHED if self.published else DEFAULT
        return {name: getattr(self, name) or word for name, word in base.items()}

    def overrides(self) -> dict[str, float]:
        """Return the keys of a header that are given as options, with their values in SI units."""
        declared = {key: getattr(self, name) for key, name in OPTION_OF_KEY.items()}
        return {key: value for key, value in declared.items() if value is not None}


OPTIONS: Mapping[str, Key] = keys_of(AnalysisOptions)
"""Accepted values of each option, and as ``meaning`` its help on the command line."""


def flag_of(name: str) -> str:
    """Return the flag of an option on the command line, such as ``--no-priors``."""
    return ("--no-" if name == "priors" else "--") + name.replace("_", "-")


def parse_option(name: str, text: str) -> Any:
    """Return the value of an option that a text of the command line stands for.

    AnalysisOptions checks whether a number is within its range.

    Raises
    ------
    OptionError
        If it is not a number, or no word that the option accepts.
    """
    kind = OPTIONS[name].value
    if kind.accepts(text):
        return text
    try:
        numbers = tuple(map(float, text.split(",")))
    except ValueError:
        raise OptionError(f"expected {kind.expected}, got {clean(text, limit=40)}") from None
    if len(numbers) > 1 or kind.accepts(numbers):
        return numbers
    if numbers == (math.inf,) and kind.accepts("none"):
        return "none"
    return int(text) if text.isdecimal() and not kind.accepts(numbers[0]) else numbers[0]


def with_layers_of(options: AnalysisOptions, result: DropResult | None) -> AnalysisOptions:
    """Return the options with the number of layers of a result.

    The modulus then keeps its meaning.

    Parameters
    ----------
    options : AnalysisOptions
    result : DropResult or None

    Returns
    -------
    AnalysisOptions
        With the number of layers of the result, and with their thickness if it was declared;
        unchanged for homogeneous ground.
    """
    layers = () if result is None else result.layers or ()
    if not 1 < len(layers) <= MOST_LAYERS or options.published:
        return options
    thicknesses = [layer.thickness_m for layer in layers[:-1] if layer.thickness_sd_m is None]
    declared = tuple(value for value in thicknesses if value is not None)
    thickness = declared if len(declared) == len(layers) - 1 else None
    return dataclasses.replace(options, layers=len(layers), thickness=thickness)


def _contradiction(option: str, contradicted: str) -> OptionError:
    return OptionError(refusal(f"{option} and {contradicted}", "one of the two", "both"))
