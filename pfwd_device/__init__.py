"""The instrument side: bytes to drops."""

from pfwd_device.drop import Channel, Drop, Quantity

__all__ = ["Channel", "Drop", "Quantity"]
