r"""Statistics of the points of a survey as one lot.

Points of one lot are taken for samples of one population, normally distributed. With n values, mean
m and standard deviation s:

- characteristic value, 5 % fractile with unknown variation (EN 1990:2002, D7.2, table D1):
  :math:`m - t_{0.95,\,n-1} \sqrt{1 + 1/n} \, s`; for a deflection, which should be small, the upper
  one;
- limits of a control chart of single values (ISO 7870-2): :math:`m \pm 3 \, \bar R / 1.128` with
  the mean difference R of neighbours;
- outliers by the modified z-score (Iglewicz and Hoaglin, How to Detect and Handle Outliers, 1993):
  :math:`0.6745 \, |x - \tilde x| / MAD > 3.5`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

MIN_POINTS_OF_LOT = 3
"""Points of a lot; a fractile of fewer is a factor of seven off the mean or more."""

MIN_POINTS_FOR_OUTLIERS = 5
"""Points of a lot with outliers; of fewer points one in four is distant by chance."""

MIN_OUTLIER_SCORE = 3.5
"""Modified z-score from which the source calls a value an outlier."""

_MAD_OF_NORMAL = 0.6745
"""Median absolute deviation of a normal distribution, in standard deviations."""

_RANGE_OF_TWO = 1.128
"""Mean range of two normal values, in standard deviations (d2 of ISO 7870)."""


@dataclass(frozen=True, slots=True)
class Lot:
    """Statistics of values in one unit."""

    values: tuple[float, ...]
    mean: float
    deviation: float
    """Standard deviation, n - 1."""
    characteristic: float
    """5 % fractile; the 95 % one where small values are good."""
    mean_interval: tuple[float, float]
    """95 %, of the mean."""
    limits: tuple[float, float]
    """Limits of the control chart."""
    outliers: tuple[int, ...]
    """Places of the outliers among the values."""

    @property
    def noticeable(self) -> tuple[int, ...]:
        """Places of outliers and of values beyond the limits."""
        low, high = self.limits
        beyond = [i for i, value in enumerate(self.values) if not low <= value <= high]
        return tuple(sorted({*self.outliers, *beyond}))

    @property
    def variation(self) -> float:
        """Coefficient of variation."""
        return self.deviation / self.mean if self.mean else math.nan


def lot_of(values: Sequence[float], *, small_is_good: bool = False) -> Lot | None:
    """Return the statistics of values; None for fewer than three values.

    Parameters
    ----------
    values : sequence of float
        In the order in which they were measured.
    small_is_good : bool
        True for a deflection.
    """
    n = len(values)
    if n < MIN_POINTS_OF_LOT:
        return None
    array = np.asarray(values, np.float64)
    mean, deviation = float(array.mean()), float(array.std(ddof=1))
    reach = float(stdtrit(n - 1, 0.95)) * math.sqrt(1 + 1 / n) * deviation
    half = float(stdtrit(n - 1, 0.975)) * deviation / math.sqrt(n)
    swing = 3 * float(np.abs(np.diff(array)).mean()) / _RANGE_OF_TWO
    return Lot(
        tuple(map(float, array)),
        mean,
        deviation,
        mean + reach if small_is_good else mean - reach,
        (mean - half, mean + half),
        (max(0.0, mean - swing), mean + swing),
        _outliers(array),
    )


def _outliers(values: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> tuple[int, ...]:
    if values.size < MIN_POINTS_FOR_OUTLIERS:
        return ()
    distances = np.abs(values - np.median(values))
    spread = float(np.median(distances))
    if spread == 0.0:
        return ()
    return tuple(
        int(i) for i in np.flatnonzero(_MAD_OF_NORMAL * distances / spread > MIN_OUTLIER_SCORE)
    )


@dataclass(frozen=True, slots=True)
class Line:
    """A straight line through pairs, by least squares."""

    slope: float
    intercept: float
    r_squared: float
    pairs: int


def line_through(xs: Sequence[float], ys: Sequence[float]) -> Line | None:
    """Return the line of pairs by least squares; None for fewer than three pairs or equal x."""
    if len(xs) < MIN_POINTS_OF_LOT or max(xs) == min(xs):
        return None
    x, y = np.asarray(xs, np.float64), np.asarray(ys, np.float64)
    slope, intercept = (float(value) for value in np.polyfit(x, y, 1))
    total = float(((y - y.mean()) ** 2).sum())
    residual = float(((y - intercept - slope * x) ** 2).sum())
    return Line(slope, intercept, 1 - residual / total if total > 0 else 1.0, len(xs))
