"""Extensions by other installed packages: located by entry points, loaded on first use.

A package names an object in its metadata, in one of four groups::

    [project.entry-points."pfwd.dialects"]         # a pfwd_device.wire.registry.DialectEntry
    [project.entry-points."pfwd.import_formats"]   # a pfwd.files.foreign.registry.Format
    [project.entry-points."pfwd.export_formats"]   # a pfwd.export.registry.ExportFormat
    [project.entry-points."pfwd.effects"]          # an inversion.effects.Effect
    toy = "toy_package:TOY"

The caller passes the class that it expects. An object that cannot be loaded, or has another class,
causes a remark (:func:`remarks`, and a warning), and the command continues. Packages in the current
folder are ignored, as the folder may contain untrusted files. This package is the lowest layer,
because the four registries stand in different packages (docs/decisions/plug-ins-in-one-module.md).
"""

from __future__ import annotations

import os
import sys
import warnings
from functools import cache
from typing import TYPE_CHECKING, NamedTuple, TypeVar

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from importlib.metadata import EntryPoint

T = TypeVar("T")

DIALECTS = "pfwd.dialects"
IMPORT_FORMATS = "pfwd.import_formats"
EXPORT_FORMATS = "pfwd.export_formats"
EFFECTS = "pfwd.effects"

_remarks: dict[str, None] = {}
_BROKEN = object()
"""Marker of an object that cannot be loaded."""


class PluginWarning(UserWarning):
    """Warning that an extension is ignored; the command line prints the remarks instead."""


class _Offer(NamedTuple):
    """An entry point and the package that has it."""

    entry: EntryPoint
    package: str
    """Name and version of the package."""


def names(group: str) -> tuple[str, ...]:
    """Return the sorted names of the entry points of a group without loading them."""
    return tuple(sorted(_offers(group)))


def package_of(group: str, name: str) -> str:
    """Return name and version of the package that has a name in a group."""
    return _offers(group)[name].package


def load(group: str, name: str, kind: type[T]) -> T | None:
    """Return the object that a package has under a name.

    Parameters
    ----------
    group : str
    name : str
    kind : type
        Class that the object must have.

    Returns
    -------
    object or None
        None when there is no such name, or, with a remark, when its object cannot be used.
    """
    if name not in _offers(group):
        return None
    extension = _object(group, name)
    if isinstance(extension, kind):
        return extension
    if extension is _BROKEN:
        return None
    value, actual = _offers(group)[name].entry.value, type(extension).__name__
    remark(group, name, f"a {kind.__name__} at {value}, got a {actual}")
    return None


def load_all(group: str, kind: type[T], taken: Collection[str] = ()) -> Iterator[tuple[str, T]]:
    """Yield name and object of each usable entry point of a group, in the order of the names.

    Parameters
    ----------
    group : str
    kind : type
        Class that each object must have.
    taken : collection of str
        Names of built-in objects, which no package can replace.
    """
    for name in names(group):
        if name in taken:
            remark(group, name, "a name of its own, got one that this program has")
        elif (extension := load(group, name, kind)) is not None:
            yield name, extension


def remark(group: str, name: str, mismatch: str) -> None:
    """Record once that an extension cannot be used, and warn of it.

    Parameters
    ----------
    group, name : str
        Group and name of the entry point.
    mismatch : str
        Expected and actual object, without the word "expected".
    """
    package = package_of(group, name)
    text = f"plug-in {name} of {package} ({group}) is left out: expected {mismatch}"
    # The message of an error in another package may have many lines.
    text = " ".join(text.split()) + "; update or uninstall the package"
    if text in _remarks:
        return
    _remarks[text] = None
    warnings.warn(text, PluginWarning, stacklevel=2)


def remarks() -> tuple[str, ...]:
    """Return one line for each extension that could not be used so far."""
    return tuple(_remarks)


def forget() -> None:
    """Clear remarks and caches, to start as a new process does."""
    _remarks.clear()
    _object.cache_clear()
    _offers.cache_clear()


@cache
def _object(group: str, name: str) -> object:
    """Return the object of an entry point, or `_BROKEN`."""
    try:
        return _offers(group)[name].entry.load()
    # An error in the code of another package must not end the command.
    except (Exception, SystemExit) as err:
        remark(group, name, f"an object that can be imported, got {type(err).__name__}: {err}")
        return _BROKEN


@cache
def _offers(group: str) -> dict[str, _Offer]:
    # Imported here, as the import would delay `pfwd --help`.
    from importlib.metadata import distributions

    offers: dict[str, _Offer] = {}
    titles = set()
    for package in distributions(path=_trusted_path()):
        entries = [entry for entry in package.entry_points if entry.group == group]
        if not entries:
            continue
        title = f"{package.name} {package.version}"
        if title in titles:
            continue  # twice on the path: the first counts, as for its modules
        titles.add(title)
        for entry in entries:
            offers.setdefault(entry.name, _Offer(entry, title))
    return offers


def _trusted_path() -> list[str]:
    """Return the search path of modules without the current folder."""
    # Without case, which the file systems of macOS and Windows do not distinguish.
    current = os.path.realpath(os.curdir).casefold()
    return [
        folder
        for folder in sys.path
        if os.path.isabs(folder) and os.path.realpath(folder).casefold() != current
    ]
