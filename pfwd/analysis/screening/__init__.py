"""Screening of drops before they are inverted: faults, and the usable part of a record."""
