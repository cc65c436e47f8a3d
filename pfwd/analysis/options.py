"""Options of an analysis, checked for their ranges and for contradictions."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from pfwd.errors import OptionError, TraceError, refusal
from pfwd.files.header import MAX_BEDROCK_DEPTH_M, MIN_BEDROCK_DEPTH_M, check_value

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


@dataclass(frozen=True, slots=True)
class Choices:
    """Choices that determine the load, the contact, the sensors and the search, all of them set."""

    load: Load
    """"measured": the measured load; "half-sine": a half-sine fitted to it."""
    plate: Plate
    """Contact of plate and ground: stiffness of the plate, friction."""
    sensors: Sensors
    """"all": all sensors are fitted; "centre": the centre sensor only."""
    method: Method
    """Method of the search for the parameters."""


DEFAULT = Choices("measured", "rigid-rough", "all", "mpga")
"""Choices with the smallest error of the modulus."""

PUBLISHED = Choices("half-sine", "published", "centre", "mpga")
"""Choices of the method of doi 10.11835/j.issn.2096-6717.2022.021."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AnalysisOptions:
    """Options of an analysis as the user stated them; None: not stated.

    Raises
    ------
    OptionError
        If a value is outside of its range, or two options contradict each other.
    """

    model: Model | None = None
    """"layer": layer on a rigid base; "half-space"; None: decided by the declared depth of the
    base."""
    bedrock_depth: Depth | None = None
    """Depth of the rigid base, m; "unknown": fitted; "none": there is no rigid base."""
    layers: Layers | None = None
    """Number of layers with a modulus; "auto": as many as the record supports; None: 1."""
    thickness: Thickness | None = None
    """Thickness of each layer but the lowest, from the top, m; "unknown" or None: fitted."""
    elastic: bool = False
    """True: the model of the ground has no viscosity."""
    load: Load | None = None
    """"measured": the measured load; "half-sine": a half-sine fitted to it."""
    plate: Plate | None = None
    """Contact of plate and ground: stiffness of the plate, friction."""
    sensors: Sensors | None = None
    """"all": all sensors are fitted; "centre": the centre sensor only."""
    joint: bool = False
    """True: one ground is fitted to all drops of a point."""
    method: Method | None = None
    """Method of the search for the parameters; "least-squares" is another name of "posterior"."""
    published: bool = False
    """True: the published method, see `PUBLISHED`."""
    diagnose: bool = False
    """True: points are diagnosed; while measuring in addition to the inversion, for an archive in
    its place."""
    priors: bool = True
    """True: prior knowledge of soils decides between parameters that fit equally well."""
    seed: int = 0
    """Seed of all random numbers, >= 0."""
    header: str | None = None
    """TOML file whose keys override those of the trace files."""
    plate_radius: float | None = None
    """Radius of the load plate, m; this field and the following override every header."""
    poisson_ratio: float | None = None
    """Poisson's ratio of the ground."""
    density: float | None = None
    """Density of the ground, kg/m3."""
    plate_mass: float | None = None
    """Mass between load cell and ground, kg."""

    def __post_init__(self) -> None:
        if self.method == "least-squares":
            object.__setattr__(self, "method", "posterior")
        for key, value in self.overrides().items():
            where = "--" + OPTION_OF_KEY[key].replace("_", "-")
            try:
                check_value(key, value, where)
            except TraceError as err:
                raise OptionError(str(err)) from err
        depth = self.bedrock_depth
        if not isinstance(depth, str | None) and not (
            MIN_BEDROCK_DEPTH_M <= depth <= MAX_BEDROCK_DEPTH_M
        ):
            expected = (
                f"a number from {MIN_BEDROCK_DEPTH_M:g} to {MAX_BEDROCK_DEPTH_M:g}, in m, or "
                "unknown or none"
            )
            raise OptionError(refusal("--bedrock-depth", expected, f"{depth:g}"))
        if self.seed < 0:
            raise OptionError(refusal("--seed", "a whole number >= 0", str(self.seed)))
        self._check_layers()
        self._refuse_contradictions()

    def _check_layers(self) -> None:
        layers = self.layers
        if layers not in (None, "auto", *range(1, MOST_LAYERS + 1)):
            expected = f"a whole number from 1 to {MOST_LAYERS}, or auto"
            raise OptionError(refusal("--layers", expected, str(layers)))
        if self.thickness is None or self.thickness == "unknown":
            return
        listed = ",".join(f"{value:g}" for value in self.thickness)
        if not all(0.0 < value <= MAX_BEDROCK_DEPTH_M for value in self.thickness):
            expected = f"numbers > 0 up to {MAX_BEDROCK_DEPTH_M:g}, in m, or unknown"
            raise OptionError(refusal("--thickness", expected, listed))
        n_thicknesses = None if layers == "auto" else (layers or 1) - 1
        if n_thicknesses is None or len(self.thickness) != n_thicknesses:
            expected = "a value for each layer but the lowest, from the top, with --layers"
            got = f"--thickness {listed} and --layers {layers or 1}"
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
        for name, published in dataclasses.asdict(PUBLISHED).items():
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
        parts = []
        if self.published:
            parts.append("published method")
        if self.model:
            parts.append(self.model)
        if self.bedrock_depth is not None:
            depth = self.bedrock_depth
            parts.append(f"bedrock {depth}" if isinstance(depth, str) else f"bedrock {depth:g} m")
        parts += [f"{self.layers} layers"] if self.layers else []
        if self.thickness is not None and self.thickness != "unknown":
            parts.append("thickness " + ", ".join(f"{value:g}" for value in self.thickness) + " m")
        parts += ["elastic"] if self.elastic else []
        parts += [] if self.priors else ["no priors"]
        parts += ["one ground for the drops of a point"] if self.joint else []
        parts += [f"{self.load} load"] if self.load else []
        parts += [f"{self.plate} plate"] if self.plate else []
        parts += [f"{self.sensors} sensors"] if self.sensors else []
        parts += [self.method] if self.method else []
        parts += [f"Poisson's ratio {self.poisson_ratio:g}"] if self.poisson_ratio else []
        parts += [f"density {self.density:g} kg/m3"] if self.density else []
        parts += [f"plate mass {self.plate_mass:g} kg"] if self.plate_mass is not None else []
        parts += [f"plate radius {self.plate_radius:g} m"] if self.plate_radius else []
        parts += ["a header file"] if self.header is not None else []
        parts += [f"seed {self.seed}"] if self.seed else []
        return ", ".join(parts) or AS_DECLARED

    @property
    def choices(self) -> Choices:
        """Stated choices, completed by those of the published method or by the default."""
        base = PUBLISHED if self.published else DEFAULT
        declared = {name: getattr(self, name) for name in dataclasses.asdict(base)}
        return dataclasses.replace(
            base, **{name: value for name, value in declared.items() if value is not None}
        )

    def overrides(self) -> dict[str, float]:
        """Return the keys of a header that are given as options, with their values in SI units."""
        declared = {key: getattr(self, name) for key, name in OPTION_OF_KEY.items()}
        return {key: value for key, value in declared.items() if value is not None}


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
