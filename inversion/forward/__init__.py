"""Response of the ground under a plate: the converged computation, and a fast approximation of
it.
"""
