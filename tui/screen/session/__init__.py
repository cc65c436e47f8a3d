"""Where events come from, and what they add up to; no widget."""
