"""Starting points for layered ground in the diagnosis.

The diagnosis fits layers together with other effects, one prediction at a time, and would take long
to find the right minimum among several. A fit of many points at once finds it beforehand, for each
variant of the ground (with or without rock) and of the instrument (geophone, lag).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from inversion.fitting.ground_fit import GroundFit, Window
from inversion.fitting.ground_parameters import layered_space
from inversion.fitting.layer_count import MIN_BIC_GAIN, information
from inversion.fitting.layered_fit import fit_layers
from inversion.fitting.misfit import WeightedDrop

# Smallest number of sensor distances that determine two layers on the ground below.
_MIN_DISTANCES_FOR_TWO_LAYERS = 4


class LayerStarts:
    """Layered grounds that fit the drops of a point, each computed when it is first requested.

    Parameters
    ----------
    drops : sequence of WeightedDrop
    poisson_ratio : float
    density : float, kg/m3; None: not declared
    rock_depth : float, m; inf: no rock; None: not declared
    elastic : bool, True: no viscosity
    peak_modulus : float, Pa, from the peak method
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
        self._fits: dict[tuple[int, bool, bool, bool], GroundFit] = {}
        self._has_second_layer: bool | None = None
        self._window: Window | None = None

    @property
    def n_distances(self) -> int:
        """Number of different distances of the sensors from the plate's centre."""
        return self.drops[0].n_distances

    @property
    def has_second_layer(self) -> bool:
        """True if the record supports a second layer between the top and the ground below."""
        if self._has_second_layer is None:
            self._has_second_layer = False
            if self.n_distances >= _MIN_DISTANCES_FOR_TWO_LAYERS:
                # The ground with more media is fitted first: it determines the part of the record
                # that is used.
                three, two = (self._fit(media, True, True, True) for media in (3, 2))
                gain = information(two) - information(three)
                self._has_second_layer = gain > MIN_BIC_GAIN
        return self._has_second_layer

    def values(self, *, rock: bool, geophone: bool, lag: bool) -> dict[str, float]:
        """Return the parameters of the best ground of a variant, by name, in SI units.

        ``modulus``, ``relaxation`` (time) and ``density`` are those of the ground below the layers.
        ``modulus_ratio``, ``relaxation_ratio``, ``density_ratio`` and ``thickness`` are those of
        the top layer; with the prefix ``middle_`` of the second layer, if there is one. ``depth``
        is that of the rock below the surface. ``natural_frequency``, ``damping`` and ``lag`` are
        those of the instrument.

        Parameters
        ----------
        rock : bool, True: the ground has rock at an unknown depth
        geophone : bool, True: the response of the geophones is fitted
        lag : bool, True: a lag of the sensors is fitted
        """
        fit = self.fit(rock=rock, geophone=geophone, lag=lag)
        ground = fit.space.grounds(fit.best.point[None])
        modulus, density = ground.modulus[0], ground.density[0]
        relaxation = ground.viscosity[0] / modulus
        values = {
            "modulus": float(modulus[-1]),
            "relaxation": float(relaxation[-1]),
            "density": float(density[-1]),
        }
        for j, prefix in enumerate(("", "middle_")[: fit.space.media - 1]):
            values[f"{prefix}modulus_ratio"] = float(modulus[j] / modulus[-1])
            if not self.elastic:
                values[f"{prefix}relaxation_ratio"] = float(relaxation[j] / relaxation[-1])
            if self.density is None:
                values[f"{prefix}density_ratio"] = float(density[j] / density[-1])
            values[f"{prefix}thickness"] = float(ground.thickness[0, j])
        if fit.space.rock:
            values["depth"] = float(ground.thickness[0].sum())
        fitted = fit.space.values(fit.best.point[None])[0]
        for name, value in zip(fit.space.names, fitted.tolist(), strict=True):
            if name in ("natural_frequency", "geophone_damping", "lag"):
                values[name.removeprefix("geophone_")] = value
        return values

    def fit(self, *, rock: bool, geophone: bool, lag: bool) -> GroundFit:
        """Return the best layered ground of a variant, see `values`."""
        return self._fit(3 if self.has_second_layer else 2, rock, geophone, lag)

    def _fit(self, media: int, rock: bool, geophone: bool, lag: bool) -> GroundFit:
        is_declared = self.rock_depth is not None and math.isfinite(self.rock_depth)
        key = (media, rock or is_declared, geophone, lag)
        if key not in self._fits:
            instrument = self.drops[0].instrument
            space = layered_space(
                media,
                self.peak_modulus,
                instrument.plate_radius,
                self.poisson_ratio,
                density=self.density,
                rock_depth=self.rock_depth if is_declared else (None if rock else math.inf),
                elastic=self.elastic,
                separate_relaxation=True,
                geophone=geophone and instrument.geophone_natural_frequency is None,
                lag=lag,
            )
            # The seed is fixed, so that every variant has the same starting points.
            rng = np.random.default_rng(0)
            fit = fit_layers(self.drops, space, "rigid-rough", rng, window=self._window)
            self._window = self._window or fit.window
            self._fits[key] = fit
        return self._fits[key]
