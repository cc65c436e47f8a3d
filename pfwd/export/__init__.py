"""Surveys as files for other programs; the formats are listed in :mod:`.registry`."""
