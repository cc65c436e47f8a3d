"""Search for the smallest misfit within bounds.

Nothing in this package depends on the model of the ground.
"""
