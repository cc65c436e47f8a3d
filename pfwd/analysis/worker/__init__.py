"""Inverts drops beside the acquisition, in a process of its own."""
