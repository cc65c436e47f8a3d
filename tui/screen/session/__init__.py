"""Sources of sessions, their events, and the state that results from them; no widgets."""
