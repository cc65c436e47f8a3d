"""A quick look at the drops of a point as layered ground: where a closer fit may begin.

The diagnosis fits layers together with other effects, one prediction at a time.  What takes it
long, to find the right minimum among several, the batch fit does beforehand: for the variants of
the ground (rock below or none) and of the instrument (geophone, lag) that a set of effects has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from inversion.fitting.ground_parameters import layered_space
from inversion.fitting.layered.fit import LayeredFit, Window, fit_layers
from inversion.fitting.layered.number import WORTH, information
from inversion.fitting.misfit import WeightedDrop

# Sensors at so many distances tell a layer between the top and the ground below.
_MIDDLE_DISTANCES = 4


class FirstLook:
    """Layered grounds that fit the drops of a point, computed when they are asked for.

    Parameters
    ----------
    drops : sequence of WeightedDrop
    poisson_ratio : float
    density : float or None, kg/m3, where it is declared
    rock_depth : float or None, m, where it is declared; inf: none
    elastic : bool
    peak_modulus : float, Pa, by the peak method
    """

    def __init__(
        self,
        drops: Sequence[WeightedDrop],
        poisson_ratio: float,
        density: float | None,
        rock_depth: float | None,
        elastic: bool,
        peak_modulus: float,
    ) -> None:
        self.drops = tuple(drops)
        self.poisson_ratio = poisson_ratio
        self.density = density
        self.rock_depth = rock_depth
        self.elastic = elastic
        self.peak_modulus = peak_modulus
        self._known: dict[tuple[int, bool, bool, bool], LayeredFit] = {}
        self._middle: bool | None = None
        self._window: Window | None = None

    @property
    def distances(self) -> int:
        """Number of distances of the sensors from the plate's centre."""
        return self.drops[0].n_distances

    @property
    def has_middle(self) -> bool:
        """Whether the record asks for a layer between the top and the ground below."""
        if self._middle is None:
            self._middle = False
            if self.distances >= _MIDDLE_DISTANCES:
                # The richer ground decides which part of the record is explained.
                three, two = (self._fit(media, True, True, True) for media in (3, 2))
                self._middle = information(three) < information(two) - WORTH
        return self._middle

    def values(self, *, rock: bool, geophone: bool, lag: bool) -> dict[str, float]:
        """The unknowns of the best ground of a variant, by name, SI.

        ``modulus``, ``relaxation`` and ``density`` are those of the ground below; of the top and,
        where there is one, the middle: ``modulus_ratio``, ``relaxation_ratio``, ``density_ratio``,
        ``thickness`` and the same with ``middle_``; ``depth`` of the rock from the surface; of the
        instrument ``natural_frequency``, ``damping`` and ``lag``.
        """
        media = 3 if self.has_middle else 2
        fit = self.fit(rock=rock, geophone=geophone, lag=lag)
        ground = fit.space.grounds(fit.best.point[None])
        modulus, relaxation = ground.modulus[0], ground.viscosity[0] / ground.modulus[0]
        found = {
            "modulus": float(modulus[-1]),
            "relaxation": float(relaxation[-1]),
            "density": float(ground.density[0, -1]),
        }
        for j, prefix in enumerate(("", "middle_")[: media - 1]):
            found[f"{prefix}modulus_ratio"] = float(modulus[j] / modulus[-1])
            if not self.elastic:
                found[f"{prefix}relaxation_ratio"] = float(relaxation[j] / relaxation[-1])
            if self.density is None:
                found[f"{prefix}density_ratio"] = float(
                    ground.density[0, j] / ground.density[0, -1]
                )
            found[f"{prefix}thickness"] = float(ground.thickness[0, j])
        if fit.space.rock:
            found["depth"] = float(ground.thickness[0].sum())
        values = fit.space.values(fit.best.point[None])[0]
        said = dict(zip(fit.space.names, values, strict=True))
        for name, key in (
            ("natural_frequency", "natural_frequency"),
            ("geophone_damping", "damping"),
            ("lag", "lag"),
        ):
            if name in said:
                found[key] = float(said[name])
        return found

    def fit(self, *, rock: bool, geophone: bool, lag: bool) -> LayeredFit:
        """The best layered ground of a variant of ground and instrument."""
        return self._fit(3 if self.has_middle else 2, rock, geophone, lag)

    def _fit(self, media: int, rock: bool, geophone: bool, lag: bool) -> LayeredFit:
        declared = self.rock_depth is not None and math.isfinite(self.rock_depth)
        key = (media, rock or declared, geophone, lag)
        if key not in self._known:
            first = self.drops[0].instrument
            space = layered_space(
                media,
                self.peak_modulus,
                first.plate_radius,
                self.poisson_ratio,
                density=self.density,
                rock_depth=self.rock_depth if declared else (None if rock else math.inf),
                elastic=self.elastic,
                own_relaxation=True,
                geophone=geophone and first.geophone_natural_frequency is None,
                lag=lag,
            )
            # The same starts for every variant.
            rng = np.random.default_rng(0)
            fit = fit_layers(self.drops, space, "rigid-rough", rng, window=self._window)
            self._window = self._window or fit.window
            self._known[key] = fit
        return self._known[key]
