r"""Sums of damped resonances, the form of the surrogate.

.. math:: f(y) = \sum_k \frac{|q_k|^2 (a_k + b_k y / |q_k|)}{y^2 - 2 \Re(q_k) y + |q_k|^2}

with the poles :math:`q_k` (and their conjugates) in the left half plane.  ``y`` is proportional
to :math:`s \sqrt{\rho / G^*(s)}`; for a Kelvin-Voigt solid Re s > 0 implies Re y > 0, so such a
sum is the transform of a real, causal and stable response whatever the coefficients are.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from inversion.forward.kernel import ComplexArray, FloatArray

# Individuals whose intermediate arrays stay in the second-level cache together.
_CHUNK_ELEMENTS = 32_000


def basis(y: ComplexArray, poles: ComplexArray) -> ComplexArray:
    """Basis functions at ``y`` (n,) for ``poles`` (k,): (n, 2k), first the a_k, then the b_k."""
    size = np.abs(poles)
    resonance = size**2 / (y[:, None] ** 2 - 2.0 * poles.real * y[:, None] + size**2)
    return np.hstack([resonance, resonance * (y[:, None] / size)])


def evaluate(
    y: ComplexArray, poles: ComplexArray, coefficients: FloatArray, single: bool = False
) -> ComplexArray:
    """Values of the sums of many individuals.

    Parameters
    ----------
    y : (m, n) ndarray of complex, one row an individual
    poles : (k,) ndarray of complex
    coefficients : (channels, 2k) ndarray of float, or (m, channels, 2k)
    single : bool
        Single precision inside: twice as fast, relative error about 1e-5 of the largest value.

    Returns
    -------
    (m, channels, n) ndarray of complex
    """
    kind: type[np.floating[Any]] = np.float32 if single else np.float64
    count, width = y.shape
    size = np.abs(poles)
    k = poles.size
    channels = coefficients.shape[-2]
    per_pole = np.concatenate(
        [coefficients[..., :k] * size**2, coefficients[..., k:] * size], axis=-2
    )
    weights = np.ascontiguousarray(np.swapaxes(per_pole, -1, -2), dtype=kind)
    damping = (-2.0 * poles.real).astype(kind)
    square = (size**2).astype(kind)
    real, imaginary = y.real.astype(kind), y.imag.astype(kind)
    square_real = (real - imaginary) * (real + imaginary)
    square_imaginary = 2.0 * real * imaginary
    chunk = max(1, _CHUNK_ELEMENTS // max(1, width * k))
    buffers = [np.empty((chunk, width, k), dtype=kind) for _ in range(3)]
    result = np.empty((count, channels, width), dtype=np.complex128)
    for first in range(0, count, chunk):
        rows = slice(first, min(first + chunk, count))
        u, v = _resonances(
            real[rows], imaginary[rows], square_real[rows], square_imaginary[rows],
            damping, square, buffers,
        )  # fmt: skip
        own = weights[rows] if weights.ndim == 3 else weights
        sums = (u @ own) - 1j * (v @ own)
        values = sums[..., :channels] + y[rows, :, None] * sums[..., channels:]
        result[rows] = np.swapaxes(values, 1, 2)
    return result


def _resonances(
    real: FloatArray,
    imaginary: FloatArray,
    square_real: FloatArray,
    square_imaginary: FloatArray,
    damping: FloatArray,
    square: FloatArray,
    buffers: list[FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Real part and minus the imaginary part of 1/(y^2 + damping y + square), (m, n, k)."""
    u, v, norm = (buffer[: real.shape[0]] for buffer in buffers)
    np.multiply(real[..., None], damping, out=u)
    u += square
    u += square_real[..., None]
    np.multiply(imaginary[..., None], damping, out=v)
    v += square_imaginary[..., None]
    np.multiply(u, u, out=norm)
    norm += v * v
    np.reciprocal(norm, out=norm)
    u *= norm
    v *= norm
    return u, v
