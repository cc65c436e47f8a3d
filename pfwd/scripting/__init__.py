"""Objects for scripts and notebooks: drops, points, surveys, results and diagnoses.

``import pfwd`` offers them.
"""
