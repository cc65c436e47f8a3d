"""Inversion of drops during the acquisition, in a process of its own."""
