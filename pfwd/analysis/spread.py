"""How well a fit knows what it found, for the digits that are shown."""

import math

from pfwd.analysis.results import DropResult


def relative_spread(result: DropResult) -> float:
    """Least relative spread of what a fit found, as its modulus and its residual have it.

    Standard deviations of viscosity, density and depth come from the noise alone; the interval of
    the modulus holds the model's own error too, and a residual that is left moves everything.

    Parameters
    ----------
    result : DropResult

    Returns
    -------
    float
        0 where nothing is known of it.
    """
    spread = 0.0
    if result.modulus_pa and result.modulus_interval_pa is not None:
        low, high = result.modulus_interval_pa
        spread = (high - low) / 2 / result.modulus_pa
    if result.explained is False:
        spread = max(spread, result.contact_residual_rms_over_peak or 0.0)
    return spread if math.isfinite(spread) else 0.0
