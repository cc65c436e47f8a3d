"""Inference: choice of the effects of a point by evidence, and prediction of further drops.

The points of one instrument share a population, from which the priors of each point are made.
"""
