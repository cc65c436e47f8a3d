"""Names of test points: what comes after 7, or after km 3+250."""

import re
from collections.abc import Collection

from pfwd_survey.errors import OptionError
from pfwd_survey.judging.stations import next_along
from pfwd_survey.measuring.plan import SessionPlan


def next_name(name: str, known: Collection[str] = (), step_m: float | None = None) -> str:
    """The name with its last number one higher, as often as it is known already.

    A name with a chainage goes on by the step between stations, where one is said.

    Examples
    --------
    >>> next_name("7"), next_name("lane 2, point 09"), next_name("start"), next_name("7", {"8"})
    ('8', 'lane 2, point 10', 'start 2', '9')
    >>> next_name("12+320", {"12+340"}, 20.0)
    '12+360'
    """
    further = None if step_m is None else next_along(name, step_m)
    if further is not None:
        return next_name(further, known, step_m) if further in known else further
    found = re.search(r"(\d+)(\D*)$", name)
    if found is None:
        proposal = f"{name} 2".strip()
    else:
        digits = found[1]
        number = str(int(digits) + 1).zfill(len(digits))
        proposal = name[: found.start()] + number + found[2]
    return next_name(proposal, known) if proposal in known else proposal


def point_name_error(name: str) -> str:
    """Why no point can have this name; empty: it can."""
    try:
        SessionPlan(point=name)
    except OptionError:
        return "1 to 64 characters"
    return ""
