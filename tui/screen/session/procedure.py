"""How a point is judged while it is measured: by a procedure, or by three drops and three."""

import dataclasses
from collections.abc import Iterable

from pfwd_survey.inverting.drop_facts import with_modulus
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.procedures import (
    Kind,
    Number,
    PointDrop,
    PointProgress,
    Procedure,
    judge,
)

SEATING, MEASURED = 3, 3
"""The usual procedure of portable deflectometers: three drops seat the plate, three count."""

PLAIN = "plain"
"""Name of the procedure that nobody chose."""

_CHOSEN = "chosen for this survey, after no document"


def plain_procedure(seating: int = SEATING, measured: int = MEASURED) -> Procedure:
    """So many seating drops, so many measured ones, their mean modulus against a target."""
    return Procedure(
        name=PLAIN,
        title="seating drops, then measured drops",
        source=_CHOSEN,
        seating=Number(seating, _CHOSEN, verified=True),
        measured=Number(measured, _CHOSEN, verified=True),
        average="modulus",
    )


def with_result(
    facts: PointDrop, status: str, discarded: bool, result: DropResult | None
) -> PointDrop:
    """What a procedure has to know of a drop, with its newest modulus."""
    kind = Kind(status)
    if discarded and kind is not Kind.REJECTED:
        kind = Kind.DISCARDED
    facts = dataclasses.replace(facts, kind=kind)
    return facts if result is None else with_modulus(facts, result)


def progress_of(
    procedure: Procedure,
    drops: Iterable[PointDrop],
    plate_radius: float,
    poisson_ratio: float | None,
    target: float | None,
) -> PointProgress:
    """What the procedure says of the drops so far."""
    return judge(
        procedure,
        list(drops),
        plate_radius=plate_radius,
        poisson_ratio=poisson_ratio,
        target=target,
    )
