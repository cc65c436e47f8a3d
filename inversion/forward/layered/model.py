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

from inversion.arrays import ComplexArray, FloatArray
from inversion.forward.laplace import DampedTransform
from inversion.forward.layered.ground import LayeredGrounds, Parameter
from inversion.forward.layered.plate import (
    LayeredPlateModel,
    PlateSetup,
    displacement_per_force,
    displacement_slopes,
)
from inversion.forward.layered.quadrature import FAST, WavenumberRule
from inversion.forward.model import Instrument


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
        self, grounds: LayeredGrounds, parameters: Sequence[Parameter]
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
    if plate_mass == 0.0:
        return displacement_per_force(setup, grounds, s, rule)
    compliance = displacement_per_force(_with_centre(setup), grounds, s, rule)
    centre, sensors = compliance[:, :1], compliance[:, 1:]
    result: ComplexArray = sensors / (1.0 + plate_mass * s**2 * centre)
    return result


def layered_transfer_slopes(
    setup: PlateSetup,
    plate_mass: float,
    s: ComplexArray,
    grounds: LayeredGrounds,
    parameters: Sequence[Parameter],
    rule: WavenumberRule = FAST,
) -> tuple[ComplexArray, ComplexArray]:
    r""":func:`layered_transfer` with its derivatives by the parameters.

    .. math:: d \frac{C_r}{1 + m s^2 C_0} = \frac{d C_r - m s^2 \, w_r \, d C_0}{1 + m s^2 C_0}

    Returns
    -------
    (m, n_sensors, n) and (m, len(parameters), n_sensors, n) ndarrays of complex
    """
    if plate_mass == 0.0:
        return displacement_slopes(setup, grounds, s, parameters, rule)
    compliance, slopes = displacement_slopes(_with_centre(setup), grounds, s, parameters, rule)
    inertia = plate_mass * s**2
    whole = 1.0 + inertia * compliance[:, :1]
    transfer: ComplexArray = compliance[:, 1:] / whole
    moved = slopes[:, :, 1:] - inertia * transfer[:, None] * slopes[:, :, :1]
    return transfer, moved / whole[:, None]


def _with_centre(setup: PlateSetup) -> PlateSetup:
    """The same plate with its centre as the first sensor."""
    return PlateSetup(setup.plate, setup.radius, (0.0, *setup.offsets))
