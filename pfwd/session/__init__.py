"""Measuring: a session from its feed (instrument, survey, capture) to safe drops and moduli.

`measure` and `replay` are one call for all of it.
"""

from pfwd.session.measure import measure, replay, stopped_by_signals
from pfwd.session.plan import Ending, SessionPlan

__all__ = ["Ending", "SessionPlan", "measure", "replay", "stopped_by_signals"]
