"""Layered ground under a plate: any number of media over a rigid base or a half-space."""
