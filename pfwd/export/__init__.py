"""Exports of surveys as files for other programs; :mod:`.registry` lists the formats."""
