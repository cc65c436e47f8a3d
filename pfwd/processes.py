"""How the terminal starts a Python process: as :mod:`pfwd_device.child_python` says."""

from pfwd_device.child_python import (
    children_shielded,
    python_command,
    python_environment,
    start_text_child,
)

__all__ = ["children_shielded", "python_command", "python_environment", "start_text_child"]
