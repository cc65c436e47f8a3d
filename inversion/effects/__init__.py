"""The catalogue of effects: one module each, a common small interface."""

from inversion.effects.base import DropContext, Effect, Ground
from inversion.effects.catalogue import BY_NAME, CATALOGUE
from inversion.fitting.parameters import Parameter

__all__ = ["BY_NAME", "CATALOGUE", "DropContext", "Effect", "Ground", "Parameter"]
