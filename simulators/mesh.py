"""Simulated ground, and the grid of finite elements on which its motion is computed.

Axes: ``r`` outward from the plate centre, ``z`` downward from the surface. The grid is the product
of a radial and a vertical line of points. Elements are smallest at the plate edge, where the
contact pressure is infinite. Further out their size follows the shortest wavelength of interest,
and it grows without limit where no wave can return within the record.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Limits (rad/s) and number of the Maxwell elements of constant-Q soil; they enclose 1 Hz to 3 kHz.
MAXWELL_RATES, N_MAXWELL = (0.2, 1e5), 10


class SimulationError(Exception):
    """Base class of the errors of the simulators."""


class GroundError(SimulationError, ValueError):
    """A quantity of ground, plate, load or record cannot be simulated; the message names it."""


def require(condition: bool, name: str, expected: str, value: object) -> None:
    """Raise `GroundError` if a condition is false.

    Parameters
    ----------
    condition : bool
    name : str
        Name of the quantity.
    expected : str
        Description of the accepted values.
    value : object
        Actual value.
    """
    if not condition:
        raise GroundError(f"{name}: expected {expected}, got {value!r}; correct the value passed")


@dataclass(frozen=True)
class SoilLayer:
    """One horizontal Kelvin-Voigt layer: E* = E + eta d/dt at constant Poisson's ratio."""

    modulus: float
    """Young's modulus E, Pa, > 0."""
    viscosity: float
    """Viscosity eta, Pa s, >= 0."""
    density: float
    """Density rho, kg/m3, > 0."""
    poisson_ratio: float
    """Poisson's ratio nu, 0 <= value < 0.5 (tested up to 0.499)."""
    thickness: float = math.inf
    """Thickness, m, > 0; infinite only for the lowest layer of a ground without base."""

    def __post_init__(self) -> None:
        require(0 < self.modulus < math.inf, "modulus", "Pa, > 0", self.modulus)
        require(0 <= self.viscosity < math.inf, "viscosity", "Pa s, >= 0", self.viscosity)
        require(0 < self.density < math.inf, "density", "kg/m3, > 0", self.density)
        require(0 <= self.poisson_ratio < 0.5, "poisson_ratio", "0 to < 0.5", self.poisson_ratio)
        require(self.thickness > 0, "thickness", "m, > 0", self.thickness)

    def shear_speed(self, angular_frequency: float = 0.0) -> float:
        r"""Return the speed of shear waves at a frequency (rad/s), m/s.

        It is :math:`\sqrt{|G^*(i\omega)|/\rho}`.
        """
        modulus = math.hypot(self.modulus, self.viscosity * angular_frequency)
        return math.sqrt(modulus / (2 * (1 + self.poisson_ratio) * self.density))

    def pressure_speed(self, angular_frequency: float = 0.0) -> float:
        r"""Return the speed of pressure waves at a frequency (rad/s), m/s.

        It is :math:`c_s \sqrt{2(1-\nu)/(1-2\nu)}` with the speed of shear waves :math:`c_s`.
        """
        ratio = 2 * (1 - self.poisson_ratio) / (1 - 2 * self.poisson_ratio)
        return self.shear_speed(angular_frequency) * math.sqrt(ratio)


@dataclass(frozen=True)
class Growth:
    r"""Growth of the modulus with depth, :math:`E(z) = E_0 (1 + z/z_0)^n`, constant below a limit.

    Linear growth (n = 1) is the soil of Gibson (1967), Geotechnique 17, 58-67. Viscosity grows
    in proportion, so that the retardation time is the same at every depth.
    """

    depth: float
    """Depth z_0, m, > 0, at which the modulus has doubled for n = 1."""
    exponent: float = 1.0
    """Exponent n, > 0."""
    limit: float = math.inf
    """Depth below which the modulus is constant, m, > 0."""

    def __post_init__(self) -> None:
        require(0 < self.depth < math.inf, "growth depth", "m, > 0", self.depth)
        require(0 < self.exponent < math.inf, "growth exponent", "> 0", self.exponent)
        require(self.limit > 0, "growth limit", "m, > 0", self.limit)

    def factor(self, depth: Array) -> Array:
        """Return the modulus at each depth (m) divided by that at the surface, in equal shape."""
        factor: Array = (1 + np.minimum(depth, self.limit) / self.depth) ** self.exponent
        return factor


@dataclass(frozen=True)
class ConstantQ:
    r"""Damping law with the same loss per cycle at every frequency (constant quality factor Q).

    .. math:: G^*(s) = G_0 (s/\omega_0)^{2\gamma}, \qquad \gamma = \arctan(1/Q)/\pi

    Kjartansson (1979), J. Geophys. Res. 84(B9), 4737-4748, equations 7 and 13. The finite elements
    step it through time as springs in parallel with Maxwell elements and one dashpot:

    .. math:: s^\alpha = \frac{\sin \pi\alpha}{\pi} \int_0^\infty \frac{s\,
        \omega^{\alpha-1}}{s + \omega} d\omega \approx c_0 + \sum_j \frac{c_j s}{s + \omega_j}
        + c_\infty s, \qquad \alpha = 2\gamma

    with one element per cell of a logarithmic grid of :math:`\omega`. All coefficients are
    positive: the approximation is causal and passive. Between 1 Hz and 3 kHz it meets the power law
    within 0.3 % for Q = 5, and the loss factor 1/Q within 2 %.
    """

    quality: float
    """Quality factor Q, > 0."""
    reference: float
    r""":math:`\omega_0`, rad/s, > 0, at which :math:`|G^*|` is the stated modulus."""

    def __post_init__(self) -> None:
        require(0 < self.quality < math.inf, "quality", "> 0", self.quality)
        require(0 < self.reference < math.inf, "reference", "rad/s, > 0", self.reference)

    @property
    def exponent(self) -> float:
        r"""Exponent :math:`\alpha = 2\gamma` with which the modulus grows with the frequency."""
        return 2 * math.atan(1 / self.quality) / math.pi

    def stiffening(self, angular_frequency: float) -> float:
        """Return the absolute modulus at a frequency (rad/s) divided by that at the reference."""
        return float((angular_frequency / self.reference) ** self.exponent)

    @cached_property
    def elements(self) -> tuple[float, Array, Array, float]:
        """Coefficients of the approximation in the docstring of the class.

        They are the spring c_0, the rates omega_j (1/s) and shares c_j of the Maxwell elements,
        and the dashpot c_inf (s).
        """
        alpha = self.exponent
        edges = np.geomspace(*MAXWELL_RATES, N_MAXWELL + 1)
        scale = math.sin(math.pi * alpha) / math.pi / self.reference**alpha
        rates = np.sqrt(edges[1:] * edges[:-1])
        shares = scale * np.diff(edges**alpha) / alpha
        spring = scale * edges[0] ** alpha / alpha
        dashpot = scale * edges[-1] ** (alpha - 1) / (1 - alpha)
        return float(spring), rates, shares, float(dashpot)

    def factor(self, laplace: complex) -> complex:
        """Return the approximated complex modulus divided by the reference modulus.

        Parameters
        ----------
        laplace : complex, 1/s
            Laplace variable, i omega for a steady vibration.
        """
        spring, rates, shares, dashpot = self.elements
        return complex(spring + np.sum(shares * laplace / (laplace + rates)) + dashpot * laplace)


@dataclass(frozen=True)
class SoilProfile:
    """Horizontal layers from the surface down, on a rigid base or infinitely deep."""

    layers: tuple[SoilLayer, ...]
    """Layers from the surface down."""
    base: Literal["rigid", "none"] = "rigid"
    """`rigid`: u = w = 0 below the last layer. `none`: the last layer is infinitely deep."""
    growth: Growth | None = None
    """Factor on moduli and viscosities of the layers; None: they are constant in each layer."""
    damping_law: ConstantQ | None = None
    """Factor on the elastic moduli of all layers; None: Kelvin-Voigt."""

    def __post_init__(self) -> None:
        require(len(self.layers) > 0, "layers", "at least one layer", self.layers)
        require(self.base in ("rigid", "none"), "base", "'rigid' or 'none'", self.base)
        finite = [math.isfinite(layer.thickness) for layer in self.layers]
        require(all(finite[:-1]), "thickness", "finite above the last layer", self.layers)
        require(
            finite[-1] == (self.base == "rigid"),
            "thickness of the last layer",
            "finite on a rigid base, infinite without base",
            self.layers[-1].thickness,
        )
        lowest = min(self.bedrock_depth, self.growth.limit) if self.growth else 0.0
        require(math.isfinite(lowest), "growth limit", "finite without base", lowest)

    @property
    def soil(self) -> Literal["kelvin-voigt", "constant-q", "growth"]:
        """Name of the soil; `kelvin-voigt` has a constant modulus in each layer."""
        if self.damping_law is not None:
            return "constant-q"
        return "kelvin-voigt" if self.growth is None else "growth"

    @property
    def interfaces(self) -> Array:
        """(n_layers - 1,) depths of the boundaries between layers, m."""
        return np.cumsum([layer.thickness for layer in self.layers[:-1]])

    @property
    def bedrock_depth(self) -> float:
        """Depth of the rigid base, m; infinite without a base."""
        return sum(layer.thickness for layer in self.layers)

    def layer_at(self, depth: Array) -> NDArray[np.int64]:
        """Return the index of the layer at each depth (m), in equal shape."""
        return np.searchsorted(self.interfaces, depth, side="right").astype(np.int64)

    @classmethod
    def uniform(
        cls,
        modulus: float,
        viscosity: float = 0.0,
        density: float = 2000.0,
        poisson_ratio: float = 0.35,
        bedrock_depth: float = math.inf,
    ) -> SoilProfile:
        """Return ground of one layer.

        Parameters
        ----------
        modulus : float, Pa
            Young's modulus.
        viscosity : float, Pa s
        density : float, kg/m3
        poisson_ratio : float
        bedrock_depth : float, m
            Depth of the rigid base; infinite: the ground is infinitely deep.
        """
        layer = SoilLayer(modulus, viscosity, density, poisson_ratio, bedrock_depth)
        return cls((layer,), "rigid" if math.isfinite(bedrock_depth) else "none")


@dataclass(frozen=True)
class Plate:
    """Rigid circular plate on the surface."""

    radius: float
    """Radius a, m, > 0."""
    mass: float = 0.0
    """Mass that moves between the load cell and the ground, kg, >= 0."""
    contact: Literal["rough", "smooth"] = "rough"
    """`rough`: the ground sticks to the plate. `smooth`: it slips without friction."""

    def __post_init__(self) -> None:
        require(0 < self.radius < math.inf, "radius", "m, > 0", self.radius)
        require(0 <= self.mass < math.inf, "mass", "kg, >= 0", self.mass)
        require(self.contact in ("rough", "smooth"), "contact", "rough or smooth", self.contact)


@dataclass(frozen=True)
class Resolution:
    """Settings that determine the grid of finite elements and the time step."""

    edge_element: float = 5e-4
    """Smallest element at the plate edge over the plate radius."""
    edge_growth: float = 0.5
    """Growth of the element size per distance from the plate edge."""
    elements_per_wavelength: float = 3.0
    """Elements in the shear wavelength at the highest frequency of interest."""
    highest_frequency: float = 3.5
    """Highest frequency of interest times pulse duration; a half-sine has 0.04 % of its energy
    above 3.5."""
    free_growth: float = 0.15
    """Growth of the element size per distance where waves are absorbed or return too late. Faster
    growth reflects short waves before they are absorbed: with 0.5, 3 % of the peak on undamped
    soil."""
    undamped_wavelengths: float = 0.75
    """Undamped ground beyond the last sensor, in shear wavelengths of the pulse (2 T0 c_s)."""
    damped_wavelengths: float = 1.5
    """Width of the absorbing zone, in pressure wavelengths of the pulse (2 T0 c_p)."""
    absorption: float = 2.0
    """Viscosity added at the end of the absorbing zone, times E/omega of the pulse."""
    steps_per_pulse: float = 150.0
    """Smallest number of time steps in one pulse duration."""
    halvings: int = 0
    """Number of times that each element is halved in both directions."""

    def refined(self) -> Resolution:
        """Return the resolution with every element and the time step halved."""
        return replace(self, halvings=self.halvings + 1, steps_per_pulse=2 * self.steps_per_pulse)


@dataclass(frozen=True)
class Grid:
    """Grid of finite elements: its radii and depths, and the place of its absorbing zone."""

    radii: Array
    """Radii of the grid lines, (n_r,), increasing from 0, m."""
    depths: Array
    """Depths of the grid lines, (n_z,), increasing from 0, m."""
    damping_start: float
    """Distance (radius, and depth where there is no base) at which absorption begins, m."""
    damping_width: float
    """Distance over which absorption rises to its full value, m."""


def graded_line(breaks: Sequence[float], size: Callable[[float], float]) -> Array:
    """Return the positions of grid points whose spacing varies along a line.

    Parameters
    ----------
    breaks : sequence of float, m
        Increasing positions that become grid points.
    size : callable
        Function that returns the largest spacing (m) at a position (m); its slope is below 1.

    Returns
    -------
    (n,) ndarray of float, m
    """
    points = [float(breaks[0])]
    for start, end in itertools.pairwise(breaks):
        marched = [start]
        while marched[-1] < end:
            step = size(marched[-1])
            for _ in range(4):  # spacing at the middle of the element, by fixed-point iteration
                step = size(min(marched[-1] + step / 2, end))
            marched.append(marched[-1] + step)
        stretch = (end - start) / (marched[-1] - start)  # <= 1: the last one overshoots
        points += [start + (x - start) * stretch for x in marched[1:-1]]
        points.append(float(end))
    return np.array(points)


def design_grid(
    ground: SoilProfile,
    plate: Plate,
    offsets: Sequence[float],
    pulse_duration: float,
    duration: float,
    resolution: Resolution,
) -> Grid:
    """Return the grid for the simulation of a drop.

    It is fine at the plate edge and coarse where no wave can return within the record.

    Parameters
    ----------
    ground : Ground
    plate : Plate
    offsets : sequence of float, m
        Distances from the plate centre at which the ground is observed.
    pulse_duration : float, s
        Duration of the load.
    duration : float, s
        Length of the record.
    resolution : Resolution
    """
    for offset in offsets:
        require(0 <= offset < math.inf, "offset", "m, >= 0", offset)
    pulse = math.pi / pulse_duration
    longest = _fastest(ground, pulse) * 2 * pulse_duration
    shortest = min(layer.shear_speed(pulse) for layer in ground.layers) * 2 * pulse_duration
    start = max([plate.radius, *offsets]) + resolution.undamped_wavelengths * shortest
    width = resolution.damped_wavelengths * longest
    end = start + width
    slow, fast = _returning_depths(ground, pulse, duration)
    if ground.base == "rigid":  # trapped waves decay within a few depths
        end = max(end, min(4 * ground.bedrock_depth, 2 * fast))

    wave = _wave_sizes(ground, plate, pulse_duration, resolution)

    def edge(distance: float) -> float:
        return resolution.edge_element * plate.radius + resolution.edge_growth * distance

    def radial_size(radius: float) -> float:
        free = resolution.free_growth * max(0.0, radius - start)
        return min(edge(abs(radius - plate.radius)), min(wave) + free)

    bottom = ground.bedrock_depth if ground.base == "rigid" else end
    quiet = math.inf if ground.base == "rigid" else start

    def depth_size(depth: float) -> float:
        index = int(ground.layer_at(np.array(depth)))
        layer = ground.layers[index]
        ratio = layer.pressure_speed() / layer.shear_speed()
        coarser = resolution.free_growth * max(0.0, depth - slow)
        limit = min(wave[index] + coarser, wave[index] * ratio)  # only P waves return from there
        limit += resolution.free_growth * max(0.0, depth - min(fast, quiet))
        return min(edge(depth), limit)

    radii = graded_line([0.0, plate.radius, end], radial_size)
    inside = [float(depth) for depth in ground.interfaces if depth < bottom]
    depths = graded_line([0.0, *inside, bottom], depth_size)
    for _ in range(resolution.halvings):
        radii, depths = _halve(radii), _halve(depths)
    return Grid(radii, depths, start, width)


def _wave_sizes(
    ground: SoilProfile, plate: Plate, pulse_duration: float, resolution: Resolution
) -> list[float]:
    """Return the element size for each layer that resolves the shortest shear wavelength, m.

    On soft ground the plate follows the load only up to omega a / c_s near 1. On stiff ground it
    does not filter, and the beginning and end of the load emit shorter waves.
    """
    top = ground.layers[0].shear_speed(math.pi / pulse_duration)
    openness = math.sqrt(top * pulse_duration / (8 * plate.radius))
    highest = resolution.highest_frequency / pulse_duration * min(max(openness, 1.0), 2.5)
    return [
        layer.shear_speed(2 * math.pi * highest) / highest / resolution.elements_per_wavelength
        for layer in ground.layers
    ]


def _returning_depths(ground: SoilProfile, pulse: float, duration: float) -> tuple[float, float]:
    """Return the depths from which waves return to the surface within `duration` seconds, m.

    The first is that of waves that travel one way as shear and the other as pressure waves, the
    second that of pressure waves.
    """
    shear = max(layer.shear_speed(pulse) for layer in ground.layers)
    pressure = _fastest(ground, pulse)
    return duration * shear * pressure / (shear + pressure), duration * pressure / 2


def _fastest(ground: SoilProfile, pulse: float) -> float:
    """Return the largest speed of pressure waves at the pulse's frequency, m/s.

    Constant-Q soil is evaluated at its reference; it is stiffer at higher frequencies, whose waves
    are then longer than the grid requires.
    """
    fastest = max(layer.pressure_speed(pulse) for layer in ground.layers)
    if ground.growth is None:
        return fastest
    return fastest * math.sqrt(float(ground.growth.factor(np.array(ground.bedrock_depth))))


def _halve(line: Array) -> Array:
    return np.sort(np.concatenate([line, (line[1:] + line[:-1]) / 2]))
