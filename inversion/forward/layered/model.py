r"""Displacement histories of layered grounds.

.. math:: \frac{w_r}{F_{cell}} = \frac{C_r}{1 + m s^2 \, C_0} \, R_{instrument}(s)

with :math:`C_r` the displacement at r over the force on the ground, and the plate's mass m between
load cell and ground. The responses of the instrument are applied to the model, and the data are not
deconvolved, as for the homogeneous ground (:mod:`inversion.forward.model`). Under a plate with a
prescribed pressure the mass moves with the centre.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import ComplexArray
from inversion.forward.layered.ground import LayeredGrounds, MediumParameter
from inversion.forward.layered.plate import (
    PlateSetup,
    displacement_per_force,
    displacement_slopes,
)
from inversion.forward.layered.quadrature import FAST, NodeLayout, WavenumberRule, nodes

# Largest ratio of the number of wavenumbers of grounds that are solved together.
_MAX_NODE_RATIO = 1.4


def layered_transfer(
    setup: PlateSetup,
    plate_mass: float,
    s: ComplexArray,
    grounds: LayeredGrounds,
    rule: WavenumberRule = FAST,
) -> ComplexArray:
    """Return the displacement at the sensors over the load above a plate of ``plate_mass`` kg, m/N.

    Parameters
    ----------
    setup : PlateSetup
    plate_mass : float, kg
    s : (n,) ndarray of complex, Laplace variables, 1/s
    grounds : LayeredGrounds of m grounds
    rule : WavenumberRule

    Returns
    -------
    (m, n_sensors, n) ndarray of complex
    """
    if plate_mass != 0.0:
        setup = _with_centre(setup)
    compliance = np.empty((len(grounds), len(setup.offsets), s.size), dtype=np.complex128)
    for group in _groups_of_similar_cost(setup, grounds, s, rule):
        compliance[group] = displacement_per_force(setup, grounds.take(group), s, rule)
    if plate_mass == 0.0:
        return compliance
    centre, sensors = compliance[:, :1], compliance[:, 1:]
    result: ComplexArray = sensors / (1.0 + plate_mass * s**2 * centre)
    return result


def layered_transfer_slopes(
    setup: PlateSetup,
    plate_mass: float,
    s: ComplexArray,
    grounds: LayeredGrounds,
    parameters: Sequence[MediumParameter],
    rule: WavenumberRule = FAST,
) -> tuple[ComplexArray, ComplexArray]:
    r"""Return :func:`layered_transfer` and its derivatives with respect to parameters of the media.

    .. math:: d \frac{C_r}{1 + m s^2 C_0} = \frac{d C_r - m s^2 \, w_r \, d C_0}{1 + m s^2 C_0}

    Returns
    -------
    (m, n_sensors, n) and (m, len(parameters), n_sensors, n) ndarrays of complex
    """
    if plate_mass != 0.0:
        setup = _with_centre(setup)
    shape = (len(setup.offsets), s.size)
    compliance = np.empty((len(grounds), *shape), dtype=np.complex128)
    slopes = np.empty((len(grounds), len(parameters), *shape), dtype=np.complex128)
    for group in _groups_of_similar_cost(setup, grounds, s, rule):
        compliance[group], slopes[group] = displacement_slopes(
            setup, grounds.take(group), s, parameters, rule
        )
    if plate_mass == 0.0:
        return compliance, slopes
    inertia = plate_mass * s**2
    denominator = 1.0 + inertia * compliance[:, :1]
    transfer: ComplexArray = compliance[:, 1:] / denominator
    transfer_slopes = slopes[:, :, 1:] - inertia * transfer[:, None] * slopes[:, :, :1]
    return transfer, transfer_slopes / denominator[:, None]


def _groups_of_similar_cost(
    setup: PlateSetup, grounds: LayeredGrounds, s: ComplexArray, rule: WavenumberRule
) -> list[NDArray[np.intp]]:
    """Return groups of grounds (indices) that need similar numbers of wavenumbers.

    All grounds of one call share their wavenumbers. A single ground with little viscosity needs
    many, and would slow down the others.
    """
    if len(grounds) == 1:
        return [np.zeros(1, dtype=np.intp)]
    counts = np.array(
        [_node_count(setup, grounds.take([place]), s, rule) for place in range(len(grounds))]
    )
    order = np.argsort(counts, kind="stable")
    groups, first = [], 0
    for place in range(1, order.size + 1):
        if place == order.size or counts[order[place]] > _MAX_NODE_RATIO * counts[order[first]]:
            groups.append(order[first:place])
            first = place
    return groups


def _node_count(
    setup: PlateSetup, grounds: LayeredGrounds, s: ComplexArray, rule: WavenumberRule
) -> int:
    layout = NodeLayout.of(rule, grounds.at(s, setup.radius), grounds.rock, setup.farthest)
    return int(nodes(layout)[0].size)


def _with_centre(setup: PlateSetup) -> PlateSetup:
    """Return the setup with the plate's centre as the first sensor."""
    return PlateSetup(setup.plate, setup.radius, (0.0, *setup.offsets))
