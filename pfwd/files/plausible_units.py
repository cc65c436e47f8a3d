"""Refusal of drops whose numbers no deflectometer produces, because a unit is wrong.

Trace files name the units of their columns; there such numbers are a warning. Arrays and columns of
other programs' texts have only the unit that the caller states.
"""

import math
from collections.abc import Sequence

import numpy as np

from pfwd.errors import TraceError, refusal
from pfwd.files.header import PointSetup
from pfwd_device import Drop
from pfwd_device.signals import displacement_of, remove_offset

PULSE_EDGE = 0.1
"""Fraction of the peak load at which the pulse begins and ends."""

SUSPECT_LOAD = 500e3
"""Peak load, N, above which the unit is suspect: the heaviest falling weights reach some 300 kN."""

SUSPECT_DEFLECTION = 0.02
"""Deflection, m, above which the unit is suspect, or the plate has punched into the ground."""

LIMITS = (
    ("a load pulse", "ms", 1e3, 5e-5, 1.0),
    ("a peak load", "kN", 1e-3, 0.0, SUSPECT_LOAD),
    ("a peak deflection", "mm", 1e3, 0.0, SUSPECT_DEFLECTION),
    ("a peak load over peak deflection", "MN/m", 1e-6, 1e5, 5e9),
)
"""Quantity, unit of the message with its factor from SI, and least and largest value in SI.

Weights on springs load the ground for 10 to 60 ms. Under light devices
very soft ground has 0.3 MN/m, under heavy ones a pavement of concrete has 2 GN/m. A single spike of
a record is shorter than the least duration only above 30 kHz.
"""


def refuse_wrong_units(drops: Sequence[Drop], setup: PointSetup, where: str, hint: str) -> None:
    """Raise TraceError if the numbers of every drop are outside of `LIMITS`.

    A wrong unit affects every drop; a single drop outside of the limits has another fault. Drops
    on a rig of springs, without a pulse or without samples are not compared.

    Parameters
    ----------
    drops : sequence of Drop
    setup : PointSetup
    where : str
        File or argument, for the message.
    hint : str
        Question about the units, for the message.
    """
    measured = [] if setup.is_stiffness_test else [_sizes(drop) for drop in drops]
    faults = [_fault(sizes) for sizes in measured if sizes is not None]
    if faults and None not in faults:
        expected, got = faults[0] or ("", "")
        raise TraceError(refusal(where, expected, got, hint))


def _sizes(drop: Drop) -> tuple[float, float, float, float] | None:
    """Return duration (s), peak load (N), peak deflection (m) and stiffness (N/m) of a drop.

    The deflection is that of the sensor nearest to the centre, to the end of the pulse.
    """
    if drop.only_peaks is not None or not drop.channels:
        return None
    load = remove_offset(drop.time, drop.load)
    top = int(np.argmax(load))
    peak = float(load[top])
    low = load < PULSE_EDGE * peak
    after = np.flatnonzero(low[top:])
    if not peak > 0.0 or not after.size:
        return None
    before = np.flatnonzero(low[:top])
    start, end = int(before[-1]) + 1 if before.size else 0, top + int(after[0])
    duration = math.pi / 2 * float(load[start:end].sum()) / drop.sampling_rate / peak
    centre = min(drop.channels, key=lambda channel: abs(channel.offset))
    moved = float(np.abs(displacement_of(centre, drop.time)[:end]).max())
    return duration, peak, moved, peak / moved if moved > 0.0 else math.nan


def _fault(sizes: tuple[float, float, float, float]) -> tuple[str, str] | None:
    """Return expected and actual value of the first size outside of its limits; None: no such."""
    for size, (name, unit, factor, least, largest) in zip(sizes, LIMITS, strict=True):
        if not size < least and not size > largest:
            continue
        interval = f"{least * factor:g} to {largest * factor:g}" if least else ""
        expected = interval or f"at most {largest * factor:g}"
        return f"{name} of {expected} {unit}", f"{size * factor:.3g} {unit}"
    return None
