"""Fit of a ground to the drops of a point: parameters, misfit, optimisation, uncertainty."""
