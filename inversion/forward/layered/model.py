r"""From layered grounds to displacement histories.

.. math:: \frac{w_r}{F_{cell}} = \frac{C_r}{1 + m s^2 \, C_0} \, R_{instrument}(s)

with :math:`C_r` the displacement at r over the force on the ground, the plate's mass m between
load cell and ground, and the instrument's responses applied to the model, never taken off the
data: as for the homogeneous ground (:mod:`inversion.forward.model`), whose place it can take.
Under a plate whose pressure is given the centre's displacement moves the mass.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import ComplexArray, FloatArray
from inversion.forward.laplace import DampedTransform
from inversion.forward.layered.ground import LayeredGrounds, MediumParameter
from inversion.forward.layered.plate import (
    LayeredPlateModel,
    PlateSetup,
    displacement_per_force,
    displacement_slopes,
)
from inversion.forward.layered.quadrature import FAST, Layout, WavenumberRule, nodes
from inversion.forward.model import Instrument

# Grounds that need so many times the wavenumbers of the least demanding one are solved apart.
_MORE_NODES = 1.4


class LayeredForwardModel:
    """Displacement histories of one drop on many layered grounds at once.

    Parameters
    ----------
    plate : one of LAYERED_PLATE_MODELS
    instrument : Instrument
    offsets : sequence of float, m, distances of the sensors from the plate's centre
    time : (n,) ndarray of float, s, uniform samples of the load
    load : (n,) ndarray of float, N, without its offset
    wanted : (m,) ndarray of float, s, times at which the displacement is wanted, >= 0
    band : float, Hz
    rule : WavenumberRule
    """

    def __init__(
        self,
        plate: LayeredPlateModel,
        instrument: Instrument,
        offsets: Sequence[float],
        time: FloatArray,
        load: FloatArray,
        wanted: FloatArray,
        band: float,
        rule: WavenumberRule = FAST,
    ) -> None:
        self.setup = PlateSetup(plate, instrument.plate_radius, tuple(map(float, offsets)))
        self.instrument = instrument
        self.rule = rule
        if instrument.load_filter is not None:
            # Beyond twice its corner a low-pass has taken what no model can put back.
            band = min(band, 2.0 * instrument.load_filter)
        transform = DampedTransform(float(wanted[-1]), min(band, 0.5 / (time[1] - time[0])))
        self.s = transform.s
        spectrum = transform.of_samples(time, load) * instrument.response(self.s)
        synthesis = spectrum[:, None] * transform.synthesis(wanted)
        # Re(W @ M) as one real product: [Re W, Im W] @ [Re M; -Im M].
        self._synthesis = np.vstack([synthesis.real, -synthesis.imag])

    def transfer(self, grounds: LayeredGrounds) -> ComplexArray:
        """Displacement over load at every sensor, (m, n_sensors, n_frequencies), m/N."""
        return layered_transfer(self.setup, self.instrument.plate_mass, self.s, grounds, self.rule)

    def displacement(self, grounds: LayeredGrounds) -> FloatArray:
        """Displacement at the wanted times, (m, n_sensors, n_times), m."""
        return self._in_time(self.transfer(grounds))

    def displacement_slopes(
        self, grounds: LayeredGrounds, parameters: Sequence[MediumParameter]
    ) -> tuple[FloatArray, FloatArray]:
        """Displacement as of :meth:`displacement`, and its derivatives by the parameters.

        Returns
        -------
        (m, n_sensors, n_times) and (m, len(parameters), n_sensors, n_times), m and m over the unit
        """
        transfer, slopes = layered_transfer_slopes(
            self.setup, self.instrument.plate_mass, self.s, grounds, parameters, self.rule
        )
        histories = self._in_time(np.concatenate([transfer[:, None], slopes], axis=1))
        return histories[:, 0], histories[:, 1:]

    def _in_time(self, transfer: ComplexArray) -> FloatArray:
        """Histories (..., n_times) under the load, of transfer functions (..., n_frequencies)."""
        parts = np.concatenate([transfer.real, transfer.imag], axis=-1)
        flat = parts.reshape(-1, parts.shape[-1]) @ self._synthesis
        return flat.reshape(*transfer.shape[:-1], -1)


def layered_transfer(
    setup: PlateSetup,
    plate_mass: float,
    s: ComplexArray,
    grounds: LayeredGrounds,
    rule: WavenumberRule = FAST,
) -> ComplexArray:
    """Displacement at the sensors over the load above a plate of ``plate_mass`` kg, m/N.

    Returns
    -------
    (m, n_sensors, n) ndarray of complex
    """
    if plate_mass != 0.0:
        setup = _with_centre(setup)
    compliance = np.empty((len(grounds), len(setup.offsets), s.size), dtype=np.complex128)
    for alike in _alike(setup, grounds, s, rule):
        compliance[alike] = displacement_per_force(setup, grounds.take(alike), s, rule)
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
    r""":func:`layered_transfer` with its derivatives by the parameters.

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
    for alike in _alike(setup, grounds, s, rule):
        compliance[alike], slopes[alike] = displacement_slopes(
            setup, grounds.take(alike), s, parameters, rule
        )
    if plate_mass == 0.0:
        return compliance, slopes
    inertia = plate_mass * s**2
    whole = 1.0 + inertia * compliance[:, :1]
    transfer: ComplexArray = compliance[:, 1:] / whole
    moved = slopes[:, :, 1:] - inertia * transfer[:, None] * slopes[:, :, :1]
    return transfer, moved / whole[:, None]


def _alike(
    setup: PlateSetup, grounds: LayeredGrounds, s: ComplexArray, rule: WavenumberRule
) -> list[NDArray[np.intp]]:
    """Places of grounds that need about as many wavenumbers.

    All grounds of a call share theirs, so that one of hardly any viscosity among many would make
    all of them as slow as itself.
    """
    if len(grounds) == 1:
        return [np.zeros(1, dtype=np.intp)]
    counts = np.array(
        [_node_count(setup, grounds.take([place]), s, rule) for place in range(len(grounds))]
    )
    order = np.argsort(counts, kind="stable")
    found, first = [], 0
    for place in range(1, order.size + 1):
        if place == order.size or counts[order[place]] > _MORE_NODES * counts[order[first]]:
            found.append(order[first:place])
            first = place
    return found


def _node_count(
    setup: PlateSetup, grounds: LayeredGrounds, s: ComplexArray, rule: WavenumberRule
) -> int:
    layout = Layout.of(rule, grounds.at(s, setup.radius), grounds.rock, setup.farthest)
    return int(nodes(layout)[0].size)


def _with_centre(setup: PlateSetup) -> PlateSetup:
    """The same plate with its centre as the first sensor."""
    return PlateSetup(setup.plate, setup.radius, (0.0, *setup.offsets))
