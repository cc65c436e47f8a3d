r"""Damped Fourier transforms between sampled histories and the Laplace domain.

.. math:: W(s_k) = \int_0^\infty w(t) e^{-s_k t} dt, \quad s_k = \sigma + 2 \pi i k / T, \qquad
          w(t) = \frac{e^{\sigma t}}{T} \Big[ \Re W(s_0) + 2 \sum_{k \ge 1} \Re
          \big( W(s_k) e^{2 \pi i k t / T} \big) \Big]

This is Durbin's method (Eq. 15 of doi 10.11835/j.issn.2096-6717.2022.021), written as
an inverse Fourier series: the value at t + T is aliased to t as :math:`e^{-\sigma T} w(t + T)`.

Window, damping and band are linked: the period is 1.25 times the record, sigma T = 7 (aliasing
below 1e-3 of a tail that itself has decayed), and the highest 40 % of the band are tapered. A sharp
end of the band would leave a ripple that :math:`e^{\sigma t}` amplifies 270 times towards the end
of the record.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from inversion.arrays import ComplexArray, FloatArray
from inversion.errors import ModelError

_PERIOD_OVER_RECORD = 1.25
_DAMPING_TIMES_PERIOD = 7.0
_TAPER_START = 0.6

# Band of the final fit and of the search, Hz.  The spectrum of a pulse of 8 ms has fallen to 3 % at
# 640 Hz and to 0.5 % at 1600 Hz, and the ground transmits a tenth of that.
FULL_BAND_HZ = 1600.0
SEARCH_BAND_HZ = 640.0


@dataclass(frozen=True)
class DampedTransform:
    """Frequencies of a damped Fourier transform of a record.

    Parameters
    ----------
    duration : float, s, > 0, latest time of the record
    band : float, Hz, highest frequency
    """

    duration: float
    band: float = FULL_BAND_HZ

    def __post_init__(self) -> None:
        if not (self.duration > 0.0 and self.band * self.duration > 1.0):
            raise ModelError(
                "damped transform: expected a duration above 0 and a band above 1/duration, got "
                f"{self.duration:g} s and {self.band:g} Hz"
            )

    @property
    def period(self) -> float:
        """Period T of the Fourier series, s."""
        return _PERIOD_OVER_RECORD * self.duration

    @property
    def damping(self) -> float:
        """Real part sigma of the Laplace variable, 1/s."""
        return _DAMPING_TIMES_PERIOD / self.period

    @cached_property
    def s(self) -> ComplexArray:
        """Laplace variables, (n,), 1/s."""
        count = int(np.ceil(self.band * self.period)) + 1
        return self.damping + 2j * np.pi / self.period * np.arange(count)

    @cached_property
    def taper(self) -> FloatArray:
        """Weights of the frequencies, (n,): one, then a cosine to zero at the end of the band."""
        place = np.arange(self.s.size) / self.s.size
        fall = np.clip((place - _TAPER_START) / (1.0 - _TAPER_START), 0.0, 1.0)
        result: FloatArray = 0.5 * (1.0 + np.cos(np.pi * fall))
        return result

    def of_samples(self, time: FloatArray, values: FloatArray) -> ComplexArray:
        r"""Return the transform (n,) of straight lines through samples at uniform ``time`` (m,), s.

        The hat function of one sample has the transform :math:`\\Delta t (\\sinh(s \\Delta t/2) /
        (s \\Delta t/2))^2 e^{-s t_j}`. Before the first sample and after the last the values are
        zero.
        """
        step = time[1] - time[0]
        half = 0.5 * step * self.s
        hat = step * (np.sinh(half) / half) ** 2
        damped = values * np.exp(-self.damping * time)
        result: ComplexArray = hat * (self._turns(time) @ damped).conj()
        return result

    def synthesis(self, time: FloatArray) -> ComplexArray:
        """Return the matrix M (n, m) with w(time) = Re(W @ M), which includes the taper."""
        scale = np.full(self.s.size, 2.0 / self.period)
        scale[0] *= 0.5
        result: ComplexArray = self._turns(time) * np.exp(self.damping * time)
        return (scale * self.taper)[:, None] * result

    def _turns(self, time: FloatArray) -> ComplexArray:
        """Return exp(i omega_k t), (n, m), as powers of exp(i omega_1 t), ten times as fast."""
        turn = np.exp(2j * np.pi / self.period * time)
        result = np.empty((self.s.size, time.size), dtype=np.complex128)
        result[0], filled = 1.0, 1
        while filled < result.shape[0]:
            rows = min(filled, result.shape[0] - filled)
            np.multiply(
                result[:rows], result[filled - 1] * turn, out=result[filled : filled + rows]
            )
            filled += rows
        return result


def band_of_load(time: FloatArray, load: FloatArray, part: float) -> float:
    """Return the highest frequency, Hz, at which a load's spectrum exceeds part of its maximum.

    Parameters
    ----------
    time, load : (n,) ndarrays of float, uniform; s and any unit
    part : float, in (0, 1)
    """
    # Padded to four times the record, so that lobes between its own frequencies are not missed.
    count = 4 * time.size
    spectrum = np.abs(np.fft.rfft(load, count))
    highest = np.flatnonzero(spectrum > part * spectrum.max())[-1]
    return float(highest / (count * (time[1] - time[0])))
