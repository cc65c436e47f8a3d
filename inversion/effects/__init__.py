"""The catalogue of effects: one module each, a common small interface.

The catalogue is loaded when it is asked for: effects of other packages import what stands here.
"""

from typing import TYPE_CHECKING, Any

from inversion.effects.base import DropContext, Effect, Ground
from inversion.fitting.parameters import Parameter

if TYPE_CHECKING:
    from inversion.effects.catalogue import BY_NAME, CATALOGUE

__all__ = ["BY_NAME", "CATALOGUE", "DropContext", "Effect", "Ground", "Parameter"]


def __getattr__(name: str) -> Any:
    if name not in ("BY_NAME", "CATALOGUE"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from inversion.effects import catalogue

    return getattr(catalogue, name)
