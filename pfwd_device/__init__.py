"""The instrument side: bytes to drops, and drops to the disk.

The names below are loaded on first use, so that the command line answers before numpy is in.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pfwd_device.drop import Channel, Drop, Quantity

__all__ = ["Channel", "Drop", "Quantity"]


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("pfwd_device.drop"), name)
