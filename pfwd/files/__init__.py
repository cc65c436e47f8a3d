"""Readers and writers of files: surveys, trace files, files of other programs, photos."""
