"""Searching a box for the least misfit of whatever kind; nothing here knows of the ground."""
