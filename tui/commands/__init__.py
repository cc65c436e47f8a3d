"""Commands of ``pfwd``, one module each.

A module has ``add_arguments(parser)``, which adds the command's arguments, and ``run(args)``, which
runs the command and returns its exit status: 0 done, 1 data refused, 2 wrong usage. Modules that
take long to import are imported in ``run``, so that ``pfwd --help`` answers at once.
"""
