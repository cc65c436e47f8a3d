"""The ground under a plate: its response computed to convergence, and the fast stand-in for it."""
