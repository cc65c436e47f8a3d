"""A simulated instrument with physics of its own.

The physics (finite elements) shares no code with the inversion, so that simulated data can test it.
"""
