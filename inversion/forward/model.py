r"""Displacement histories of homogeneous grounds.

.. math:: \frac{w_r}{F_{cell}} = \frac{\Phi_r / (G^* a)}{1 + m s^2 \, \Phi_0 / (G^* a)} \,
          R_{geophone}(s), \qquad \Phi = \Phi(p), \quad p = s a \sqrt{\rho / G^*}

with the plate's mass m between load cell and ground (F_cell = F_contact + m times the plate's
acceleration). The responses of the instrument are applied to the model; the data are not
deconvolved.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from inversion.arrays import ComplexArray, FloatArray
from inversion.errors import ModelError
from inversion.forward.laplace import DampedTransform
from inversion.forward.surrogate import PlateResponse

MIN_RADIUS_M = 0.01
"""Smallest accepted plate radius, m, far below that of any real plate."""

MAX_RADIUS_M = 10.0
"""Largest accepted plate radius, m, far above that of any real plate."""

REFERENCE_RAD_S = 2.0 * np.pi * 30.0
r"""Angular frequency, rad/s, at which the modulus of constant-Q ground is stated: about that of the
load pulses."""


@dataclass(frozen=True)
class Instrument:
    """Geometry and declared responses of the device.

    Parameters
    ----------
    plate_radius : float, m, > 0
    plate_mass : float, kg, mass that moves between load cell and ground
    geophone_natural_frequency, geophone_damping : float, Hz and -; None: the record is corrected
    load_filter : float, Hz, corner of a second-order Butterworth low-pass in the load channel;
        None: there is no filter
    load_delay : float, s, lag of the load channel
    """

    plate_radius: float
    plate_mass: float = 0.0
    geophone_natural_frequency: float | None = None
    geophone_damping: float | None = None
    load_filter: float | None = None
    load_delay: float = 0.0

    def __post_init__(self) -> None:
        if not self.plate_radius > 0.0:
            raise ModelError(f"plate radius: expected a value > 0 m, got {self.plate_radius:g}")
        if self.plate_radius < MIN_RADIUS_M:
            raise ModelError(
                f"plate radius: expected at least {MIN_RADIUS_M:g} m, got {self.plate_radius:g}"
            )
        if self.plate_radius > MAX_RADIUS_M:
            raise ModelError(
                f"plate radius: expected at most {MAX_RADIUS_M:g} m, got {self.plate_radius:g} "
                "(in millimetres?)"
            )
        if self.plate_mass < 0.0:
            raise ModelError(f"plate mass: expected a value >= 0 kg, got {self.plate_mass:g}")

    def response(self, s: ComplexArray) -> ComplexArray:
        """Return the factor (n,) of the instrument on displacement over load at ``s`` (n,)."""
        result: ComplexArray = np.exp(s * self.load_delay)
        if self.geophone_natural_frequency is not None and self.geophone_damping is not None:
            natural = 2.0 * np.pi * self.geophone_natural_frequency
            result = result * s**2 / (s**2 + 2.0 * self.geophone_damping * natural * s + natural**2)
        if self.load_filter is not None:
            corner = 2.0 * np.pi * self.load_filter
            result = result * (1.0 + np.sqrt(2.0) * s / corner + (s / corner) ** 2)
        return result


def loss_exponent(quality: float) -> float:
    r"""Return the exponent :math:`\alpha = 2 \arctan(1/Q)/\pi` of constant-Q ground.

    Kjartansson (1979), J. Geophys. Res. 84(B9), 4737-4748, equation 7.
    """
    return 2.0 * math.atan2(1.0, quality) / math.pi


@dataclass(frozen=True, eq=False)
class Grounds:
    r"""Parameters of m homogeneous grounds, each array (m,).

    .. math:: E^*(s) = E \, (s/\omega_0)^\alpha + \eta s

    With :math:`\alpha = 0` this is the Kelvin-Voigt solid; with :math:`\eta = 0` the constant-Q
    solid of Kjartansson, whose loss per cycle does not depend on the frequency. Each of them is
    causal, and so is their sum.

    Parameters
    ----------
    modulus : E, Pa
    viscosity : eta, Pa s
    density : kg/m3
    inverse_depth : 1/m, one over the bedrock depth, or over the depth z0 of growth; 0: half-space
    loss_exponent : alpha, 0 <= value < 1, or None: 0; see :func:`loss_exponent`
    """

    modulus: FloatArray
    viscosity: FloatArray
    density: FloatArray
    inverse_depth: FloatArray
    loss_exponent: FloatArray | None = None


class Synthesis:
    """Sum of frequencies that gives the displacement histories under the load of one drop.

    Parameters
    ----------
    instrument : Instrument
    time : (n,) ndarray of float, s, uniform samples of the load
    load : (n,) ndarray of float, N, without its offset
    times : (m,) ndarray of float, s, times of the displacement, >= 0
    band : float, Hz, highest frequency; the samples and a filter in the load channel may limit it
    duration : float, s, of the transform; by default up to the last of ``times``
    """

    def __init__(
        self,
        instrument: Instrument,
        time: FloatArray,
        load: FloatArray,
        times: FloatArray,
        band: float,
        duration: float | None = None,
    ) -> None:
        if instrument.load_filter is not None:
            # Above twice its corner frequency the filter leaves too little signal for a comparison.
            band = min(band, 2.0 * instrument.load_filter)
        band = min(band, 0.5 / float(time[1] - time[0]))
        self.transform = DampedTransform(duration or float(times[-1]), band)
        self.s = self.transform.s
        spectrum = self.transform.of_samples(time, load) * instrument.response(self.s)
        synthesis = spectrum[:, None] * self.transform.synthesis(times)
        self.matrix = np.vstack([synthesis.real, -synthesis.imag])
        """Factor of transfer functions as [Re W, Im W], so that Re(W @ M) is one real product."""

    def histories(self, transfer: ComplexArray) -> FloatArray:
        """Return histories (..., n_times) from transfer functions (..., n_frequencies)."""
        parts = np.concatenate([transfer.real, transfer.imag], axis=-1)
        flat = parts.reshape(-1, parts.shape[-1]) @ self.matrix
        return np.asarray(flat.reshape(*transfer.shape[:-1], -1))


class ForwardModel:
    """Displacement histories of one drop for many homogeneous grounds at once.

    Parameters
    ----------
    surrogate : PlateResponse
        Fast approximation of the compliance, for the offsets of the sensors; the first one is 0.
    instrument : Instrument
    time : (n,) ndarray of float, s, uniform samples of the load
    load : (n,) ndarray of float, N, without its offset
    times : (m,) ndarray of float, s, times of the displacement, >= 0
    band : float, Hz, highest frequency
    single : bool, True: single precision within the surrogate
    """

    def __init__(
        self,
        surrogate: PlateResponse,
        instrument: Instrument,
        time: FloatArray,
        load: FloatArray,
        times: FloatArray,
        band: float,
        single: bool = False,
    ) -> None:
        self.surrogate = surrogate
        self.instrument = instrument
        self.single = single
        self._synthesis = Synthesis(instrument, time, load, times, band)
        self.s = self._synthesis.s

    def transfer(self, grounds: Grounds) -> ComplexArray:
        """Return displacement over load at every sensor, (m, n_sensors, n_frequencies), m/N."""
        return transfer_function(self.surrogate, self.instrument, self.s, grounds, self.single)

    def displacement(self, grounds: Grounds) -> FloatArray:
        """Return the displacement at ``times``, (m, n_sensors, n_times), m."""
        return self._synthesis.histories(self.transfer(grounds))


def transfer_function(
    surrogate: PlateResponse,
    instrument: Instrument,
    s: ComplexArray,
    grounds: Grounds,
    single: bool = False,
) -> ComplexArray:
    """Return displacement at each sensor over the load above the plate, m/N.

    Parameters
    ----------
    surrogate : PlateResponse
    instrument : Instrument
    s : (n,) ndarray of complex, Laplace variables, Re s > 0, 1/s
    grounds : Grounds of m grounds
    single : bool, True: single precision within the surrogate

    Returns
    -------
    (m, n_sensors, n) ndarray of complex
    """
    a = instrument.plate_radius
    shear, p = _shear_and_frequency(surrogate, instrument, s, grounds)
    phi = surrogate.compliance(p, a * grounds.inverse_depth, single)
    compliance = phi / (a * shear)[:, None, :]
    if instrument.plate_mass > 0.0:
        denominator = 1.0 + instrument.plate_mass * s**2 * compliance[:, :1, :]
        compliance = compliance / denominator
    return compliance


def transfer_slopes(
    surrogate: PlateResponse,
    instrument: Instrument,
    s: ComplexArray,
    grounds: Grounds,
    fields: Sequence[str],
) -> tuple[ComplexArray, ComplexArray]:
    r"""Return the transfer function and its derivatives with respect to fields of the grounds.

    With :math:`C = \Phi/(G^* a)` and :math:`p = s a \sqrt{\rho / G^*}`

    .. math:: \frac{\partial C}{\partial G^*} = -\frac{C + p \, \partial_p C / 2}{G^*}, \quad
              \frac{\partial E^*}{\partial \alpha} = E (s/\omega_0)^\alpha \ln(s/\omega_0), \quad
              \frac{\partial C}{\partial \rho} = \frac{p \, \partial_p C}{2 \rho}, \quad
              d \frac{C_r}{1 + m s^2 C_0} = \frac{d C_r - m s^2 \, w_r \, d C_0}{1 + m s^2 C_0}

    Parameters
    ----------
    surrogate, instrument, s, grounds : as for :func:`transfer_function`
    fields : sequence of str, names of fields of `Grounds`

    Returns
    -------
    (m, n_sensors, n) and (m, len(fields), n_sensors, n) ndarrays of complex
    """
    a = instrument.plate_radius
    shear, p = _shear_and_frequency(surrogate, instrument, s, grounds)
    by_depth = "inverse_depth" in fields
    phi, phi_by_p, phi_by_depth = surrogate.compliance_slopes(
        p, a * grounds.inverse_depth, by_depth
    )
    over = (1.0 / (a * shear))[:, None, :]
    compliance = phi * over
    half = (0.5 * p)[:, None, :] * phi_by_p * over
    by_modulus = -(compliance + half) / shear[:, None, :]
    to_shear = 0.5 / (1.0 + surrogate.problem.poisson_ratio)
    power = _power(grounds, s)[:, None, :]
    slopes = np.empty((p.shape[0], len(fields), *compliance.shape[1:]), dtype=np.complex128)
    for column, name in enumerate(fields):
        if name == "modulus":
            slopes[:, column] = to_shear * power * by_modulus
        elif name == "viscosity":
            slopes[:, column] = (to_shear * s) * by_modulus
        elif name == "loss_exponent":
            power_slope = grounds.modulus[:, None, None] * power * np.log(s / REFERENCE_RAD_S)
            slopes[:, column] = to_shear * power_slope * by_modulus
        elif name == "density":
            slopes[:, column] = half / grounds.density[:, None, None]
        elif phi_by_depth is not None:
            slopes[:, column] = a * phi_by_depth * over
    if instrument.plate_mass > 0.0:
        inertia = instrument.plate_mass * s**2
        denominator = 1.0 + inertia * compliance[:, :1, :]
        compliance = compliance / denominator
        slopes -= inertia * compliance[:, None] * slopes[:, :, :1]
        slopes /= denominator[:, None]
    return compliance, slopes


def _shear_and_frequency(
    surrogate: PlateResponse, instrument: Instrument, s: ComplexArray, grounds: Grounds
) -> tuple[ComplexArray, ComplexArray]:
    """Return the complex shear modulus, Pa, and the dimensionless p, each (m, n)."""
    complex_modulus = grounds.modulus[:, None] * _power(grounds, s)
    complex_modulus = complex_modulus + grounds.viscosity[:, None] * s
    shear = complex_modulus * (0.5 / (1.0 + surrogate.problem.poisson_ratio))
    p = s * (instrument.plate_radius * np.sqrt(grounds.density[:, None] / shear))
    return shear, p


def _power(grounds: Grounds, s: ComplexArray) -> ComplexArray | FloatArray:
    """Return (s / REFERENCE_RAD_S) ** loss exponent, (m, n), or (m, 1) if all exponents are 0."""
    if grounds.loss_exponent is None:
        return np.ones((grounds.modulus.size, 1))
    result: ComplexArray = np.exp(grounds.loss_exponent[:, None] * np.log(s / REFERENCE_RAD_S))
    return result
