"""The catalogue of effects: one module each, a common small interface."""

from inversion.effects.base import DropContext, Effect, EffectParameter, Ground
from inversion.effects.catalogue import BY_NAME, CATALOGUE

__all__ = ["BY_NAME", "CATALOGUE", "DropContext", "Effect", "EffectParameter", "Ground"]
