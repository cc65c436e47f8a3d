"""Readers of other programs' files, one module for each format; :mod:`.registry` lists them.

A reader returns test points as those of trace files. A remark is a warning about how a file was
read; it is stored with the point and shown with its results. The word "station" is used for a test
point in formats that call it so.
"""
