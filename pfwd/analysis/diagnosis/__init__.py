"""Diagnosis of files and surveys: reading the points, diagnosing them, results, pictures."""
