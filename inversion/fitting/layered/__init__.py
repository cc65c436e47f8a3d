"""Layered ground fitted to drops: unknowns, misfit, starts, intervals, how many layers."""
