"""The instrument side: bytes to drops, and drops to the disk.

The names below are loaded on first use, so that the command line answers before numpy is in.
"""

from typing import TYPE_CHECKING

from pfwd_plugins.lazy_names import lazy_getattr

if TYPE_CHECKING:
    from pfwd_device.drop import Channel, Drop, Quantity

__all__ = ["Channel", "Drop", "Quantity"]

__getattr__ = lazy_getattr(globals(), dict.fromkeys(__all__, "pfwd_device.drop"))
