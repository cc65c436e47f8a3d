r"""The published method, equation by equation, as a reference for comparison.

Subgrade of one Kelvin-Voigt layer over a rigid base, or of infinite depth, under the half-sine
pressure of a static rigid plate; double transform (Hankel, Laplace), 20-node Gauss segments,
Durbin's inversion. Source of every equation number in this module: "Back-calculation of subgrade
modulus considering shallow bedrock and viscoelasticity based on multi population genetic
algorithm", doi 10.11835/j.issn.2096-6717.2022.021. Its misprints are put right here;
``docs/errata.md`` lists each with its proof.

Four things differ from the printed page in form, none in value:

- Eq. 13 grows like :math:`e^{(\alpha+\delta) h_0}` and overflows. Numerators and denominator are
  multiplied by :math:`e^{-(\alpha+\delta) h_0}`; every exponential left is at most one.
- The nested root of Eq. 11 simplifies to :math:`\xi^2 + \rho s^2 / G` and
  :math:`\xi^2 + \rho s^2 / (\lambda + 2G)`. Evaluated as printed it loses twice the digits.
- Eq. 15 is summed by the fast Fourier transform, which gives the same numbers.
- The paper gives no layerless form; :func:`surface_compliance` without a depth is Eq. 10 and 12
  with the decaying terms alone.

What the paper does not state (upper limit of Eq. 14, number of segments and of frequencies) is a
parameter here. With the defaults the trace of the centre differs from that of much finer sums by
less than 0.2 % of its peak, for bedrock deeper than two plate radii, damped or not. Two errors are
part of the method: the slow tail of the integrand is cut off, and the equations cancel for very
slow loads (relative rounding about :math:`10^{-16} \xi^2 |G / (\rho s^2)|`).
"""

from __future__ import annotations

import math

import numpy as np

from inversion.arrays import ComplexArray, FloatArray

GAUSS_NODES = 20  # Eq. 14: "the 20 node Gauss interpolation formula"
DEFAULT_SEGMENTS = 40  # 800 nodes in all
DEFAULT_FREQUENCIES = 128
DEFAULT_TOTAL_TIME = 0.08  # s; twice the usual record, whose second half is not used
DEFAULT_A_T = 6.0  # a T, the paper's range is 5 to 10

# x_s a = 9.5 pi. The paper gives no x_s. At the centre the tail that is cut off, that of sin(x)/x,
# is smallest at odd multiples of pi/2 (1/x^2 instead of 1/x: 7e-4 of the static deflection). Up to
# this limit 800 nodes are dense enough for the resonances of undamped soil too.
DEFAULT_UPPER_LIMIT = 9.5 * math.pi


def lame_parameters(
    modulus: ComplexArray, poisson_ratio: float
) -> tuple[ComplexArray, ComplexArray]:
    r"""Return Lame's parameters of a solid of complex modulus and real, constant Poisson's ratio.

    .. math:: \lambda = \frac{\nu E(s)}{(1+\nu)(1-2\nu)}, \qquad G = \frac{E(s)}{2(1+\nu)}

    given after Eq. 7 and 8 (there with :math:`1+2\nu` and :math:`2E`).

    Parameters
    ----------
    modulus : (...,) ndarray of complex, Pa
        :math:`E(s) = E + \eta s`, Eq. 1.
    poisson_ratio : float, 0 <= value < 0.5
        nu, real and constant.

    Returns
    -------
    lame, shear : (...,) ndarray of complex, Pa
    """
    lame = poisson_ratio * modulus / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))
    shear = modulus / (2 * (1 + poisson_ratio))
    return lame, shear


def half_sine_transform(
    s: ComplexArray, peak_pressure: float, pulse_duration: float
) -> ComplexArray:
    r"""Return the Laplace transform of the half-sine pulse, first factor of Eq. 3.

    .. math:: \bar p(s) = p_{max} \frac{\pi T_0 (1 + e^{-s T_0})}{s^2 T_0^2 + \pi^2}

    Parameters
    ----------
    s : (...,) ndarray of complex, 1/s, real part > 0
        Laplace's variable.
    peak_pressure : float, Pa
        :math:`p_{max} = F_{max} / (\pi a^2)`, mean over the plate.
    pulse_duration : float, s
        :math:`T_0`.

    Returns
    -------
    (...,) ndarray of complex, Pa s
    """
    rise = math.pi * pulse_duration * (1 + np.exp(-s * pulse_duration))
    transform: ComplexArray = peak_pressure * rise / (s**2 * pulse_duration**2 + math.pi**2)
    return transform


def plate_transform(xi: FloatArray, plate_radius: float) -> FloatArray:
    r"""Return the Hankel transform of the static rigid plate's pressure, second factor of Eq. 3.

    .. math:: \int_0^a \frac{r J_0(\xi r) \, dr}{2 \sqrt{1 - r^2/a^2}}
         = \frac{a \sin(\xi a)}{2 \xi}

    Eq. 2 with m = 1/2 and unit mean pressure: half the mean at the centre, infinite at the edge.

    Parameters
    ----------
    xi : (...,) ndarray of float, 1/m, > 0
        Hankel's wavenumber.
    plate_radius : float, m
        a.

    Returns
    -------
    (...,) ndarray of float, m2
    """
    transform: FloatArray = plate_radius * np.sin(xi * plate_radius) / (2 * xi)
    return transform


def surface_compliance(
    xi: FloatArray,
    s: ComplexArray,
    lame: ComplexArray,
    shear: ComplexArray,
    density: float,
    bedrock_depth: float | None,
) -> ComplexArray:
    r"""Transformed surface displacement for unit transformed pressure, Eq. 10 to 13 at z = 0.

    .. math:: \tilde w(\xi, 0, s) / \tilde p = k_1 (A - B) + k_2 (C - D)

    with A to D of Eq. 13 for unit pressure, each of its exponentials multiplied by
    :math:`e^{-(\alpha+\delta) h_0}`, and

    .. math::
        \Delta = (e^{(\alpha+\delta)h_0} + e^{-(\alpha+\delta)h_0})(k_1-k_2)(k_3 k_6-k_4 k_5)
               + (e^{(\alpha-\delta)h_0} + e^{-(\alpha-\delta)h_0})(k_1+k_2)(k_3 k_6+k_4 k_5)
               - 4 (k_1 k_4 k_6 + k_2 k_3 k_5)

    In the half-space A = C = 0, and Eq. 12 with :math:`\sigma_z = -p, \tau = 0` leaves
    :math:`(k_1 k_6 - k_2 k_5) / (k_3 k_6 - k_4 k_5)`.

    Parameters
    ----------
    xi : (...,) ndarray of float, 1/m, > 0
        Hankel's wavenumber.
    s : (...,) ndarray of complex, 1/s, not 0
        At s = 0 the two roots coincide and the equations become 0/0.
    lame, shear : (...,) ndarray of complex, Pa
        At each `s`. All arrays are broadcast against each other.
    density : float, kg/m3
        rho.
    bedrock_depth : float, m, or None
        None is the half-space.

    Returns
    -------
    (...,) ndarray of complex, m/Pa
        Downward positive.
    """
    inertia = density * s**2
    stiffness = lame + 2 * shear
    # Eq. 11. As in the paper for real s, alpha is the shear and delta the pressure wave.
    alpha = np.sqrt(xi**2 + inertia / shear)
    delta = np.sqrt(xi**2 + inertia / stiffness)
    # After Eq. 8 and Eq. 10.
    m1 = (stiffness * xi**2 + inertia) / shear
    m2 = xi * (lame + shear) / shear
    k1 = (alpha**2 - m1) / (m2 * alpha)
    k2 = (delta**2 - m1) / (m2 * delta)
    # Eq. 12, which the paper leaves to the reader.
    k3 = stiffness * k1 * alpha + lame * xi
    k4 = stiffness * k2 * delta + lame * xi
    k5 = shear * (alpha - xi * k1)
    k6 = shear * (delta - xi * k2)

    compliance: ComplexArray
    if bedrock_depth is None:
        compliance = (k1 * k6 - k2 * k5) / (k3 * k6 - k4 * k5)
        return compliance

    # e^(-alpha h0) and e^(-delta h0): the products below are Eq. 13 times e^(-(alpha+delta) h0).
    ea = np.exp(-alpha * bedrock_depth)
    ed = np.exp(-delta * bedrock_depth)
    both, plus, minus = ea * ed, k1 + k2, k1 - k2
    denominator = (
        (1 + both**2) * minus * (k3 * k6 - k4 * k5)
        + (ed**2 + ea**2) * plus * (k3 * k6 + k4 * k5)
        - 4 * both * (k1 * k4 * k6 + k2 * k3 * k5)
    )
    a = -(ea**2 * k6 * plus + both**2 * k6 * minus - 2 * both * k2 * k5)
    b = -(k6 * minus + ed**2 * k6 * plus - 2 * both * k2 * k5)
    c = -(ed**2 * k5 * plus - both**2 * k5 * minus - 2 * both * k1 * k6)
    d = -(-k5 * minus + ea**2 * k5 * plus - 2 * both * k1 * k6)
    compliance = (k1 * (a - b) + k2 * (c - d)) / denominator
    return compliance


def gauss_segments(segments: int, upper_limit: float) -> tuple[FloatArray, FloatArray]:
    r"""Nodes and weights of Eq. 14: 20 Gauss nodes in each of N equal segments of [0, x_s].

    .. math:: x_{ij} = (i-1) \Delta L + x_j, \quad j = 1 \ldots 20, \quad \Delta L = x_s / N

    with nodes :math:`x_j` and weights :math:`A_j` scaled from [-1, 1] to :math:`[0, \Delta L]`.

    Parameters
    ----------
    segments : int, > 0
        N of Eq. 14.
    upper_limit : float, > 0
        :math:`x_s`; the nodes have its unit.

    Returns
    -------
    nodes, weights : (20 * segments,) ndarray of float
    """
    length = upper_limit / segments
    nodes, weights = np.polynomial.legendre.leggauss(GAUSS_NODES)
    within = (nodes + 1) * (length / 2)
    starts = np.arange(segments) * length
    return (starts[:, None] + within).ravel(), np.tile(weights * (length / 2), segments)


def invert_laplace(transform: ComplexArray, total_time: float, a_t: float) -> FloatArray:
    r"""Function of time from its Laplace transform by Durbin's method, Eq. 15.

    .. math::
        w(t_j) = \frac{2 e^{a t_j}}{T} \mathrm{Re} \Bigl[ -\tfrac12 \bar w(a)
                 + \sum_{k=0}^{N-1} A_k e^{2 \pi i j k / N} \Bigr], \qquad
        A_k = \sum_{m=0}^{L} \bar w \bigl( a + 2 \pi i (k + m N) / T \bigr)

    The result repeats with the period T: what it contains beside :math:`w(t)` is
    :math:`e^{-aT} w(t+T) + e^{-2aT} w(t+2T) + \ldots`. Frequencies left out weigh more and more
    with :math:`e^{at}`, so that the last quarter of the window is not to be used.

    Parameters
    ----------
    transform : (L + 1, N) ndarray of complex
        :math:`\bar w` at the points of the second equation, m along the first axis.
    total_time : float, s
        T.
    a_t : float
        a T, 5 to 10 in the paper.

    Returns
    -------
    (N,) ndarray of float
        At :math:`t_j = j T / N`.
    """
    steps = transform.shape[1]
    growth = np.exp(a_t * np.arange(steps) / steps)
    series = steps * np.fft.ifft(transform.sum(axis=0))
    values: FloatArray = 2 * growth / total_time * (series - transform[0, 0] / 2).real
    return values


def published_transfer(
    s: ComplexArray,
    modulus: float,
    viscosity: float,
    density: float,
    poisson_ratio: float,
    plate_radius: float,
    bedrock_depth: float | None = None,
    *,
    segments: int = DEFAULT_SEGMENTS,
    upper_limit: float | None = None,
) -> ComplexArray:
    r"""Transfer function from mean pressure to the displacement of the plate's centre, Eq. 14.

    .. math::
        \frac{\bar w(0, 0, s)}{\bar p(s)} = \int_0^{x_s} \xi \, \tilde w(\xi, 0, s)
        \, d\xi \Big/ \bar p(s)

    Parameters
    ----------
    s : (...,) ndarray of complex, 1/s, not 0
        Laplace's variable.
    modulus : float, Pa
        E, the static Young's modulus.
    viscosity : float, Pa s
        eta, of Young's modulus: E(s) = E + eta s, Eq. 1.
    density : float, kg/m3
        rho.
    poisson_ratio : float, 0 <= value < 0.5
        nu, real and constant.
    plate_radius : float, m
        a.
    bedrock_depth : float, m, or None
        None is the half-space.
    segments : int
        Of 20 nodes each.
    upper_limit : float, 1/m, or None
        :math:`x_s`; None is :math:`9.5 \pi / a`.

    Returns
    -------
    (...,) ndarray of complex, m/Pa
    """
    if upper_limit is None:
        upper_limit = DEFAULT_UPPER_LIMIT / plate_radius
    xi, weights = gauss_segments(segments, upper_limit)
    s = np.asarray(s, dtype=np.complex128)[..., None]
    lame, shear = lame_parameters(modulus + viscosity * s, poisson_ratio)
    compliance = surface_compliance(xi, s, lame, shear, density, bedrock_depth)
    plate = plate_transform(xi, plate_radius)
    transfer: ComplexArray = compliance @ (weights * xi * plate)
    return transfer


def published_displacement(
    modulus: float,
    viscosity: float,
    density: float,
    poisson_ratio: float,
    plate_radius: float,
    peak_pressure: float,
    pulse_duration: float,
    bedrock_depth: float | None = None,
    *,
    total_time: float = DEFAULT_TOTAL_TIME,
    frequencies: int = DEFAULT_FREQUENCIES,
    a_t: float = DEFAULT_A_T,
    segments: int = DEFAULT_SEGMENTS,
    upper_limit: float | None = None,
) -> tuple[FloatArray, FloatArray]:
    r"""Time and displacement of the ground surface under a half-sine drop, Eq. 1 to 15.

    The load is the contact force, its pressure that of a static rigid plate, the displacement that
    of the plate's centre. The plate's inertia and its
    dynamic contact are not in the model; its high-frequency stiffness is therefore twice too large.

    Parameters
    ----------
    modulus : float, Pa
        E, the static Young's modulus.
    viscosity : float, Pa s
        eta, of Young's modulus: E(s) = E + eta s, Eq. 1.
    density : float, kg/m3
        rho.
    poisson_ratio : float, 0 <= value < 0.5
        nu, real and constant.
    plate_radius : float, m
        a.
    peak_pressure : float, Pa
        :math:`p_{max} = F_{max} / (\pi a^2)`, mean over the plate.
    pulse_duration : float, s
        :math:`T_0`; the pulse begins at time 0.
    bedrock_depth : float, m, or None
        :math:`h_0`; None is the half-space.
    total_time : float, s
        T, the period of Eq. 15; the last quarter of it is not to be used.
    frequencies : int
        N, points of the Laplace transform and time steps. The paper's range is 50 to 5000.
    a_t : float
        a T.
    segments : int
        Of 20 nodes each.
    upper_limit : float, 1/m, or None
        :math:`x_s`; None is :math:`9.5 \pi / a`.

    Returns
    -------
    time : (frequencies,) ndarray of float, s
    displacement : (frequencies,) ndarray of float, m
        Downward positive.
    """
    points = np.arange(frequencies, dtype=np.float64)
    s: ComplexArray = ((a_t + 2j * math.pi * points) / total_time)[None].astype(np.complex128)
    transfer = published_transfer(
        s,
        modulus,
        viscosity,
        density,
        poisson_ratio,
        plate_radius,
        bedrock_depth,
        segments=segments,
        upper_limit=upper_limit,
    )
    pulse = half_sine_transform(s, peak_pressure, pulse_duration)
    time: FloatArray = np.arange(frequencies, dtype=np.float64) * total_time / frequencies
    return time, invert_laplace(transfer * pulse, total_time, a_t)
