r"""Sums of damped resonances, the form in which a surrogate approximates the plate's compliance.

.. math:: f(y) = \sum_k \frac{|q_k|^2 (a_k + b_k y / |q_k|)}{y^2 - 2 \Re(q_k) y + |q_k|^2}

with the poles :math:`q_k` (and their conjugates) in the left half plane. ``y`` is proportional to
:math:`s \sqrt{\rho / G^*(s)}`. For a Kelvin-Voigt solid Re s > 0 implies Re y > 0, so that such a
sum is the transform of a real, causal and stable response for any coefficients.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from inversion.arrays import ComplexArray, FloatArray

# Number of elements of intermediate arrays that fit into the second-level cache.
_CHUNK_ELEMENTS = 32_000


def basis(y: ComplexArray, poles: ComplexArray) -> ComplexArray:
    """Return the basis functions at ``y`` (n,) for ``poles`` (k,), (n, 2k).

    Those of the coefficients a_k come first, then those of b_k.
    """
    size = np.abs(poles)
    resonance = size**2 / (y[:, None] ** 2 - 2.0 * poles.real * y[:, None] + size**2)
    return np.hstack([resonance, resonance * (y[:, None] / size)])


def barycentric_shares(nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Return shares (m, d) of Chebyshev nodes (d,) in a polynomial at values (m,)."""
    order = np.arange(nodes.size)
    weights = (-1.0) ** order * np.sin(np.pi * (order + 0.5) / nodes.size)
    distance = values[:, None] - nodes
    distance[distance == 0.0] = 1e-300
    share = weights / distance
    result: FloatArray = share / share.sum(axis=1, keepdims=True)
    return result


def fit_sums(
    y: ComplexArray, values: ComplexArray, weights: FloatArray, poles: ComplexArray
) -> FloatArray:
    """Return coefficients (channels, 2k) of a least-squares fit to values (n, channels).

    ``weights`` (n,) multiply the residuals. Normal equations of scaled columns with a ridge at
    rounding level, refined twice, are ten times faster than an orthogonal factorisation; the
    refinement restores the accuracy.
    """
    from scipy.linalg import cho_factor, cho_solve

    functions = basis(y, poles) * weights[:, None]
    matrix = np.concatenate([functions.real, functions.imag])
    target = values * weights[:, None]
    right = np.concatenate([target.real, target.imag])
    scale = np.linalg.norm(matrix, axis=0)
    matrix /= scale
    gram = matrix.T @ matrix
    gram[np.diag_indices_from(gram)] += 1e-13 * matrix.shape[1]
    factor = cho_factor(gram, lower=True, check_finite=False)
    solution = cho_solve(factor, matrix.T @ right, check_finite=False)
    for _ in range(2):
        solution += cho_solve(factor, matrix.T @ (right - matrix @ solution), check_finite=False)
    result: FloatArray = (solution / scale[:, None]).T
    return result


def numerators(poles: ComplexArray, coefficients: FloatArray) -> FloatArray:
    """Return numerators A_k + B_k y of the resonances 1/(y^2 - 2 Re(q_k) y + |q_k|^2).

    Parameters
    ----------
    poles : (k,) ndarray of complex
    coefficients : (..., channels, 2k) ndarray of float, first the a_k, then the b_k

    Returns
    -------
    (..., k, 2 channels) ndarray of float, first the A_k of every channel, then the B_k
    """
    k, size = poles.size, np.abs(poles)
    both = np.concatenate([coefficients[..., :k] * size**2, coefficients[..., k:] * size], axis=-2)
    return np.ascontiguousarray(np.swapaxes(both, -1, -2))


def evaluate(
    y: ComplexArray, poles: ComplexArray, weights: FloatArray, single: bool = False
) -> ComplexArray:
    """Return the values of the sums for many grounds.

    Parameters
    ----------
    y : (m, n) ndarray of complex, one row per ground
    poles : (k,) ndarray of complex
    weights : (k, 2 channels) ndarray of float, or (m, k, 2 channels), see :func:`numerators`
    single : bool
        Single precision inside: twice as fast, relative error about 1e-5 of the largest value.

    Returns
    -------
    (m, channels, n) ndarray of complex
    """
    kind: type[np.floating[Any]] = np.float32 if single else np.float64
    weights = weights.astype(kind, copy=False)
    channels = weights.shape[-1] // 2
    result = np.empty((y.shape[0], channels, y.shape[1]), dtype=np.complex128)
    for rows, u, v, _ in _chunks(y, poles, kind):
        chunk_weights = weights[rows] if weights.ndim == 3 else weights
        sums = (u @ chunk_weights) - 1j * (v @ chunk_weights)
        values = sums[..., :channels] + y[rows, :, None] * sums[..., channels:]
        result[rows] = np.swapaxes(values, 1, 2)
    return result


def evaluate_with_slope(
    y: ComplexArray,
    poles: ComplexArray,
    weights: FloatArray,
    extra_weights: FloatArray | None = None,
) -> tuple[ComplexArray, ComplexArray, ComplexArray | None]:
    r"""Return the sums, their derivatives by y, and the sums for other numerators.

    With the resonances :math:`r_k = 1/(y^2 + d_k y + s_k)` and the numerators A + B y

    .. math:: f' = \sum_k B_k r_k - \sum_k r_k^2 (2 y + d_k) (A_k + B_k y)

    Parameters
    ----------
    y, poles, weights : as for :func:`evaluate`
    extra_weights : ndarray of float, numerators of the same shape, for values without derivatives

    Returns
    -------
    values, slopes : (m, channels, n) ndarray of complex
    extra_values : the same, or None without `extra_weights`
    """
    squared = np.concatenate([weights, (-2.0 * poles.real)[:, None] * weights], axis=-1)
    first = weights if extra_weights is None else np.concatenate([weights, extra_weights], axis=-1)
    c = weights.shape[-1] // 2
    shape = (y.shape[0], c, y.shape[1])
    values, slopes = np.empty(shape, dtype=np.complex128), np.empty(shape, dtype=np.complex128)
    extra_values = None if extra_weights is None else np.empty(shape, dtype=np.complex128)
    for rows, u, v, spare in _chunks(y, poles, np.float64):
        at = y[rows, :, None]
        numerators_of_rows = first[rows] if first.ndim == 3 else first
        once = (u @ numerators_of_rows) - 1j * (v @ numerators_of_rows)
        values[rows] = np.swapaxes(once[..., :c] + at * once[..., c : 2 * c], 1, 2)
        if extra_values is not None:
            more = once[..., 2 * c : 3 * c] + at * once[..., 3 * c :]
            extra_values[rows] = np.swapaxes(more, 1, 2)
        # The squares of the resonances: (u - iv)^2 = u^2 - v^2 - 2iuv.
        np.multiply(u, v, out=spare)
        u *= u
        v *= v
        u -= v
        numerators_of_rows = squared[rows] if squared.ndim == 3 else squared
        twice = (u @ numerators_of_rows) - 2j * (spare @ numerators_of_rows)
        plain = twice[..., :c] + at * twice[..., c : 2 * c]
        with_damping = twice[..., 2 * c : 3 * c] + at * twice[..., 3 * c :]
        slopes[rows] = np.swapaxes(once[..., c : 2 * c] - 2.0 * at * plain - with_damping, 1, 2)
    return values, slopes, extra_values


def _chunks(
    y: ComplexArray, poles: ComplexArray, kind: type[np.floating[Any]]
) -> Iterator[tuple[slice, FloatArray, FloatArray, FloatArray]]:
    """Yield rows that fit the cache, their resonances u - iv (rows, n, k), and a buffer like them.

    The buffers are reused for the next rows.
    """
    count, width = y.shape
    damping = (-2.0 * poles.real).astype(kind)
    square = (np.abs(poles) ** 2).astype(kind)
    real, imaginary = y.real.astype(kind), y.imag.astype(kind)
    square_real = (real - imaginary) * (real + imaginary)
    square_imaginary = 2.0 * real * imaginary
    chunk = min(count, max(1, _CHUNK_ELEMENTS // max(1, width * poles.size)))
    buffers = [np.empty((chunk, width, poles.size), dtype=kind) for _ in range(3)]
    for first in range(0, count, chunk):
        rows = slice(first, min(first + chunk, count))
        chunk_buffers = [buffer[: rows.stop - first] for buffer in buffers]
        _resonances(
            real[rows], imaginary[rows], square_real[rows], square_imaginary[rows],
            damping, square, chunk_buffers,
        )  # fmt: skip
        yield rows, chunk_buffers[0], chunk_buffers[1], chunk_buffers[2]


def _resonances(
    real: FloatArray,
    imaginary: FloatArray,
    square_real: FloatArray,
    square_imaginary: FloatArray,
    damping: FloatArray,
    square: FloatArray,
    buffers: list[FloatArray],
) -> None:
    """Write real part and minus imaginary part of 1/(y^2 + damping y + square), (m, n, k)."""
    u, v, norm = buffers
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
