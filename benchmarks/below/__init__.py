"""Faults below all code: calls that fail and files that are replaced, under the real program."""
