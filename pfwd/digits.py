"""Texts of numbers, with the number of digits that their uncertainty supports."""

from __future__ import annotations

import math

_LARGE = 3
"""First digit of a spread from which the spread has one digit in texts; a smaller one has two."""

MAX_DIGITS = 4
"""Largest number of digits of a value, however small its interval: no load cell is more accurate.
"""

DEFAULT_DIGITS = 3
"""Number of digits of a value whose uncertainty is not known."""

MISSING = "-"
"""Text of a missing value."""


def rounded(value: float, spread: float) -> str:
    """Return a number as text with the digits that its spread supports.

    Parameters
    ----------
    value : float
    spread : float
        Half the width of an interval, or a standard deviation, in the unit of the value.

    Examples
    --------
    >>> rounded(45.4137, 8.1), rounded(1.15301, 0.04), rounded(2313.0, 950.0)
    ('45', '1.15', '2300')
    """
    if not math.isfinite(spread) or spread <= 0.0 or not math.isfinite(value):
        return f"{value:.4g}"
    return at_place(value, _place(spread))


def at_place(value: float, place: int) -> str:
    """Return a number as text, rounded to a power of ten.

    Parameters
    ----------
    value : float
    place : int
        Exponent of the last digit: 1 for tens, -1 for tenths.

    Examples
    --------
    >>> at_place(1234.5, 1), at_place(1234.5, -1), at_place(-0.3, 0)
    ('1230', '1234.5', '0')
    """
    return f"{round(value, -place):z.{max(0, -place)}f}"


def with_ends(value: float, ends: tuple[float, float]) -> tuple[str, str, str]:
    """Return a value and the ends of its interval as texts, with the digits that the interval
    supports.

    The distance to the nearer end determines the digits of the value, because a distant end says
    little: 29 with an interval to 561 is written with an end of 560. All three have at least two
    digits; with one, 88 and 92 would both be 90.

    Parameters
    ----------
    value : float
        Finite.
    ends : pair of float
        Finite, the lower end first.

    Returns
    -------
    tuple of str
        Value, lower and upper end.

    Examples
    --------
    >>> with_ends(29.1, (11.2, 561.1))
    ('29', '11', '560')
    >>> with_ends(1.1695, (1.0483, 18.0))
    ('1.17', '1.05', '18')
    >>> with_ends(35.123, (34.2, 35.9))
    ('35.1', '34.2', '35.9')
    >>> with_ends(47.9, (13.7, 686.0))
    ('48', '14', '690')
    """
    far = [abs(value - end) for end in ends]
    # A value at a bound of the search is an end of its interval; this distance of 0 is not used.
    used = [distance for distance in far if distance > 0.01 * abs(value)] or far
    digits = MAX_DIGITS if any(far) else DEFAULT_DIGITS
    place = max(_place(min(used)), _top(value) - digits + 1)
    low, high = (
        at_place(end, min(max(place, _top(distance) - 1), _top(end) - 1)) if end else "0"
        for end, distance in zip(ends, far, strict=True)
    )
    return at_place(value, min(place, _top(value) - 1)), low, high


def significant(value: float | None, digits: int = DEFAULT_DIGITS) -> str:
    """Return a number as text with a number of significant digits, but all digits before the point.

    Examples
    --------
    >>> significant(0.012345), significant(45.678), significant(1234.5), significant(9.996)
    ('0.0123', '45.7', '1234', '10.0')
    >>> significant(None), significant(math.nan)
    ('-', '-')
    """
    if value is None or not math.isfinite(value):
        return MISSING
    top = _top(float(f"{value:.{digits - 1}e}"))
    return f"{value:.{min(6, max(0, digits - 1 - top)) if value else 0}f}"


def declared(value: float | None, unit: str = "") -> str:
    """Return a declared number as text, as it was given.

    Examples
    --------
    >>> declared(0.15, "m"), declared(0.3048), declared(1800.0), declared(None, "m")
    ('0.15 m', '0.3048', '1800', '-')
    """
    return MISSING if value is None else f"{value:.6g} {unit}".rstrip()


def _place(spread: float) -> int:
    """Return the exponent of the last digit that a spread supports."""
    if spread <= 0.0:
        return -6
    exponent = _top(spread)
    return exponent if spread >= _LARGE * 10.0**exponent else exponent - 1


def _top(value: float) -> int:
    """Return the exponent of the first digit of a number."""
    return math.floor(math.log10(abs(value))) if value else -6
