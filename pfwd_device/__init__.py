"""Communication with the instrument, detection of drops, and their recording on the disk.

A drop is one impact of the falling weight on the load plate, with the time histories of the load
cell and of the sensors of motion.

The names in ``__all__`` are imported on first use, so that the command line starts without numpy.
"""

from typing import TYPE_CHECKING

from pfwd_plugins.lazy_names import lazy_getattr

if TYPE_CHECKING:
    from pfwd_device.drop import Channel, Drop

__all__ = ["Channel", "Drop"]

__getattr__ = lazy_getattr(globals(), {"pfwd_device.drop": __all__})
