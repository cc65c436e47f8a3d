"""Catalogue of effects: causes of misfit that the base model does not contain, one module for each.

The catalogue is imported when it is first used, because effects of other packages import from here.
"""

from typing import TYPE_CHECKING

from inversion.effects.base import DropContext, Effect, Ground
from inversion.effects.parameters import Parameter
from pfwd_plugins.lazy_names import lazy_getattr

if TYPE_CHECKING:
    from inversion.effects.catalogue import BY_NAME, CATALOGUE

__all__ = ["BY_NAME", "CATALOGUE", "DropContext", "Effect", "Ground", "Parameter"]

__getattr__ = lazy_getattr(globals(), {"inversion.effects.catalogue": ("BY_NAME", "CATALOGUE")})
