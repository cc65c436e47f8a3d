"""The catalogue of effects: one module each, a common small interface.

The catalogue is loaded when it is asked for: effects of other packages import what stands here.
"""

from typing import TYPE_CHECKING

from inversion.effects.base import DropContext, Effect, Ground
from inversion.fitting.parameters import Parameter
from pfwd_plugins.lazy_names import lazy_getattr

if TYPE_CHECKING:
    from inversion.effects.catalogue import BY_NAME, CATALOGUE

__all__ = ["BY_NAME", "CATALOGUE", "DropContext", "Effect", "Ground", "Parameter"]

__getattr__ = lazy_getattr(
    globals(), dict.fromkeys(("BY_NAME", "CATALOGUE"), "inversion.effects.catalogue")
)
