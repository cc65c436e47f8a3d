"""Quantities of a recorded drop that need no model of the ground."""
