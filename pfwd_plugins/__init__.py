"""What other installed packages add: found by their entry points, loaded when it is needed.

A package names an object in its metadata, in one of four groups::

    [project.entry-points."pfwd.dialects"]         # a pfwd_device.wire.registry.DialectEntry
    [project.entry-points."pfwd.import_formats"]   # a pfwd.files.foreign.registry.Format
    [project.entry-points."pfwd.export_formats"]   # a pfwd.export.registry.ExportFormat
    [project.entry-points."pfwd.effects"]          # an inversion.effects.Effect
    toy = "toy_package:TOY"

Who asks says what kind of object it expects. What cannot be loaded, or is something else, costs a
remark (:func:`remarks`, and a warning) and not the command. Packages in the current folder are not
looked at: it may have come from a stranger. This stands below all other packages, so that each of
them can ask.
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
"""In place of what cannot be loaded."""


class PluginWarning(UserWarning):
    """A part of another package is left out; the command line says its remarks instead."""


class _Offer(NamedTuple):
    """An entry point and the package that has it."""

    entry: EntryPoint
    package: str
    """Name and version."""


def names(group: str) -> tuple[str, ...]:
    """Names that packages have in a group, sorted; nothing of theirs is loaded."""
    return tuple(sorted(_offers(group)))


def package_of(group: str, name: str) -> str:
    """Name and version of the package that has a name in a group."""
    return _offers(group)[name].package


def load(group: str, name: str, kind: type[T]) -> T | None:
    """The object that a package has under a name.

    Parameters
    ----------
    group : str
    name : str
    kind : type
        What it has to be.

    Returns
    -------
    object or None
        None when there is no such name, or what is there cannot be used: then there is a remark.
    """
    if name not in _offers(group):
        return None
    found = _object(group, name)
    if isinstance(found, kind):
        return found
    if found is _BROKEN:
        return None
    value, came = _offers(group)[name].entry.value, type(found).__name__
    remark(group, name, f"a {kind.__name__} at {value}, came a {came}")
    return None


def load_all(group: str, kind: type[T], taken: Collection[str] = ()) -> Iterator[tuple[str, T]]:
    """Name and object of all that can be used in a group, in the order of the names.

    Parameters
    ----------
    group : str
    kind : type
        What each has to be.
    taken : collection of str
        Names of this program's own, which nobody can replace.
    """
    for name in names(group):
        if name in taken:
            remark(group, name, "a name of its own, came one that this program has")
        elif (found := load(group, name, kind)) is not None:
            yield name, found


def remark(group: str, name: str, expected_and_came: str) -> None:
    """Note that a part of another package cannot be used; once, however often it is said.

    Parameters
    ----------
    group, name : str
        Of the entry point.
    expected_and_came : str
        What was expected and what came, without the word "expected".
    """
    package = package_of(group, name)
    text = f"plug-in {name} of {package} ({group}) is left out: expected {expected_and_came}"
    # An error of a strange package may have many lines.
    text = " ".join(text.split()) + "; update or uninstall the package"
    if text in _remarks:
        return
    _remarks[text] = None
    from multiprocessing import parent_process

    if parent_process() is None:  # its workers meet the same and need not say so again
        warnings.warn(text, PluginWarning, stacklevel=2)


def remarks() -> tuple[str, ...]:
    """What could not be used so far, a line each."""
    return tuple(_remarks)


def forget() -> None:
    """Look anew, as a new process would."""
    _remarks.clear()
    _object.cache_clear()
    _offers.cache_clear()


@cache
def _object(group: str, name: str) -> object:
    """What an entry point names, or `_BROKEN`."""
    try:
        return _offers(group)[name].entry.load()
    # The code is somebody else's: whatever goes wrong in it is told, and the command goes on.
    except (Exception, SystemExit) as err:
        remark(group, name, f"an object that can be imported, came {type(err).__name__}: {err}")
        return _BROKEN


@cache
def _offers(group: str) -> dict[str, _Offer]:
    # Not at the top: it takes longer than `pfwd --help` may.
    from importlib.metadata import distributions

    found: dict[str, _Offer] = {}
    seen = set()
    for package in distributions(path=_trusted_path()):
        entries = [entry for entry in package.entry_points if entry.group == group]
        if not entries:
            continue
        title = f"{package.name} {package.version}"
        if title in seen:
            continue  # the same twice on the path: the first counts, as for its modules
        seen.add(title)
        for entry in entries:
            found.setdefault(entry.name, _Offer(entry, title))
    return found


def _trusted_path() -> list[str]:
    """Where modules are looked for, but for the current folder."""
    here = os.path.realpath(os.curdir)
    return [one for one in sys.path if os.path.isabs(one) and os.path.realpath(one) != here]
