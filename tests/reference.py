"""Textbook closed forms and published values, written literally, for the tests to compare with.

Nothing here is imported from the packages under test. Lengths in m, forces in N, moduli in Pa;
displacement downward positive; harmonic motion exp(+i omega t), so that s = i omega.

Sources

- Boussinesq 1885: Application des potentiels a l'etude de l'equilibre et du mouvement des solides
  elastiques. Gauthier-Villars, Paris.
- Mossakovskii 1954: The fundamental mixed problem of the theory of elasticity for a half-space with
  a circular line separating the boundary conditions. Prikl. Mat. Mekh. 18, 187-196. The stiffness
  in this form: Borodich and Keer 2004, Proc. R. Soc. Lond. A 460, 507-514.
- Sneddon 1965: The relation between load and penetration in the axisymmetric Boussinesq problem for
  a punch of arbitrary profile. Int. J. Engng Sci. 3, 47-57.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

# --- elastic constants and waves -----------------------------------------------------------------


def shear_modulus(modulus: float, poisson_ratio: float) -> float:
    """G = E / (2 (1 + nu))."""
    return modulus / (2 * (1 + poisson_ratio))


def p_wave_velocity(modulus: float, poisson_ratio: float, density: float) -> float:
    """cp = sqrt(M / rho) with M = E (1 - nu) / ((1 + nu) (1 - 2 nu))."""
    nu = poisson_ratio
    stiffness = modulus * (1 - nu) / ((1 + nu) * (1 - 2 * nu))
    return math.sqrt(stiffness / density)


def s_wave_velocity(modulus: float, poisson_ratio: float, density: float) -> float:
    """cs = sqrt(G / rho)."""
    return math.sqrt(shear_modulus(modulus, poisson_ratio) / density)


# --- static half-space ---------------------------------------------------------------------------


def smooth_disc_stiffness(modulus: float, poisson_ratio: float, radius: float) -> float:
    """Boussinesq 1885, Sneddon 1965: F/w = 4 G a / (1 - nu)."""
    return 4 * shear_modulus(modulus, poisson_ratio) * radius / (1 - poisson_ratio)


def rough_disc_stiffness(modulus: float, poisson_ratio: float, radius: float) -> float:
    """Mossakovskii 1954: F/w = 4 G a ln(3 - 4 nu) / (1 - 2 nu)."""
    shear = shear_modulus(modulus, poisson_ratio)
    return 4 * shear * radius * math.log(3 - 4 * poisson_ratio) / (1 - 2 * poisson_ratio)


# --- static layer on a rigid base ----------------------------------------------------------------

# Stiffness of the smooth disc on a bonded layer over that on the half-space, against h0/a, by
# Poisson's ratio. Computed twice by independent programs; every digit given is certain but the
# last, which may differ by one.
LAYER_STATIC_FACTOR: dict[float, dict[float, float]] = {
    1 / 3: {2: 1.6501, 10 / 3: 1.3449, 5: 1.2136, 20 / 3: 1.1539, 10: 1.0984, 20: 1.0472},
    0.35: {2: 1.6653, 10 / 3: 1.3520, 5: 1.2176, 20 / 3: 1.1567, 10: 1.1001, 20: 1.0480},
}
LAYER_STATIC_FACTOR_TOLERANCE = 1.5e-4

# --- dynamic stiffness of the disc on a half-space -----------------------------------------------


@dataclass(frozen=True)
class Impedance:
    """K = 4 G a / (1 - nu) (k + i a0 c) with a0 = omega a / cs."""

    poisson_ratio: float
    a0: float
    k: float
    c: float


# Smooth (relaxed) disc, nu = 1/3, published to three digits: docs/verification/impedance_study.md
# of github.com/mohammedbala/sassi-edu, commit 70fae461.
PUBLISHED_SMOOTH_IMPEDANCES = (
    Impedance(1 / 3, 0.5, 0.969, 0.793),
    Impedance(1 / 3, 1.0, 0.883, 0.824),
    Impedance(1 / 3, 1.5, 0.765, 0.872),
)
PUBLISHED_IMPEDANCE_TOLERANCE = 1e-3

# Smooth disc, converged; two independent programs agree in every digit given.
SMOOTH_IMPEDANCES = (
    Impedance(1 / 3, 0.5, 0.96890, 0.79305),
    Impedance(1 / 3, 1.0, 0.88248, 0.82374),
    Impedance(1 / 3, 1.5, 0.76412, 0.87205),
    Impedance(0.35, 0.5, 0.968419, 0.793055),
    Impedance(0.35, 1.0, 0.880265, 0.823182),
    Impedance(0.35, 2.0, 0.639513, 0.927196),
    Impedance(0.35, 4.0, 0.512189, 1.047563),
    Impedance(0.0, 1.0, 0.864261, 0.912153),
    Impedance(0.25, 1.0, 0.886355, 0.834403),
    Impedance(0.45, 1.0, 0.847886, 0.834781),
)
SMOOTH_IMPEDANCE_TOLERANCE = 1e-5


@dataclass(frozen=True)
class PhiVector:
    """Phi = G* a w / F at z = rho a^2 s^2 / G*, for four models of the plate.

    centre: pressure of the static rigid plate, displacement at r = 0 (the published plate);
    averaged: the same pressure, displacement averaged with it; smooth and rough: rigid plate
    without and with full friction.
    """

    poisson_ratio: float
    depth_over_radius: float | None
    """None is the half-space."""
    z: complex
    centre: complex
    averaged: complex
    smooth: complex
    rough: complex


# Two independent programs agree to 1e-7 (centre, averaged, smooth) and 1e-5 (rough, sixteen terms).
PHI_VECTORS = (
    PhiVector(
        poisson_ratio=0.35,
        depth_over_radius=None,
        z=-1 + 0.5j,
        centre=0.0896492 - 0.0890160j,
        averaged=0.0875834 - 0.0728821j,
        smooth=0.0886873 - 0.0725007j,
        rough=0.08863 - 0.06971j,
    ),
    PhiVector(
        poisson_ratio=0.35,
        depth_over_radius=20 / 3,
        z=-1 + 0.5j,
        centre=0.0896898 - 0.0880602j,
        averaged=0.0876116 - 0.0719613j,
        smooth=0.0887102 - 0.0715791j,
        rough=0.08856 - 0.06883j,
    ),
    PhiVector(
        poisson_ratio=0.25,
        depth_over_radius=10 / 3,
        z=-1 + 0.5j,
        centre=0.0955771 - 0.1247829j,
        averaged=0.0927035 - 0.1040698j,
        smooth=0.0942695 - 0.1034918j,
        rough=0.09298 - 0.09551j,
    ),
    # A layer's backward waves are near this one.
    PhiVector(
        poisson_ratio=0.45,
        depth_over_radius=2.0,
        z=-4 + 1j,
        centre=-0.0171131 - 0.1142369j,
        averaged=0.0067250 - 0.0696058j,
        smooth=0.0145272 - 0.0758321j,
        rough=0.01912 - 0.07708j,
    ),
)
PHI_TOLERANCE = 1.5e-7  # absolute
PHI_ROUGH_TOLERANCE = 2e-5  # absolute
