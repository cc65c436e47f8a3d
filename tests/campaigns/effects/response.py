r"""Response of finite-element ground to a short pulse of force, from which any drop is computed.

The pulse, called hat, is triangular: it rises over one sample and falls over the next.

Ground and step rule are linear, so the displacement under a contact force that is linear between
samples is, without any further approximation,

.. math:: w(t_n) = \sum_{j=1}^{n} F_j \, k_{n-j+1}

with :math:`k` the response to a hat of 1 N. One finite-element run of a weightless plate thus
serves every hammer, plate mass and contact nonlinearity, see `march`. The finite
elements must take one step per sample. Then the steps of `march`, whose plate obeys the same rule,
are equivalent to finite elements of ground and plate together, and as stable. With several internal
steps the response starts too softly, and `march` is unstable.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.signal import fftconvolve

from simulators.drop import DropSimulator, PrescribedLoad
from simulators.finite_elements import effective_modulus
from simulators.mesh import Array, Plate, Resolution, SoilLayer, SoilProfile, require

RESPONSE_STEP_S = 5e-5  # s; 160 samples in the shortest pulse
RESPONSE_DURATION_S = 0.075  # s
MIN_PULSE_S = 0.008  # s
# The grid resolves the shortest pulse, and its outer part absorbs the longest. With an absorbing
# zone for 8 ms the errors of distant sensors on a half-space are 2 to 5 %, with this one 0.1 to 0.3
# %.
RESOLUTION = Resolution(undamped_wavelengths=1.5, damped_wavelengths=3.0, absorption=4.0)
_CACHE_VERSION = 3


@dataclass(frozen=True)
class GroundResponse:
    """Response of the ground to a triangular pulse of 1 N on the plate, at each sensor."""

    ground: SoilProfile
    plate: Plate
    """Radius and contact; its mass is 0."""
    time_step: float
    """Step between samples, s; the hat is two steps wide."""
    offsets: tuple[float, ...]
    """Distances of the sensors from the plate centre, m; the first is 0, the plate itself."""
    displacement: Array
    """Displacement response (n_offsets, n), m/N; 0 at the first sample."""
    velocity: Array
    """Velocity response (n_offsets, n), m/(s N)."""
    static_stiffness: float
    """Static force over displacement of the plate, N/m; for constant-Q soil at its reference."""
    modulus: float
    """Modulus of the lowest layer, Pa; for constant-Q soil at its reference; for a modulus that
    grows with depth that of the uniform ground with the same static stiffness."""

    @cached_property
    def reversed_centre(self) -> Array:
        """Displacement of the plate, (n,), m/N, in reversed order, for a fast convolution."""
        return np.ascontiguousarray(self.displacement[0][::-1])

    def motion(self, force: Array) -> tuple[Array, Array]:
        """Return displacement (m) and velocity (m/s) at the offsets under a force on the ground.

        Parameters
        ----------
        force : (m,) ndarray of float, N
            Force at the samples, m <= n; the first must be 0.
        """
        count = force.size
        require(count <= self.displacement.shape[1], "force", "no longer than the response", count)
        require(force[0] == 0, "force", "0 at the first sample", force[0])
        kernels = self.displacement, self.velocity
        shifted = [np.append(k[:, 1:count], 0 * k[:, :1], 1) for k in kernels]
        moved, speed = (
            fftconvolve(np.broadcast_to(force, k.shape), k, axes=1)[:, :count] for k in shifted
        )
        return moved, speed

    def rescaled(self, time: float, density: float) -> GroundResponse:
        r"""Return the response of ground with another modulus, viscosity and density, exactly.

        It is the same response in other units. All times are multiplied by `time` and the density
        by `density`; lengths are unchanged. The modulus becomes :math:`E \, density / time^2`, the
        viscosity :math:`\eta \, density / time`, and the time step is multiplied by `time`.
        """
        modulus, law = density / time**2, self.ground.damping_law
        law = law and replace(law, reference=law.reference / time)
        layers = tuple(
            replace(
                layer,
                modulus=layer.modulus * modulus,
                viscosity=layer.viscosity * density / time,
                density=layer.density * density,
            )
            for layer in self.ground.layers
        )
        return replace(
            self,
            ground=replace(
                self.ground,
                layers=layers,
                damping_law=law,
            ),
            time_step=self.time_step * time,
            displacement=self.displacement / modulus,
            velocity=self.velocity / (modulus * time),
            static_stiffness=self.static_stiffness * modulus,
            modulus=self.modulus * modulus,
        )


def ground_response(
    ground: SoilProfile,
    radius: float,
    offsets: tuple[float, ...],
    *,
    contact: str = "rough",
    duration: float = RESPONSE_DURATION_S,
    cache: Path | None = None,
) -> GroundResponse:
    """Return the response of a ground to a triangular pulse of force on a weightless plate.

    Parameters
    ----------
    ground : Ground
    radius : float, m
        Radius of the plate.
    offsets : tuple of float, m
        Distances of the sensors from the plate centre; the first is 0.
    contact : "rough" or "smooth"
        Contact of plate and ground.
    duration : float, s
        Length of the response.
    cache : Path, optional
        Folder in which responses are stored for later runs; None: they are not stored.
    """
    require(offsets[:1] == (0.0,), "offsets", "the plate centre first", offsets)
    plate = Plate(radius, 0.0, "smooth" if contact == "smooth" else "rough")
    key = repr((_CACHE_VERSION, ground, plate, offsets, duration, RESPONSE_STEP_S, MIN_PULSE_S))
    path = cache / f"{hashlib.sha256(key.encode()).hexdigest()[:24]}.npz" if cache else None
    if path is not None and path.is_file():
        with np.load(path) as stored:
            moved, speed = stored["moved"], stored["speed"]
            stiffness, modulus = float(stored["stiffness"]), float(stored["modulus"])
    else:
        moved, speed, stiffness = _run(ground, plate, offsets, duration)
        modulus = ground.layers[-1].modulus
        if ground.growth is not None:
            modulus = effective_modulus(ground, plate)
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_suffix(".part.npz")
            np.savez(part, moved=moved, speed=speed, stiffness=stiffness, modulus=modulus)
            part.replace(path)
    return GroundResponse(ground, plate, RESPONSE_STEP_S, offsets, moved, speed, stiffness, modulus)


def _run(
    ground: SoilProfile, plate: Plate, offsets: tuple[float, ...], duration: float
) -> tuple[Array, Array, float]:
    simulator = DropSimulator(
        ground, plate, offsets, duration, RESPONSE_STEP_S, MIN_PULSE_S, RESOLUTION
    )
    hat = PrescribedLoad(RESPONSE_STEP_S * np.arange(3.0), np.array([0.0, 1.0, 0.0]))
    require(simulator.substeps == 1, "substeps", "one step per sample", simulator.substeps)
    drop = simulator.run(hat)
    stiffness = simulator.model.static_stiffness()
    return drop.ground_displacement, drop.ground_velocity, stiffness


def stacked_ground(below: SoilLayer, above: Sequence[tuple[float, float]]) -> SoilProfile:
    """Return infinitely deep ground with layers of equal density and Poisson's ratio above it.

    Parameters
    ----------
    below : SoilLayer
        Ground below the layers.
    above : sequence of (ratio, thickness)
        Layers from the top down: modulus and viscosity relative to the ground below, thickness, m.
    """
    layers = [
        replace(
            below,
            modulus=below.modulus * ratio,
            viscosity=below.viscosity * ratio,
            thickness=thickness,
        )
        for ratio, thickness in above
    ]
    return SoilProfile((*layers, replace(below, thickness=math.inf)), "none")
