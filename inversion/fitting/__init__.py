"""One ground fitted to drops: its parameters, their misfit, the fit and how well it is known."""
