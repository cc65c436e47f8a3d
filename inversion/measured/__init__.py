"""Evaluation of a recorded drop without a model of the ground: preparation, faults, peaks."""
