"""Analysis of drops: screening, inversion here or in a worker process, results and plots."""
