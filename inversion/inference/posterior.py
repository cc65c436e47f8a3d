r"""Posterior of a point's unknowns: optimum, Laplace's approximation, size of the discrepancy.

With residual r, its covariance C and priors :math:`x_k \sim N(m_k, s_k^2)` the optimum minimises

.. math:: r^T C^{-1} r + \sum_k (x_k - m_k)^2 / s_k^2

by Levenberg and Marquardt's method. The discrepancy (model error beyond noise) in C maximises the
marginal likelihood, with the unknowns integrated out about the optimum. Laplace's evidence is

.. math:: \ln p(y) = -\tfrac12 (r^T C^{-1} r + \ln|C| + \sum_k (x_k - m_k)^2 / s_k^2 +
          \sum_k \ln s_k^2 + \ln|H|), \qquad H = J^T C^{-1} J + S^{-1}

MacKay (1992), Neural Computation 4, 415.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from inversion.arrays import FloatArray
from inversion.inference.discrepancy import (
    Discrepancy,
    RecordedDrops,
    cholesky,
    log_determinant,
    recorded_drops,
    whitened,
)
from inversion.inference.levenberg_marquardt import BOUND_TOLERANCE, minimise
from inversion.inference.point_model import PointModel
from inversion.measured.weighted_drop import MODEL_FLOOR_FRACTION

# In a first fit all samples have nearly the same weight, with a short correlation time. With the
# final correlation time, fits would end with residuals of 10 to 20 % during the contact.
_ALMOST_WHITE = Discrepancy(scale=0.03, memory=3e-4)
_FAIRLY_WHITE = replace(_ALMOST_WHITE, scale=0.01)
# Effects whose unknowns are fixed at first: far from the optimum they would absorb other causes.
_FIXED_AT_FIRST = frozenset({"sensor_lag", "plate_inertia"})
_THINNING = 3
# Values that are tried for each parameter of the discrepancy (correlation times in s).
_SCALE_FACTORS = (0.3, 0.5, 0.7, 1.0 / 0.7, 2.0)
_FINE_SCALE_FACTORS, _LARGE_STEP = (0.85, 1.0 / 0.85), 0.5
_MEMORIES_S = (5e-4, 1e-3, 2e-3, 4e-3)
_CORRELATIONS = (0.0, 0.3, 0.6, 0.85, 0.95)
_FIRST_FACTORS = (1.0, 1.5, 2.5, 4.0)
_DRIFTS = (0.001, 0.003, 0.01, 0.02)
_AFTER_CONTACT_FACTORS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
_TAIL_FACTORS = _AFTER_CONTACT_FACTORS[0], _AFTER_CONTACT_FACTORS[-1]
# Large drifts are tried with several sensors only: with a single one, drift could absorb the motion
# of the ground after the contact.
_DRIFTS_OF_SEVERAL = (*_DRIFTS, 0.05, 0.1)
_MAX_ROUNDS = 6
# Error of the base model under the plate, over the peak. For 100 finite-element drops its root mean
# square is at most 0.05 %, and its largest value 0.2 %.
_PLATE_FLOOR_FRACTION = 0.0015
# Half of the 95 % quantile of chi-square with one degree of freedom: the decrease of the log
# likelihood at the ends of an interval. Factor and largest number of the steps towards the ends.
_HALF_CHI_SQUARE_95 = 1.92
_SCALE_STEP, _MAX_SCALE_STEPS = 1.1, 40
_TYPICAL_SCALE, _TYPICAL_DRIFT = 5e-3, 1e-2
_TYPICAL_MEMORY_S, _MEMORY_DEVIATION = 4e-3, 0.5
_TYPICAL_FIRST, _FIRST_DEVIATION = 2.0, 0.7
# Relative decreases of the cost at which fits stop.
_TOLERANCE, _FINE_TOLERANCE = 1e-3, 1e-5

_Linearised = tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]
"""Predictions and derivatives of each fitted drop."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """Optimum of a fit of a point, with the covariance of its unknowns.

    Parameters
    ----------
    model : PointModel
    values : (k,) ndarray of float, of the unknowns
    discrepancy : Discrepancy
    log_evidence : float
    cost : float, :math:`r^T C^{-1} r` plus the squared distances from the priors
    covariance : (k, k) ndarray of float
    predictions : tuple of (n_sensors, n) ndarray of float, m, of the fitted drops
    slopes : tuple of (k, n_sensors, n) ndarray of float, their derivatives
    """

    model: PointModel
    values: FloatArray
    discrepancy: Discrepancy
    log_evidence: float
    cost: float
    covariance: FloatArray
    predictions: tuple[FloatArray, ...] = field(repr=False)
    slopes: tuple[FloatArray, ...] = field(repr=False)

    @property
    def by_key(self) -> dict[tuple[str, str, int | None], float]:
        """Values of the unknowns by their keys."""
        return dict(zip(self.model.keys, self.values.tolist(), strict=True))

    def occam_factor(self, effects: Collection[str]) -> float:
        """Return an upper bound of the evidence gained by removing all other effects.

        It is the logarithm of the largest density of their posterior over that of their prior.
        """
        places = [
            place
            for place, unknown in enumerate(self.model.unknowns)
            if unknown.effect and unknown.effect not in effects
        ]
        covariance = self.covariance[np.ix_(places, places)]
        prior = float(np.log(self.model.deviation[places]).sum())
        return prior - 0.5 * float(np.linalg.slogdet(covariance)[1])

    def drifts(self) -> tuple[FloatArray, ...]:
        """Return the posterior mean of the drift of each fitted drop, (n_sensors, n), m."""
        return recorded_drops(self.model).drifts(self.discrepancy, self.predictions)

    @cached_property
    def recorded(self) -> tuple[FloatArray, ...]:
        """Predictions plus the drift of each drop, (n_sensors, n), m."""
        pairs = zip(self.predictions, self.drifts(), strict=True)
        return tuple(prediction + drift for prediction, drift in pairs)

    def residual_over_peak(self, *, contact_only: bool = False) -> float:
        """Return the root mean square over the fitted drops of `residuals_over_peak`."""
        residuals = self.residuals_over_peak(contact_only=contact_only)
        return math.hypot(*residuals) / math.sqrt(len(residuals))

    def residuals_over_peak(self, *, contact_only: bool = False) -> tuple[float, ...]:
        """Return the root mean square residual of each fitted drop over the peak.

        Prediction and drift are subtracted from the record.
        """
        return tuple(
            self.model.point.drops[drop].residual_over_peak(recorded, contact_only=contact_only)
            for drop, recorded in zip(self.model.drops, self.recorded, strict=True)
        )


class PointFit:
    """Fit of a point in progress, with its present values and discrepancy.

    Parameters
    ----------
    model : PointModel
    values : (k,) ndarray of float, starting point; None: the start of the model
    is_contact_first : bool, True: the discrepancy after the contact has a factor of its own
    solves : int, number of predictions so far, those of derivatives included
    """

    def __init__(
        self,
        model: PointModel,
        values: FloatArray | None = None,
        *,
        is_contact_first: bool = False,
    ) -> None:
        self.model = model
        self.solves = 0
        self.has_converged = False
        self._is_contact_first = is_contact_first
        start = model.start if values is None else values
        self.values: FloatArray = np.clip(start, model.lower, model.upper)
        self.discrepancy = _ALMOST_WHITE
        self._recorded = recorded_drops(model)
        self._thinned = recorded_drops(model, _THINNING)
        self._linearised: tuple[FloatArray, frozenset[str], _Linearised] | None = None

    def run(self) -> Posterior:
        """Return the posterior of a full fit.

        The first steps have nearly equal weights of all samples, the others those of the
        discrepancy.
        """
        self.maximise(24, _FINE_TOLERANCE, _FIXED_AT_FIRST)
        self.discrepancy = _FAIRLY_WHITE
        self.maximise(12, _FINE_TOLERANCE, _FIXED_AT_FIRST)
        self._estimate_first(_FIXED_AT_FIRST)
        return self.run_to_optimum()

    def run_from_contact(
        self, held: Collection[str], discrepancy: Discrepancy | None = None
    ) -> Posterior:
        """Return the posterior of a short fit that starts near an optimum of the contact.

        Parameters
        ----------
        held : names of effects whose unknowns are fixed at first
        discrepancy : Discrepancy of a similar fit; None: not available
        """
        if discrepancy is None:
            self.discrepancy = replace(_FAIRLY_WHITE, after_contact=_AFTER_CONTACT_FACTORS[-1])
            self._estimate_first(_FIXED_AT_FIRST | frozenset(held))
            self.maximise(8, _TOLERANCE)
        else:
            self.discrepancy = discrepancy
            self._estimate_first(())
        return self.posterior()

    def run_to_optimum(self) -> Posterior:
        """Return the posterior of the fit, with the weights of the estimated discrepancy."""
        for _ in range(2):
            self.maximise(8, _TOLERANCE)
            self.estimate_discrepancy(self.posterior())
        self.maximise(24, _FINE_TOLERANCE)
        return self.posterior()

    def _estimate_first(self, held: Collection[str]) -> None:
        self.maximise(8, _TOLERANCE, held)
        self.estimate_discrepancy(self.posterior())

    def run_briefly(self, iterations: int) -> Posterior:
        """Return the posterior of a short fit, which is sufficient for ranking candidate models."""
        self.maximise(2 * iterations, _TOLERANCE, _FIXED_AT_FIRST)
        self.estimate_discrepancy(self.posterior())
        self.maximise(iterations, _TOLERANCE)
        return self.posterior()

    def run_nearby(self, iterations: int, discrepancy: Discrepancy | None = None) -> Posterior:
        """Return the posterior of a fit that starts near its optimum.

        Parameters
        ----------
        iterations : int, largest number with each discrepancy
        discrepancy : Discrepancy of a similar fit; None: not available
        """
        self.discrepancy = discrepancy or _FAIRLY_WHITE
        for _ in range(1 if discrepancy else 2):
            self.maximise(iterations, _TOLERANCE)
            self.estimate_discrepancy(self.posterior())
        self.maximise(iterations, _TOLERANCE)
        return self.posterior()

    def maximise(self, iterations: int, tolerance: float, held: Collection[str] = ()) -> None:
        """Move the values to the optimum for the present discrepancy.

        Parameters
        ----------
        iterations : int, largest number
        tolerance : float, relative change of the cost at which to stop
        held : names of effects whose unknowns are fixed
        """
        movable = np.array([unknown.effect not in held for unknown in self.model.unknowns])
        objective = _PointObjective(self, self._recorded.whiteners(self.discrepancy), held)
        optimum = minimise(objective, self.values[None], iterations, tolerance, movable)
        self.values = optimum.points[0]
        self.has_converged = bool(optimum.has_converged[0])

    def cost(
        self, values: FloatArray, whiteners: list[FloatArray], predictions: Sequence[FloatArray]
    ) -> float:
        """Return twice the negative logarithm of the posterior density, without constants."""
        if not all(np.all(np.isfinite(prediction)) for prediction in predictions):
            return math.inf
        away = (values - self.model.mean) / self.model.deviation
        total = float(away @ away)
        for sensor, lower in enumerate(whiteners):
            residual = self._recorded.observed[sensor] - self._recorded.over_peak(
                predictions, sensor
            )
            weighted = whitened(lower, residual[None])[0]
            total += float(weighted @ weighted)
        return total

    def linearise(self, held: Collection[str] = ()) -> _Linearised:
        """Return predictions and derivatives at the present values.

        They are cached, because several fits start there.
        """
        cached = self._linearised
        if (
            cached is None
            or not np.array_equal(cached[0], self.values)
            or not cached[1] <= frozenset(held)
        ):
            self.solves += len(self.model.drops) * (1 + self.values.size)
            pairs = [self.model.linearise(self.values, d, held) for d in self.model.drops]
            predictions, slopes = zip(*pairs, strict=True)
            self._linearised = cached = self.values, frozenset(held), (predictions, slopes)
        return cached[2]

    def normal(
        self, whiteners: list[FloatArray], held: Collection[str] = ()
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return J^T C^-1 J, J^T C^-1 r and r^T C^-1 r, as in the docstring of the module."""
        predictions, slopes = self.linearise(held)
        size = self.values.size
        normal, gradient, misfit = np.zeros((size, size)), np.zeros(size), 0.0
        for sensor, lower in enumerate(whiteners):
            residual = self._recorded.observed[sensor] - self._recorded.over_peak(
                predictions, sensor
            )
            rows = np.vstack([residual[None], self._recorded.over_peak(slopes, sensor)])
            weighted = whitened(lower, rows)
            normal += weighted[1:] @ weighted[1:].T
            gradient += weighted[1:] @ weighted[0]
            misfit += float(weighted[0] @ weighted[0])
        return normal, gradient, misfit

    def posterior(self) -> Posterior:
        """Return the posterior by Laplace's approximation at the present values."""
        model = self.model
        whiteners = self._recorded.whiteners(self.discrepancy)
        normal, gradient, misfit = self.normal(whiteners)
        hessian, _ = _curvature(model, self.values, normal, gradient)
        away = (self.values - model.mean) / model.deviation
        cost = misfit + float(away @ away)
        log_evidence = (
            -0.5 * cost
            - sum(map(log_determinant, whiteners))
            - float(np.log(model.deviation).sum())
            - 0.5 * float(np.linalg.slogdet(hessian)[1])
            + _log_prior(self.discrepancy)
        )
        return Posterior(
            model,
            self.values.copy(),
            self.discrepancy,
            log_evidence,
            cost,
            np.linalg.inv(hessian),
            *self.linearise(),
        )

    def expected_cost(self, held: Collection[str] = ()) -> float:
        """Return the cost at the optimum of the linearised model, see `Posterior.cost`.

        Parameters
        ----------
        held : names of effects whose unknowns are fixed
        """
        model = self.model
        normal, gradient, misfit = self.normal(self._recorded.whiteners(self.discrepancy), held)
        away = (self.values - model.mean) / model.deviation
        hessian, slope = _curvature(model, self.values, normal, gradient)
        return misfit + float(away @ away) - float(slope @ np.linalg.solve(hessian, slope))

    def estimate_discrepancy(self, posterior: Posterior) -> None:
        """Set the discrepancy to the one with the largest marginal likelihood about a posterior."""
        marginal = _Marginal(self._thinned, posterior)
        several = len(self.model.drops) > 1
        drifts = _DRIFTS_OF_SEVERAL if self._recorded.sensors > 1 else _DRIFTS
        min_scale = _min_scale(self.model, is_base=self._is_contact_first)
        best = replace(self.discrepancy, scale=max(self.discrepancy.scale, min_scale))
        best_likelihood = marginal(best)
        factors: tuple[float, ...] = _SCALE_FACTORS
        for round_ in range(_MAX_ROUNDS):
            before = best
            scales = [max(best.scale * factor, min_scale) for factor in factors]
            candidates: list[dict[str, float]] = [
                *({"scale": scale} for scale in scales),
                *({"memory": memory} for memory in _MEMORIES_S),
                *({"between_drops": rho} for rho in _CORRELATIONS if several),
            ]
            if round_:
                # Not in the first round, in which drift would absorb the correlated discrepancy.
                candidates += [{"first": factor} for factor in _FIRST_FACTORS if several]
                candidates += [{"drift": drift} for drift in drifts]
            if self._is_contact_first:
                candidates += [{"after_contact": factor} for factor in _AFTER_CONTACT_FACTORS]
                tail = best.scale * best.after_contact
                candidates += [
                    {"scale": scale, "after_contact": float(np.clip(tail / scale, *_TAIL_FACTORS))}
                    for scale in scales
                ]
            for candidate in candidates:
                trial = replace(best, **candidate)
                if trial in (before, best):
                    continue
                likelihood = marginal(trial)
                if likelihood > best_likelihood:
                    best, best_likelihood = trial, likelihood
            if round_ and best == before:
                break
            if abs(math.log(best.scale / before.scale)) < _LARGE_STEP:
                factors = _FINE_SCALE_FACTORS
        self.discrepancy = best

    def scale_interval(self, posterior: Posterior) -> tuple[float, float]:
        """Return the 95 % interval of the discrepancy's scale about a posterior, over the peak."""
        marginal = _Marginal(self._thinned, posterior)
        best = posterior.discrepancy
        min_likelihood = marginal(best) - _HALF_CHI_SQUARE_95
        ends = []
        for factor in (1.0 / _SCALE_STEP, _SCALE_STEP):
            scale = best.scale
            for _ in range(_MAX_SCALE_STEPS):
                if marginal(replace(best, scale=scale * factor)) < min_likelihood:
                    break
                scale *= factor
            ends.append(scale)
        return ends[0], ends[1]


class _PointObjective:
    """Cost of a fit for one discrepancy; effects in ``held`` do not move.

    Parameters
    ----------
    fit : PointFit
    whiteners : list of (n, n) ndarray of float, of each sensor
    held : names of effects
    """

    def __init__(self, fit: PointFit, whiteners: list[FloatArray], held: Collection[str]) -> None:
        self._fit, self._whiteners, self._held = fit, whiteners, held
        self.lower, self.upper = fit.model.lower, fit.model.upper
        self.deviation = fit.model.deviation

    def costs(self, points: FloatArray) -> FloatArray:
        """Return the cost at one point, (1,)."""
        fit, values = self._fit, points[0]
        if np.array_equal(values, fit.values):
            predictions: Sequence[FloatArray] = fit.linearise(self._held)[0]
        else:
            fit.solves += len(fit.model.drops)
            predictions = [fit.model.predict(values, drop) for drop in fit.model.drops]
        return np.array([fit.cost(values, self._whiteners, predictions)])

    def normals(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the normal matrix and the descent at one point, which becomes that of the fit."""
        fit = self._fit
        fit.values = points[0].copy()
        normal, descent, _ = fit.normal(self._whiteners, self._held)
        precision = 1.0 / self.deviation**2
        normal += np.diag(precision)
        descent -= precision * (fit.values - fit.model.mean)
        return normal[None], descent[None]


def _curvature(
    model: PointModel, values: FloatArray, normal: FloatArray, gradient: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the negative second derivative of the log posterior, and the first derivative.

    An unknown on a bound, towards which the first derivative g points, does not move. Its posterior
    decreases inward as exp(-g x); an additional curvature of g squared decreases about as fast.

    Parameters
    ----------
    model : PointModel
    values : (k,) ndarray of float
    normal, gradient : (k, k) and (k,) ndarray of float, of the records without the priors
    """
    precision = 1.0 / model.deviation**2
    slope = gradient - precision * (values - model.mean)
    on_lower = (values <= model.lower + BOUND_TOLERANCE) & (slope < 0.0)
    on_upper = (values >= model.upper - BOUND_TOLERANCE) & (slope > 0.0)
    hessian = normal.copy()
    hessian.flat[:: values.size + 1] += precision + np.where(on_lower | on_upper, slope**2, 0.0)
    return hessian, slope


def _min_scale(model: PointModel, *, is_base: bool) -> float:
    """Return the smallest scale of the discrepancy: the error of the model, over the peak.

    It is declared with the record, or a fraction that comparisons with finite elements gave: of the
    base model under the plate, or of sensors on the ground and models with effects.
    """
    drop = model.point.drops[model.last]
    floor = drop.record.model_floor
    if floor is not None:
        return floor / float(drop.peak[0])
    under_plate = bool((drop.context.offsets < drop.context.plate_radius).all())
    return _PLATE_FLOOR_FRACTION if is_base and under_plate else MODEL_FLOOR_FRACTION


class _Marginal:
    """Log marginal likelihood of a discrepancy, with the unknowns integrated out."""

    def __init__(self, recorded: RecordedDrops, posterior: Posterior) -> None:
        self._recorded = recorded
        self._posterior = posterior
        self._rows = []
        for sensor in range(recorded.sensors):
            residual = recorded.observed[sensor] - recorded.over_peak(posterior.predictions, sensor)
            slopes = recorded.over_peak(posterior.slopes, sensor)
            self._rows.append(np.vstack([residual[None], slopes]))
        self._likelihoods: dict[Discrepancy, float] = {}

    def __call__(self, discrepancy: Discrepancy) -> float:
        value = self._likelihoods.get(discrepancy)
        if value is None:
            value = self._likelihoods[discrepancy] = self._evaluate(discrepancy)
        return value

    def _evaluate(self, discrepancy: Discrepancy) -> float:
        size = 1 + self._posterior.values.size
        # Products of residual and slopes: misfit, gradient and normal matrix.
        products = np.zeros((size, size))
        total = _log_prior(discrepancy)
        try:
            whiteners = self._recorded.whiteners(discrepancy)
        except np.linalg.LinAlgError:
            return -math.inf
        for rows, lower in zip(self._rows, whiteners, strict=True):
            weighted = whitened(lower, rows)
            products += weighted @ weighted.T
            total -= log_determinant(lower)
        hessian, slope = _curvature(
            self._posterior.model, self._posterior.values, products[1:, 1:], products[1:, 0]
        )
        factor = cholesky(hessian)
        gain = whitened(factor, slope[None])[0]
        return total + 0.5 * float(gain @ gain - products[0, 0]) - log_determinant(factor)


def _log_prior(discrepancy: Discrepancy) -> float:
    """Return the logarithm of the prior density of a discrepancy, without constants."""
    memory = math.log(discrepancy.memory / _TYPICAL_MEMORY_S) / _MEMORY_DEVIATION
    first = math.log(discrepancy.first / _TYPICAL_FIRST) / _FIRST_DEVIATION
    return (
        -math.log1p((discrepancy.scale / _TYPICAL_SCALE) ** 2)
        - math.log1p((discrepancy.drift / _TYPICAL_DRIFT) ** 2)
        - 0.5 * memory**2
        - 0.5 * first**2
    )
