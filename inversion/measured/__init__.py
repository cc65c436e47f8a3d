"""What a recorded drop says before any ground is fitted to it."""
