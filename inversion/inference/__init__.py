"""Inference over the points of an instrument: one likelihood, priors from the other points."""
