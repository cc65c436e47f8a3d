"""Conformance test of an instrument: every numbered requirement of docs/protocol.md."""

from pfwd_device.conformance.requirements import Result, conform

__all__ = ["Result", "conform"]
