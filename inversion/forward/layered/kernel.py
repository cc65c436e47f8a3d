r"""Surface compliances of horizontal layers in the Hankel-Laplace domain, and their derivatives.

Lengths are over the plate radius, stresses in Pa, so a compliance is in 1/Pa.  In each medium

.. math:: z = \rho a^2 s^2 / G, \quad c = \frac{1 - 2\nu}{2 (1 - \nu)}, \quad
          \alpha^2 = \xi^2 + c z, \quad \beta^2 = \xi^2 + z

with G the complex shear modulus.  The state at a depth is the displacement d = (w, u), downward
and outward, and the traction t = (p, q) on what lies below: pressure and outward shear, of order
0 and 1 in the Hankel domain.  The compliance of the ground below any plane is a symmetric 2 x 2
matrix F, d = F t; this module computes that of the surface.

**Waves as tractions.**  A wave that goes down in a medium carries d = H t with H the compliance of
a half-space of that medium, one that goes up d = -K t, where K is H with the opposite sign of the
coupling.  H, and the matrix that takes the traction of a downward wave over the thickness h,

.. math:: M = e^{-\alpha h} 1 - X \, n m^T, \quad n = (2 \xi \beta, b), \quad
          m = (2 \xi \alpha, -b), \quad b = z + 2 \xi^2, \quad
          X = \frac{e^{-\beta h} - e^{-\alpha h}}{z R}

stay finite where z vanishes, although P and S waves coincide there: only X is a divided difference.
Therefore no digit is lost at low frequencies and high wavenumbers, and s = 0 is allowed.

**From the bottom up.**  With D = (H + K)/2 = diag(alpha, beta)/(G R), which is diagonal, and the
compliance F' of the ground below the layer, continuity at its lower face and the waves in between
give, all matrices symmetric,

.. math:: P' = F' + K, \quad W = 2D P'^{-1} 2D - 2D, \quad Q = 2D + M^T W M, \quad
          F = 2D Q^{-1} 2D - K

F' = 0 is a rigid base, F' = H a half-space of the same medium: then W = 0 and F = H.  Every
exponential is at most one.  This is the reflection recursion of Kennett (1974, Bull. Seism. Soc.
Am. 64, 1685-1696) in the tractions instead of the amplitudes of P and S waves. It gives the result
of the stiffness matrices of Kausel and Roesset (1981, Bull. Seism. Soc. Am. 71, 1743-1761) without
their loss of digits in thin layers and for static loads.

**Derivatives.**  A change dF' below changes F by :math:`L \, dF' L^T` with
:math:`L^T = P'^{-1} 2D M Q^{-1} 2D`, which is the traction at the lower face for one at the upper.
A change of one medium therefore acts on the surface through the tractions of the load there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import ComplexArray, FloatArray

# abs((beta - alpha) h) below which the divided differences are computed from their series. Above it
# the difference itself retains eleven digits of X and eight of its derivative.
_SERIES_BELOW = 1e-4


class Symmetric(NamedTuple):
    """Symmetric 2 x 2 matrices, each entry (...) complex: ww, wu, uu."""

    ww: ComplexArray
    wu: ComplexArray
    uu: ComplexArray


class Media(NamedTuple):
    """Properties of N media for k points, each array (N, k, 1).

    ``shear``: complex shear modulus, Pa; ``z``: rho a^2 s^2 / G; ``ratio``: c, the S over the P
    velocity squared; ``thickness``: over the plate radius, unused for a half-space.
    """

    shear: ComplexArray
    z: ComplexArray
    ratio: FloatArray
    thickness: FloatArray

    def rows(self, part: slice) -> Media:
        """Return the media at some of the points."""
        return Media(
            self.shear[:, part], self.z[:, part], self.ratio[:, part], self.thickness[:, part]
        )


class _Waves(NamedTuple):
    """Vertical wavenumbers and half-space of one medium at the nodes that its waves reach."""

    alpha: ComplexArray
    beta: ComplexArray
    share: ComplexArray  # beta / (alpha + beta)
    inverse: ComplexArray  # 1 / R
    half_space: Symmetric


class _Passage(NamedTuple):
    """One layer between its faces at the nodes whose waves reach the lower face."""

    fall: ComplexArray  # exp(-alpha h)
    x: ComplexArray
    w: Symmetric
    p_inverse: Symmetric  # P'^-1
    q_inverse: Symmetric  # Q^-1
    below: Symmetric | None  # F', None over a rigid base


@dataclass(frozen=True)
class Solution:
    """Compliance of the surface, and the terms of every medium for its derivatives."""

    surface: Symmetric
    waves: tuple[_Waves, ...]
    passages: tuple[_Passage | None, ...]


def solve_layers(xi: FloatArray, media: Media, rock: bool, negligible: float = 38.0) -> Solution:
    """Return the surface compliance of layers over a half-space or, with ``rock``, a rigid base.

    Parameters
    ----------
    xi : (n,) ndarray of float, wavenumber times plate radius, > 0, ascending
    media : Media of N media at k points, from the surface down
    rock : bool, True: a rigid base under the last medium, which otherwise is a half-space
    negligible : float, attenuation of a wave down and back, nepers, from which it is neglected
    """
    waves, lower_node_counts = _waves_that_reach(xi, media, rock, negligible)
    passages: list[_Passage | None] = []
    below: Symmetric | None = None
    for j in range(len(waves) - 1, -1, -1):
        medium_waves, count = waves[j], lower_node_counts[j]
        surface, passage = medium_waves.half_space, None
        if count:
            layer_waves = _first_nodes(medium_waves, count)
            z, c, h = media.z[j], media.ratio[j], media.thickness[j]
            passage = _pass(xi[:count], layer_waves, z, c, h, below)
            surface = _surface(layer_waves.half_space, passage, medium_waves.half_space, count)
        passages.append(passage)
        below = surface
    return Solution(surface, tuple(waves), tuple(passages[::-1]))


def _waves_that_reach(
    xi: FloatArray, media: Media, rock: bool, negligible: float
) -> tuple[list[_Waves], list[int]]:
    """Return the media that waves reach, and the number of nodes that reach each lower face.

    A wave reaches a medium if its amplitude down and back exceeds ``exp(-negligible)``.  The
    criterion is the real parts of alpha and beta, not xi: below xi = sqrt(abs(z)) waves travel.
    """
    waves: list[_Waves] = []
    lower_node_counts: list[int] = []
    decay: FloatArray | None = None
    last = media.z.shape[0] - 1
    count = xi.size
    for j in range(last + 1):
        c, h = media.ratio[j], media.thickness[j]
        medium_waves = _waves(xi[:count], media.shear[j], media.z[j], c)
        waves.append(medium_waves)
        if j == last and not rock:
            lower_node_counts.append(0)
            break
        slower = np.minimum(medium_waves.alpha.real, medium_waves.beta.real) * h
        decay = slower if decay is None else decay[:, :count] + slower
        reached = np.flatnonzero(np.min(decay, axis=0) < 0.5 * negligible)
        count = int(reached[-1]) + 1 if reached.size else 0
        lower_node_counts.append(count)
        if not count:
            break
    return waves, lower_node_counts


def _waves(xi: FloatArray, shear: ComplexArray, z: ComplexArray, c: FloatArray) -> _Waves:
    square = xi * xi
    alpha = np.sqrt(square + c * z)
    beta = np.sqrt(square + z)
    share = beta / (alpha + beta)
    twice = (2.0 - 2.0 * c) * share
    inverse = 1.0 / (z + 2.0 * square * twice)
    scaled = inverse / shear
    return _Waves(
        alpha,
        beta,
        share,
        inverse,
        Symmetric(alpha * scaled, xi * (twice - 1.0) * scaled, beta * scaled),
    )


def _first_nodes(waves: _Waves, count: int) -> _Waves:
    """Return the waves at the first ``count`` nodes."""
    if count == waves.alpha.shape[-1]:
        return waves
    return _Waves(
        waves.alpha[:, :count],
        waves.beta[:, :count],
        waves.share[:, :count],
        waves.inverse[:, :count],
        _cut(waves.half_space, count),
    )


def _cut(matrix: Symmetric, count: int) -> Symmetric:
    return Symmetric(*(part[:, :count] for part in matrix))


def _divided_difference(
    waves: _Waves, z: ComplexArray, c: FloatArray, h: FloatArray, fall: ComplexArray
) -> ComplexArray:
    r"""Return :math:`(e^{-\beta h} - e^{-\alpha h}) / z`, also at z = 0."""
    # x = (beta - alpha) h, and the difference is -(1 - c) h/(alpha + beta) e^(-alpha h) E(x),
    # E(x) = (1 - e^-x)/x.
    plain = np.exp(-h * waves.beta) - fall
    rows = _rows_with_small_x(waves, z, c, h)
    if not rows.size:
        result: ComplexArray = plain / z
        return result
    result = plain / np.where(z == 0.0, 1.0, z)
    front = (c[rows] - 1.0) * h[rows] / (waves.alpha[rows] + waves.beta[rows])
    x = -front * z[rows]
    series = front * fall[rows] * (1.0 - x * (0.5 - x * (1.0 / 6.0 - x / 24.0)))
    result[rows] = np.where(np.abs(x) < _SERIES_BELOW, series, result[rows])
    return result


def _rows_with_small_x(
    waves: _Waves, z: ComplexArray, c: FloatArray, h: FloatArray
) -> NDArray[np.intp]:
    """Return the points at which abs((beta - alpha) h) is small at the last node."""
    sums = np.abs(waves.alpha[:, -1] + waves.beta[:, -1])
    small = np.abs(z[:, 0]) * (1.0 - c[:, 0]) * h[:, 0] < _SERIES_BELOW * sums
    return np.flatnonzero(small)


def _pass(
    xi: FloatArray,
    waves: _Waves,
    z: ComplexArray,
    c: FloatArray,
    h: FloatArray,
    below: Symmetric | None,
) -> _Passage:
    fall = np.exp(-h * waves.alpha)
    x = _divided_difference(waves, z, c, h, fall) * waves.inverse
    half_space = waves.half_space
    if below is None:
        p = Symmetric(half_space.ww, -half_space.wu, half_space.uu)
    else:
        below = _cut(below, xi.size)
        p = Symmetric(below.ww + half_space.ww, below.wu - half_space.wu, below.uu + half_space.uu)
    p_inverse = _inverse(p)
    # W = 2D P'^-1 2D - 2D
    double_w, double_u = 2.0 * half_space.ww, 2.0 * half_space.uu
    w = Symmetric(
        (double_w * p_inverse.ww - 1.0) * double_w,
        double_w * double_u * p_inverse.wu,
        (double_u * p_inverse.uu - 1.0) * double_u,
    )
    # V = M^T W M with M = fall 1 - x n m^T
    twice = 2.0 * xi
    m_u = z + twice * xi
    n_w, m_w = twice * waves.beta, twice * waves.alpha
    wn_w = w.ww * n_w + w.wu * m_u
    wn_u = w.wu * n_w + w.uu * m_u
    square, cross = fall * fall, fall * x
    rank = x * x * (wn_w * n_w + wn_u * m_u)
    # m = (m_w, -m_u)
    v_ww = square * w.ww + m_w * (rank * m_w - 2.0 * cross * wn_w)
    v_wu = square * w.wu + cross * (wn_w * m_u - wn_u * m_w) - rank * m_w * m_u
    v_uu = square * w.uu + m_u * (rank * m_u + 2.0 * cross * wn_u)
    q_inverse = _inverse(Symmetric(double_w + v_ww, v_wu, double_u + v_uu))
    return _Passage(fall, x, w, p_inverse, q_inverse, below)


def _surface(
    layer_half_space: Symmetric, passage: _Passage, half_space: Symmetric, count: int
) -> Symmetric:
    """Return 2D Q^-1 2D - K at the first ``count`` nodes, and H at the others."""
    q = passage.q_inverse
    solved = Symmetric(
        (4.0 * layer_half_space.ww * q.ww - 1.0) * layer_half_space.ww,
        4.0 * layer_half_space.ww * layer_half_space.uu * q.wu + layer_half_space.wu,
        (4.0 * layer_half_space.uu * q.uu - 1.0) * layer_half_space.uu,
    )
    if count == half_space.ww.shape[-1]:
        return solved
    result = Symmetric(half_space.ww.copy(), half_space.wu.copy(), half_space.uu.copy())
    for target, values in zip(result, solved, strict=True):
        target[:, :count] = values
    return result


def _inverse(matrix: Symmetric) -> Symmetric:
    over = 1.0 / (matrix.ww * matrix.uu - matrix.wu * matrix.wu)
    return Symmetric(matrix.uu * over, -matrix.wu * over, matrix.ww * over)


class Slopes(NamedTuple):
    """Derivatives of the surface compliance with respect to the properties of one medium.

    With respect to the shear modulus at constant z, to z, to c, and to the thickness over the
    radius; each is (1, k, n) complex with those of F_ww or (3, k, n) with F_ww, F_uu and F_wu.
    ``ratio`` is None unless requested, ``thickness`` is None for a half-space.
    """

    shear: ComplexArray
    z: ComplexArray
    ratio: ComplexArray | None
    thickness: ComplexArray | None


# Pressure and shear under several surface loads, (loads, k, n) complex.
_Traction = tuple[Any, Any]


class _Tangent(NamedTuple):
    """Derivatives of one medium's waves with respect to z or to c."""

    half_space: Symmetric
    alpha: ComplexArray
    beta: Any  # 0 by c
    stress: float  # of b
    rayleigh: ComplexArray  # of the logarithm of R


def compliance_slopes(
    xi: FloatArray,
    media: Media,
    solution: Solution,
    shear: bool,
    ratio: bool = True,
    single: bool = False,
) -> list[Slopes]:
    """Return the derivatives of the surface compliance by every medium's properties.

    Each medium has values at the first nodes, those that its waves reach; media that no wave
    reaches are omitted.

    Parameters
    ----------
    xi, media : as for :func:`solve_layers`
    solution : Solution
    shear : bool, True: the derivatives of F_uu and F_wu too
    ratio : bool, True: the derivatives with respect to c (Poisson's ratio) too
    single : bool, True: single precision, with a relative error of some 1e-5

    Returns
    -------
    list of Slopes, from the surface down
    """
    # t F t under pressure, under shear and under both: F_ww, F_uu, and their sum plus twice F_wu.
    loads = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 1.0]] if shear else [[1.0], [0.0]])
    loads = loads.astype(np.float32) if single else loads
    top: _Traction = loads[0, :, None, None], loads[1, :, None, None]
    result = []
    for j, (waves, passage) in enumerate(zip(solution.waves, solution.passages, strict=True)):
        layer = Media(*(part[j] for part in media))
        size = waves.alpha.shape[-1]
        nodes = xi[:size]
        if j:
            top = top[0][..., :size], top[1][..., :size]
        tangents = _tangents(nodes, waves, layer.z, layer.ratio, ratio)
        n_layer_nodes = 0 if passage is None else passage.fall.shape[-1]
        layer_tangents = tuple(_tangent_part(tangent, n_layer_nodes) for tangent in tangents)
        x_slopes: list[ComplexArray] = []
        if passage is not None:
            # Digits cancel in this step only; the following ones may use single precision.
            x_slopes = _x_slopes(_first_nodes(waves, n_layer_nodes), passage, layer, layer_tangents)
        if single:
            nodes, waves, passage, layer, tangents, layer_tangents, x_slopes = _in_single(
                (nodes, waves, passage, layer, tangents, layer_tangents, x_slopes)
            )
        # At nodes that do not reach the lower face the medium is a half-space.
        slopes = None
        if n_layer_nodes < size:
            slopes = _half_space_slopes(
                waves, layer.shear, tangents, None if j == 0 else top, shear
            )
        if passage is not None:
            first = top if j == 0 else (top[0][..., :n_layer_nodes], top[1][..., :n_layer_nodes])
            layer_slopes, top = _layer_slopes(
                nodes[:n_layer_nodes],
                _first_nodes(waves, n_layer_nodes),
                passage,
                layer,
                layer_tangents,
                x_slopes,
                first,
            )
            slopes = layer_slopes if slopes is None else _joined(layer_slopes, slopes)
        assert slopes is not None
        result.append(slopes)
    return result


def _in_single(value: Any) -> Any:
    """Return a structure of arrays with its arrays in single precision."""
    if isinstance(value, np.ndarray):
        return value.astype(np.complex64 if np.iscomplexobj(value) else np.float32)
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return type(value)(*map(_in_single, value))
    if isinstance(value, tuple | list):
        return type(value)(map(_in_single, value))
    return value


def _separated(forms: ComplexArray) -> ComplexArray:
    """Return F_ww, F_uu, F_wu from the quadratic forms under pressure, shear and both, in place."""
    if forms.shape[0] == 3:
        forms[2] -= forms[0]
        forms[2] -= forms[1]
        forms[2] *= 0.5
    return forms


def _joined(first: Slopes, all_nodes: Slopes) -> Slopes:
    """Return slopes with the values of ``first`` at its nodes, and of ``all_nodes`` beyond."""
    for target, values in zip(all_nodes[:3], first[:3], strict=True):
        if target is not None and values is not None:
            target[..., : values.shape[-1]] = values
    return Slopes(all_nodes.shear, all_nodes.z, all_nodes.ratio, first.thickness)


def _tangent_part(tangent: _Tangent, count: int) -> _Tangent:
    beta = tangent.beta
    return _Tangent(
        _cut(tangent.half_space, count),
        tangent.alpha[:, :count],
        beta if isinstance(beta, float) else beta[:, :count],
        tangent.stress,
        tangent.rayleigh[:, :count],
    )


def _tangents(
    xi: FloatArray, waves: _Waves, z: ComplexArray, c: FloatArray, ratio: bool
) -> tuple[_Tangent, ...]:
    """Return the derivatives of the half-space with respect to z and, by request, to c."""
    square = xi * xi
    half_space = waves.half_space
    scaled = half_space.uu / waves.beta  # 1/(R G)
    wave_sum = waves.alpha + waves.beta
    factor = 2.0 - 2.0 * c
    # beta/(alpha + beta): alpha^2 - c beta^2 = (1 - c) xi^2 and beta^2 - alpha^2 = (1 - c) z
    over = 0.5 / (waves.alpha * wave_sum * wave_sum)
    share_z = (1.0 - c) * square * over / waves.beta
    variables: list[tuple[Any, ...]] = [
        (share_z, 0.5 * c / waves.alpha, 0.5 / waves.beta, 1.0, None)
    ]
    if ratio:
        share_c = -waves.beta * z * over
        variables.append((share_c, 0.5 * z / waves.alpha, 0.0, 0.0, waves.share))
    tangents = []
    for share, alpha, beta, direct, explicit in variables:
        twice = factor * share
        if explicit is not None:
            twice = twice - 2.0 * explicit
        r = (direct + 2.0 * square * twice) * waves.inverse
        half_space_slope = Symmetric(
            alpha * scaled - half_space.ww * r,
            xi * twice * scaled - half_space.wu * r,
            beta * scaled - half_space.uu * r,
        )
        tangents.append(_Tangent(half_space_slope, alpha, beta, direct, r))
    return tuple(tangents)


def _half_space_slopes(
    waves: _Waves,
    shear: ComplexArray,
    tangents: tuple[_Tangent, ...],
    traction: _Traction | None,
    both: bool,
) -> Slopes:
    """Return the derivatives of H itself, or of its form under tractions."""

    def of(matrix: Symmetric) -> ComplexArray:
        if traction is None:
            return np.stack([matrix.ww, matrix.uu, matrix.wu] if both else [matrix.ww])
        p, q = traction
        result: ComplexArray = p * p * matrix.ww + 2.0 * p * q * matrix.wu + q * q * matrix.uu
        return _separated(result)

    ratio = of(tangents[1].half_space) if len(tangents) > 1 else None
    return Slopes(-of(waves.half_space) / shear, of(tangents[0].half_space), ratio, None)


def _layer_slopes(
    xi: FloatArray,
    waves: _Waves,
    passage: _Passage,
    layer: Media,
    tangents: tuple[_Tangent, ...],
    x_slopes: list[ComplexArray],
    traction: _Traction,
) -> tuple[Slopes, _Traction]:
    r"""Return the derivatives by one layer's properties, and tractions at its lower face.

    With y = Q^-1 2D t, v = M y and t' = P'^-1 2D v, the traction at the lower face,

    .. math:: d(t F t) = \sum \dot D \, [\ldots] + 2 \dot H_{wu} (t_p t_q - t'_p t'_q)
              - 2 \, \dot M y \cdot W v

    A thicker layer is one with a sheet of the medium added at its lower face, by the equation of
    motion :math:`dF/dz = A_{11} F + A_{12} - F A_{21} F - F A_{22}` of the compliance. The shear
    modulus at constant z scales everything except the ground below.
    """
    p, q = traction
    shear, z, c, h = layer
    half_space = waves.half_space
    double_w, double_u = 2.0 * half_space.ww, 2.0 * half_space.uu
    y_w, y_u = _apply(passage.q_inverse, double_w * p, double_u * q)
    twice = 2.0 * xi
    b = z + twice * xi
    n_w, m_w = twice * waves.beta, twice * waves.alpha
    my = m_w * y_w - b * y_u
    xmy = passage.x * my
    v_w, v_u = passage.fall * y_w - xmy * n_w, passage.fall * y_u - xmy * b
    wv_w, wv_u = _apply(passage.w, v_w, v_u)
    p_low, q_low = _apply(passage.p_inverse, double_w * v_w, double_u * v_u)
    d_w = double_w * y_w - half_space.ww * p + half_space.wu * q
    d_u = double_u * y_u - half_space.uu * q + half_space.wu * p

    # By z and by c.
    p_square, q_square = p_low * p_low, q_low * q_low
    by_w = 2.0 * ((2.0 * p - y_w) * y_w - (2.0 * p_low - v_w) * v_w) + (p_square - p * p)
    by_u = 2.0 * ((2.0 * q - y_u) * y_u - (2.0 * q_low - v_u) * v_u) + (q_square - q * q)
    by_coupling = 2.0 * (p * q - p_low * q_low)
    nw = n_w * wv_w + b * wv_u
    straight = passage.fall * (y_w * wv_w + y_u * wv_u)
    slopes_by_variable = []
    for tangent, x_slope in zip(tangents, x_slopes, strict=True):
        matrix = tangent.half_space
        dm = twice * tangent.alpha * y_w
        dn = twice * tangent.beta * wv_w
        if tangent.stress:
            dm, dn = dm - y_u, dn + wv_u
        passed = h * tangent.alpha * straight + nw * (x_slope * my + passage.x * dm) + xmy * dn
        slopes_by_variable.append(
            by_w * matrix.ww + by_u * matrix.uu + by_coupling * matrix.wu + 2.0 * passed
        )
    # By the shear modulus and by the thickness.
    by_shear = -(p * d_w + q * d_u)
    softness = 1.0 / shear
    by_thickness = (c * softness) * p_square + softness * q_square
    if passage.below is not None:
        w_low, u_low = _apply(passage.below, p_low, q_low)
        by_shear = by_shear + p_low * w_low + q_low * u_low
        stiff = z + (4.0 - 4.0 * c) * xi * xi
        by_thickness = (
            by_thickness
            + (twice - 2.0 * c * twice) * (p_low * u_low)
            - twice * (q_low * w_low)
            - (shear * z) * (w_low * w_low)
            - (shear * stiff) * (u_low * u_low)
        )
    ratio = slopes_by_variable[1] if len(slopes_by_variable) > 1 else None
    slopes = Slopes(
        _separated(by_shear * softness),
        _separated(slopes_by_variable[0]),
        None if ratio is None else _separated(ratio),
        _separated(by_thickness),
    )
    return slopes, (p_low, q_low)


def _apply(matrix: Symmetric, first: ComplexArray, second: ComplexArray) -> _Traction:
    return matrix.ww * first + matrix.wu * second, matrix.wu * first + matrix.uu * second


def _x_slopes(
    waves: _Waves, passage: _Passage, layer: Media, tangents: tuple[_Tangent, ...]
) -> list[ComplexArray]:
    r"""Return the derivatives of X = difference/R by z and by c, without the pole at z = 0.

    The difference is :math:`f e^{-\alpha h} E(x)`, f = (c - 1) h/(alpha + beta), x = -f z, E(x) =
    (1 - e^-x)/x.
    """
    _, z, c, h = layer
    wave_sum = waves.alpha + waves.beta
    front = (c - 1.0) * h / wave_sum
    x = -front * z
    difference = passage.x / waves.inverse
    # e^(-alpha h) E'(x) = (e^(-beta h) - e^(-alpha h) E)/x
    slow = passage.fall + z * difference - difference / front
    rows = _rows_with_small_x(waves, z, c, h)
    bend = slow / (np.where(x == 0.0, 1.0, x) if rows.size else x)
    if rows.size:
        small_x = x[rows]
        series = passage.fall[rows] * (
            -0.5 + small_x * (1.0 / 3.0 - small_x * (0.125 - small_x / 30.0))
        )
        bend[rows] = np.where(np.abs(small_x) < _SERIES_BELOW, series, bend[rows])
    slopes = []
    # d log f, less d(alpha) h, and f dx
    for tangent, explicit in zip(tangents, (0.0, 1.0 / (c - 1.0)), strict=False):
        change = explicit - (tangent.alpha + tangent.beta) / wave_sum - h * tangent.alpha
        x_change = front * h * (tangent.beta - tangent.alpha) * bend
        slopes.append(
            (difference * change + x_change) * waves.inverse - passage.x * tangent.rayleigh
        )
    return slopes
