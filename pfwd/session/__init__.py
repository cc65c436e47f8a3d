"""Measuring session: from a feed (instrument, recorded survey or capture) to saved drops and
moduli.

A drop is safe when it is on the disk; only then it is acknowledged. `measure` and `replay` run a
complete session.
"""

from pfwd.session.measure import measure, replay, stopped_by_signals
from pfwd.session.plan import Ending, SessionPlan

__all__ = ["Ending", "SessionPlan", "measure", "replay", "stopped_by_signals"]
