"""Names of test points that are typed on the screen."""

from collections.abc import Collection

from pfwd.errors import OptionError
from pfwd.judging.stations import similar_name
from pfwd.session.plan import SessionPlan


def point_name_error(name: str) -> str:
    """Why no point can have this name; empty: it can."""
    try:
        SessionPlan(point=name)
    except OptionError:
        return "1 to 64 characters"
    return ""


def point_name_question(name: str, known: Collection[str]) -> str:
    """Return what has to be asked before a point of this name begins; empty: nothing.

    Parameters
    ----------
    name : str
        As it was typed.
    known : collection of str
        Names of points and stations.
    """
    similar = similar_name(name, known)
    return "" if similar is None else f"{name.strip()} is new, but {similar} exists. Begin it?"
