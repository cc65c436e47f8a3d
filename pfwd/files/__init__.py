"""Files: trace files and their headers, surveys with their points, edits and photos."""
