"""Response of the ground under a plate: converged computation, and a fast approximation of it."""
