"""Screen of a recorded survey with its stored results; nothing is computed again.

- `rows`: points as rows, judged, sorted, filtered; stored in the cache of the platform.
- `plots`: profile, map and overlays as lines.
- `widgets`: table and line of keys.
- `app`: the application.
"""
