"""Public names of a package that are imported on first use.

All packages use this, so it stands in the lowest of them.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any


def lazy_getattr(
    package: dict[str, Any], names_by_module: Mapping[str, Sequence[str]]
) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a package.

    Parameters
    ----------
    package : dict
        Globals of the package.
    names_by_module : mapping of str to sequence of str
        Names that the package imports from each module; with another name as ``name as other``.
    """
    homes: dict[str, tuple[str, str]] = {}
    for module, names in names_by_module.items():
        for entry in names:
            name, _, public = entry.partition(" as ")
            homes[public or name] = module, name

    def getattr_of_package(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package['__name__']!r} has no attribute {name!r}")
        module, original = homes[name]
        value = package[name] = getattr(import_module(module), original)
        return value

    return getattr_of_package
