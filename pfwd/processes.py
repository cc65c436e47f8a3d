"""Start of Python processes for the terminal; see :mod:`pfwd_device.child_python`."""

from pfwd_device.child_python import (
    children_shielded,
    python_command,
    python_environment,
)

__all__ = ["children_shielded", "python_command", "python_environment"]
