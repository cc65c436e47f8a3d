"""What scripts and notebooks use: drops, surveys, results and diagnoses as objects."""
