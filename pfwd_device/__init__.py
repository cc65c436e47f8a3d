"""The instrument side: bytes to drops."""
