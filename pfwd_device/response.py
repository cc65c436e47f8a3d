r"""Correction of a geophone record for its response, for display only.

A geophone with the natural frequency :math:`f_n` and the damping h turns the velocity v of its case
into u, where

.. math:: \ddot u + 2 h \omega_n \dot u + \omega_n^2 u = \ddot v, \qquad \omega_n = 2 \pi f_n

(Havskov and Alguacil, Instrumentation in Earthquake Seismology, 2nd ed., eq. 2.29, with unit gain
at high frequency). Integrated twice from rest:
:math:`v = u + 2 h \omega_n \int u + \omega_n^2 \iint u`. Every error of the offset grows with the
square of the time. Therefore recorded and inverted data are never corrected; the inversion applies
the response to the model.
"""

import numpy as np
from numpy.typing import NDArray


def correct_response(
    values: NDArray[np.float64], sampling_rate: float, natural_frequency: float, damping: float
) -> NDArray[np.float64]:
    """Return the velocity of the ground from a record that begins at rest and has no offset.

    Parameters
    ----------
    values : (n,) ndarray of float, m/s
    sampling_rate : float, Hz
    natural_frequency : float, Hz
    damping : float

    Returns
    -------
    (n,) ndarray of float, m/s
    """
    omega = 2 * np.pi * natural_frequency
    once = _integrate(values, sampling_rate)
    twice = _integrate(once, sampling_rate)
    return values + 2 * damping * omega * once + omega**2 * twice


def _integrate(values: NDArray[np.float64], sampling_rate: float) -> NDArray[np.float64]:
    """Integrate by the trapezoidal rule from zero."""
    steps = (values[1:] + values[:-1]) / (2 * sampling_rate)
    return np.concatenate([[0.0], np.cumsum(steps)])
