"""Surveys as files for other programs; one module a format, listed in :mod:`.formats`."""
