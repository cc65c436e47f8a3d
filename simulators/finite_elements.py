r"""Axisymmetric finite elements of a rigid plate on viscoelastic ground.

Weak form, with :math:`\varepsilon` the axisymmetric strain (hoop strain :math:`u/r` included):

.. math::
    \int \left[ 2 G \varepsilon(v):\varepsilon(u) + \lambda \, \mathrm{div} v \, \mathrm{div} u
    \right] 2 \pi r \, dr \, dz + \ldots = F v_{plate}

and likewise for viscosity (E replaced by eta, at the same Poisson's ratio: a Kelvin-Voigt solid,
:math:`\sigma = C(E \varepsilon + \eta \dot\varepsilon)`) and for inertia. Nine-node quadrilaterals;
the volumetric part is integrated with 2 x 2 points, which prevents locking up to nu = 0.495
(selective reduced integration: Hughes, The Finite Element Method, 1987, chapter 4). The plate is
one degree of freedom shared by all nodes under it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sparse
import skfem
from scipy.sparse.linalg import splu

from simulators.mesh import Array, Grid, Plate, SoilProfile, graded_line

# Integration orders that select 3 x 3 and 2 x 2 Gauss points.
FULL_ORDER, REDUCED_ORDER = 5, 3
# Ordering for symmetric matrices without pivoting: less than half the default's fill-in.
ORDERING = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0}
PLATE_INDEX = 0  # index of the plate among the free degrees of freedom


def _shear_form(u: Any, v: Any, w: Any) -> Any:
    radius = w.x[0]
    normal = u.grad[0, 0] * v.grad[0, 0] + u.grad[1, 1] * v.grad[1, 1] + u[0] * v[0] / radius**2
    shear = (u.grad[0, 1] + u.grad[1, 0]) * (v.grad[0, 1] + v.grad[1, 0])
    return w.shear * (2 * normal + shear) * radius


def _volume_form(u: Any, v: Any, w: Any) -> Any:
    radius = w.x[0]
    dilation = u.grad[0, 0] + u.grad[1, 1] + u[0] / radius
    return w.lame * dilation * (v.grad[0, 0] + v.grad[1, 1] + v[0] / radius) * radius


def _inertia_form(u: Any, v: Any, w: Any) -> Any:
    return w.density * (u[0] * v[0] + u[1] * v[1]) * w.x[0]


class FiniteElementModel:
    """Finite-element matrices of a plate on the ground, without the fixed degrees of freedom.

    Parameters
    ----------
    ground : Ground
    plate : Plate
    grid : Grid
    offsets : sequence of float, m
        Distances from the plate centre at which the ground is observed. Up to the plate radius the
        motion is that of the plate.
    absorption : float, s, >= 0
        Viscosity over modulus added at the end of the absorbing zone, rising as the square of the
        distance from its start.

    Attributes
    ----------
    stiffness, damping, inertia : (n, n) sparse, N/m, N s/m, kg
        Degree of freedom `PLATE_INDEX` is the plate, whose mass is in `inertia`. A damping law of
        the ground multiplies `stiffness` and is not in it.
    observation : (n_offsets, n) sparse
        Matrix that returns the vertical displacements at the offsets from those of all degrees of
        freedom.
    size : int
        Number n of degrees of freedom.
    """

    def __init__(
        self,
        ground: SoilProfile,
        plate: Plate,
        grid: Grid,
        offsets: Sequence[float] = (),
        absorption: float = 0.0,
    ) -> None:
        self.plate, self.damping_law = plate, ground.damping_law
        mesh = skfem.MeshQuad.init_tensor(grid.radii, grid.depths)
        element = skfem.ElementVector(skfem.ElementQuad2())
        full = skfem.Basis(mesh, element, intorder=FULL_ORDER)
        reduced = skfem.Basis(mesh, element, intorder=REDUCED_ORDER)
        free = _free_degrees(full, ground, plate)
        self.size = int(free.shape[1])

        def assemble(form: Any, basis: Any, viscous: bool) -> Any:
            position = np.asarray(basis.global_coordinates())
            fields = _material(position, ground, grid, absorption, viscous)
            matrix = skfem.BilinearForm(form).assemble(basis, **fields)
            return (free.T @ (2 * math.pi * matrix) @ free).tocsc()

        self.stiffness, self.damping = (
            assemble(_shear_form, full, viscous) + assemble(_volume_form, reduced, viscous)
            for viscous in (False, True)
        )
        self.inertia = assemble(_inertia_form, full, False)
        self.inertia[PLATE_INDEX, PLATE_INDEX] += plate.mass
        self.observation = _observation(full, free, plate, offsets)

    def static_stiffness(self) -> float:
        """Return the static force on the plate over its displacement, N/m.

        For constant-Q soil it is computed with the modulus at the reference frequency.
        """
        return 1.0 / float(factorise(self.stiffness)(self.plate_force())[PLATE_INDEX])

    def compliance(self, laplace: complex) -> complex:
        """Return the displacement of the plate over the force on the ground, m/N.

        The mass of the plate is excluded.

        Parameters
        ----------
        laplace : complex, 1/s
            Laplace variable, i omega for a steady vibration.
        """
        weightless = self.inertia.copy()
        weightless[PLATE_INDEX, PLATE_INDEX] -= self.plate.mass
        law = self.damping_law.factor(laplace) if self.damping_law else 1.0
        matrix = law * self.stiffness + laplace * self.damping + laplace**2 * weightless
        force = self.plate_force().astype(complex)
        return complex(factorise(matrix.astype(complex))(force)[PLATE_INDEX])

    def plate_force(self) -> Array:
        """Return the force vector (n,) of a unit force on the plate."""
        force = np.zeros(self.size)
        force[PLATE_INDEX] = 1.0
        return force


def factorise(matrix: Any) -> Any:
    """Return a function that solves a linear system with a symmetric sparse matrix.

    It maps the right-hand side to the solution.
    """
    return splu(matrix.tocsc(), options={"SymmetricMode": True}, **ORDERING).solve


def effective_modulus(ground: SoilProfile, plate: Plate) -> float:
    """Return the modulus of uniform ground with the same static stiffness, Pa.

    Poisson's ratio is that of the first layer. Both grounds are solved on one grid, so that the
    effect of its end at 400 radii cancels.
    """
    end = min(ground.bedrock_depth, 400 * plate.radius)

    def size(distance: float) -> float:
        return 1e-3 * plate.radius + 0.3 * distance

    radii = graded_line(
        [0.0, plate.radius, 400 * plate.radius], lambda r: size(abs(r - plate.radius))
    )
    depths = graded_line([0.0, *ground.interfaces, end], size)
    grid = Grid(radii, depths, math.inf, 1.0)
    modulus, poisson_ratio = ground.layers[0].modulus, ground.layers[0].poisson_ratio
    uniform = SoilProfile.uniform(modulus, 0.0, 2000.0, poisson_ratio, ground.bedrock_depth)
    stiffness, reference = (
        FiniteElementModel(soil, plate, grid).static_stiffness() for soil in (ground, uniform)
    )
    return modulus * stiffness / reference


def _material(
    position: Any, ground: SoilProfile, grid: Grid, absorption: float, viscous: bool
) -> dict[str, Array]:
    """Return shear modulus, Lame's first constant and density at positions (2, ...).

    If `viscous`, the first two are those of the viscosity instead of the modulus.
    """
    index = ground.layer_at(position[1])

    def value(name: str) -> Array:
        return np.array([getattr(layer, name) for layer in ground.layers], dtype=float)[index]

    modulus, poisson = value("modulus"), value("poisson_ratio")
    if viscous:
        depth = position[1] if ground.base == "none" else np.zeros_like(position[1])
        ramps = [
            np.maximum(x - grid.damping_start, 0) / grid.damping_width for x in (position[0], depth)
        ]
        modulus = value("viscosity") + modulus * absorption * (ramps[0] ** 2 + ramps[1] ** 2)
    if ground.growth is not None:
        modulus = modulus * ground.growth.factor(position[1])
    shear = modulus / (2 * (1 + poisson))
    return {
        "shear": shear,
        "lame": 2 * shear * poisson / (1 - 2 * poisson),
        "density": value("density"),
    }


def _free_degrees(basis: Any, ground: SoilProfile, plate: Plate) -> Any:
    """Return the sparse map (all, free) from free degrees of freedom to those of the basis.

    On the axis and under a rough plate u = 0, on the base and the far boundaries u = w = 0, and
    every w under the plate is the one of the plate.
    """
    radius, depth = basis.doflocs
    tiny = 1e-9 * plate.radius
    vertical = np.zeros(basis.N, dtype=bool)
    for numbers in (basis.nodal_dofs, basis.facet_dofs, basis.interior_dofs):
        vertical[numbers[1::2]] = True
    under = (depth < tiny) & (radius < plate.radius + tiny)
    fixed = (radius > radius.max() - tiny) | (depth > depth.max() - tiny)
    fixed |= ~vertical & (radius < tiny)
    if plate.contact == "rough":
        fixed |= ~vertical & under
    target = np.full(basis.N, -1)
    target[under & vertical] = PLATE_INDEX
    free = ~fixed & (target < 0)
    target[free] = PLATE_INDEX + 1 + np.arange(np.count_nonzero(free))
    rows = np.flatnonzero(target >= 0)
    shape = (basis.N, 1 + np.count_nonzero(free))
    return sparse.csr_matrix((np.ones(rows.size), (rows, target[rows])), shape=shape)


def _observation(basis: Any, free: Any, plate: Plate, offsets: Sequence[float]) -> Any:
    """Return the sparse map (n_offsets, free) to vertical surface displacements at the offsets."""
    rows = []
    for offset in offsets:
        if offset <= plate.radius:
            rows.append(sparse.csr_matrix(([1.0], ([0], [PLATE_INDEX])), shape=(1, free.shape[1])))
            continue
        components = basis.probes(np.array([[offset], [0.0]])).tocsr()  # u, then w
        rows.append(components[1:2] @ free)
    return sparse.vstack(rows).tocsr() if rows else sparse.csr_matrix((0, free.shape[1]))
