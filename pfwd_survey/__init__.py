"""Joins instrument and inversion: files, points and drops, results."""
