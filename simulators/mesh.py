"""The ground to be simulated, and the graded grid on which it is solved.

Axes: ``r`` outward from the plate centre, ``z`` downward from the surface. The grid is the product
of a radial and a vertical line. Both are refined towards the plate edge, where the contact pressure
is infinite, follow the shortest wavelength of interest further out, and grow without limit where
nothing can come back in time.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class SimulationError(Exception):
    """Base of everything the simulated physics refuses."""


class GroundError(SimulationError, ValueError):
    """A quantity of the ground, plate, load or record cannot be simulated; the message names it."""


def require(condition: bool, name: str, expected: str, value: object) -> None:
    """Raise `GroundError` naming the quantity, what was expected and what came."""
    if not condition:
        raise GroundError(f"{name}: expected {expected}, got {value!r}; correct the value passed")


@dataclass(frozen=True)
class Layer:
    """One horizontal Kelvin-Voigt layer: E* = E + eta d/dt at constant Poisson's ratio."""

    modulus: float
    """Young's modulus E, Pa, > 0."""
    viscosity: float
    """eta, Pa s, >= 0."""
    density: float
    """rho, kg/m3, > 0."""
    poisson_ratio: float
    """nu, 0 <= value < 0.5 (up to 0.499 was tried)."""
    thickness: float = math.inf
    """m, > 0; infinite only for the lowest layer of a ground without base."""

    def __post_init__(self) -> None:
        require(0 < self.modulus < math.inf, "modulus", "Pa, > 0", self.modulus)
        require(0 <= self.viscosity < math.inf, "viscosity", "Pa s, >= 0", self.viscosity)
        require(0 < self.density < math.inf, "density", "kg/m3, > 0", self.density)
        require(0 <= self.poisson_ratio < 0.5, "poisson_ratio", "0 to < 0.5", self.poisson_ratio)
        require(self.thickness > 0, "thickness", "m, > 0", self.thickness)

    def shear_speed(self, angular_frequency: float = 0.0) -> float:
        r"""Speed of shear waves, :math:`\sqrt{|G^*(i\omega)|/\rho}`, m/s."""
        modulus = math.hypot(self.modulus, self.viscosity * angular_frequency)
        return math.sqrt(modulus / (2 * (1 + self.poisson_ratio) * self.density))

    def pressure_speed(self, angular_frequency: float = 0.0) -> float:
        r"""Speed of pressure waves, :math:`c_s \sqrt{2(1-\nu)/(1-2\nu)}`, m/s."""
        ratio = 2 * (1 - self.poisson_ratio) / (1 - 2 * self.poisson_ratio)
        return self.shear_speed(angular_frequency) * math.sqrt(ratio)


@dataclass(frozen=True)
class Ground:
    """Horizontal layers from the surface down, on a rigid base or without end."""

    layers: tuple[Layer, ...]
    """From the surface down."""
    base: Literal["rigid", "none"] = "rigid"
    """`rigid`: u = w = 0 below the last layer. `none`: the last layer goes on for ever."""

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

    @property
    def interfaces(self) -> Array:
        """(n_layers - 1,) depths of the boundaries between layers, m."""
        return np.cumsum([layer.thickness for layer in self.layers[:-1]])

    @property
    def bedrock_depth(self) -> float:
        """Depth of the rigid base, m; infinite where there is none."""
        return sum(layer.thickness for layer in self.layers)

    def layer_at(self, depth: Array) -> NDArray[np.int64]:
        """Index of the layer at each depth, same shape as `depth`."""
        return np.searchsorted(self.interfaces, depth, side="right").astype(np.int64)

    @classmethod
    def uniform(
        cls,
        modulus: float,
        viscosity: float = 0.0,
        density: float = 2000.0,
        poisson_ratio: float = 0.35,
        bedrock_depth: float = math.inf,
    ) -> Ground:
        """Ground of one layer; without base when `bedrock_depth` (m) is infinite."""
        layer = Layer(modulus, viscosity, density, poisson_ratio, bedrock_depth)
        return cls((layer,), "rigid" if math.isfinite(bedrock_depth) else "none")


@dataclass(frozen=True)
class Plate:
    """A rigid circular plate lying on the surface."""

    radius: float
    """a, m, > 0."""
    mass: float = 0.0
    """Mass that moves between the load cell and the ground, kg, >= 0."""
    contact: Literal["rough", "smooth"] = "rough"
    """`rough`: the ground does not move sideways under the plate. `smooth`: it does so freely."""

    def __post_init__(self) -> None:
        require(0 < self.radius < math.inf, "radius", "m, > 0", self.radius)
        require(0 <= self.mass < math.inf, "mass", "kg, >= 0", self.mass)
        require(self.contact in ("rough", "smooth"), "contact", "rough or smooth", self.contact)


@dataclass(frozen=True)
class Resolution:
    """How fine the grid and the time step are."""

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
    """Growth of the element size per distance where waves are absorbed or come too late. A faster
    one reflects short waves before they are absorbed: undamped soil, 0.5: 3 % of the peak."""
    undamped_wavelengths: float = 0.75
    """Undamped ground beyond the last sensor, in shear wavelengths of the pulse (2 T0 c_s)."""
    damped_wavelengths: float = 1.5
    """Width of the absorbing zone, in pressure wavelengths of the pulse (2 T0 c_p)."""
    absorption: float = 2.0
    """Viscosity added at the end of the absorbing zone, times E/omega of the pulse."""
    steps_per_pulse: float = 150.0
    """Time steps in one pulse duration (at least)."""
    halvings: int = 0
    """How often each element is halved afterwards, in both directions."""

    def refined(self) -> Resolution:
        """Every element halved, and the time step."""
        return replace(self, halvings=self.halvings + 1, steps_per_pulse=2 * self.steps_per_pulse)


@dataclass(frozen=True)
class Grid:
    """Lines of the product grid and where its absorbing zone lies."""

    radii: Array
    """(n_r,) increasing from 0, m."""
    depths: Array
    """(n_z,) increasing from 0, m."""
    damping_start: float
    """Distance (radius, and depth where there is no base) at which absorption begins, m."""
    damping_width: float
    """Distance over which it rises to its full value, m."""


def graded_line(breaks: Sequence[float], size: Callable[[float], float]) -> Array:
    """Grid line through all `breaks` whose spacing is at most about `size(position)`.

    Parameters
    ----------
    breaks : increasing positions that become grid points, m
    size : wanted spacing at a position, m; its slope must be below 1

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
    ground: Ground,
    plate: Plate,
    offsets: Sequence[float],
    pulse_duration: float,
    duration: float,
    resolution: Resolution,
) -> Grid:
    """Grid for one drop: fine at the plate edge, following the waves, coarse where none return.

    Parameters
    ----------
    offsets : distances from the plate centre where the ground is observed, m
    pulse_duration : T0 of the load, s
    duration : length of the record, s
    """
    for offset in offsets:
        require(0 <= offset < math.inf, "offset", "m, >= 0", offset)
    pulse = math.pi / pulse_duration
    longest = max(layer.pressure_speed(pulse) for layer in ground.layers) * 2 * pulse_duration
    shortest = min(layer.shear_speed(pulse) for layer in ground.layers) * 2 * pulse_duration
    start = max([plate.radius, *offsets]) + resolution.undamped_wavelengths * shortest
    width = resolution.damped_wavelengths * longest
    end = start + width
    slow, fast = _returning_depths(ground, pulse, duration)
    if ground.base == "rigid":  # what stays near the plate decays within a few depths of the layer
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
    ground: Ground, plate: Plate, pulse_duration: float, resolution: Resolution
) -> list[float]:
    """Element size per layer that resolves the shortest shear wavelength, m.

    On soft ground the plate follows the load up to omega a / c_s near 1 only; on stiff ground that
    filter is open, and the kinks where the load begins and ends send shorter waves.
    """
    top = ground.layers[0].shear_speed(math.pi / pulse_duration)
    openness = math.sqrt(top * pulse_duration / (8 * plate.radius))
    highest = resolution.highest_frequency / pulse_duration * min(max(openness, 1.0), 2.5)
    return [
        layer.shear_speed(2 * math.pi * highest) / highest / resolution.elements_per_wavelength
        for layer in ground.layers
    ]


def _returning_depths(ground: Ground, pulse: float, duration: float) -> tuple[float, float]:
    """Depths from which S waves (one way as P) and P waves can return within `duration`, m."""
    shear = max(layer.shear_speed(pulse) for layer in ground.layers)
    pressure = max(layer.pressure_speed(pulse) for layer in ground.layers)
    return duration * shear * pressure / (shear + pressure), duration * pressure / 2


def _halve(line: Array) -> Array:
    return np.sort(np.concatenate([line, (line[1:] + line[:-1]) / 2]))
