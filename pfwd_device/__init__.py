"""The instrument side: from bytes to drops, and from drops to the disk.

The names below are loaded on first use: the command line then starts without numpy.
"""

from typing import TYPE_CHECKING

from pfwd_plugins.lazy_names import lazy_getattr

if TYPE_CHECKING:
    from pfwd_device.drop import Channel, Drop, Quantity

__all__ = ["Channel", "Drop", "Quantity"]

__getattr__ = lazy_getattr(globals(), dict.fromkeys(__all__, "pfwd_device.drop"))
