"""Files of other programs as test points; one module a format, found by :mod:`.registry`."""
