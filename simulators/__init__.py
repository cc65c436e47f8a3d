"""A mock instrument and its own physics, which shares no code with the inversion."""
