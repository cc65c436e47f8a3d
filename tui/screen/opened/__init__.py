"""A survey that is looked at: stored results, nothing recomputed.

- `rows`: its points as rows, judged, sorted, filtered; kept in the cache of the platform.
- `plots`: profile, map and overlays as lines.
- `app`: the screen, of the toolkit's own table, tabs, input and footer.
- `serving`: the same points as a page for a browser, read only.
"""
