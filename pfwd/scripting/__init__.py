"""Drops, surveys, results and diagnoses as objects for scripts and notebooks."""
