"""Diagnosis of points and surveys: the effects that explain the residual of a fit.

An effect is a physical or instrumental cause that the base model (homogeneous ground under a plate)
does not contain.
"""
