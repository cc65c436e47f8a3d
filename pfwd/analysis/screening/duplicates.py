"""Drops of a point that are copies of an earlier one."""

from collections.abc import Sequence

from pfwd.analysis.screening.drops import Screening
from pfwd_device import Drop


def duplicate_drops(drops: Sequence[Drop], screenings: Sequence[Screening]) -> dict[int, str]:
    """Return the measured drops that have the samples of an earlier one, with the reason.

    A copy is no second measurement: counted as one, it would make intervals narrower.

    Parameters
    ----------
    drops : sequence of Drop
    screenings : sequence of Screening
        One a drop.

    Returns
    -------
    dict of int to str
        By index of the drop.
    """
    reasons: dict[int, str] = {}
    originals: list[Drop] = []
    for index, (drop, screening) in enumerate(zip(drops, screenings, strict=True)):
        if screening.status != "measured":
            continue
        original = next((earlier for earlier in originals if earlier.has_samples_of(drop)), None)
        if original is None:
            originals.append(drop)
        else:
            reasons[index] = f"its samples are those of drop {original.number}, number for number"
    return reasons
