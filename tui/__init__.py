"""Command line and screens of ``pfwd``: everything that is typed or shown in a terminal."""
