"""Offset and displacement of raw records, for the floors above: :mod:`pfwd_device.signals`."""

from pfwd_device.signals import channels_outward, displacement_of, quiet_samples, remove_offset

__all__ = ["channels_outward", "displacement_of", "quiet_samples", "remove_offset"]
