"""The screens, one file each.

A new one is a module here with a class like :class:`tui.screen.pages.page.Page` and one entry in
``PAGES``.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from tui.screen.pages.page import Page


class PageEntry(NamedTuple):
    """A page that a key leads to."""

    name: str
    """Of its module."""
    class_name: str
    key: str
    title: str
    """For the help and the command palette."""


PAGES = (
    PageEntry("measure", "MeasurePage", "1", "Measure"),
    PageEntry("points", "PointsPage", "2", "Points"),
    PageEntry("drop", "DropPage", "3", "Drop"),
    PageEntry("diagnosis", "DiagnosisPage", "4", "Diagnosis"),
    PageEntry("setup", "SetupPage", "5", "Setup"),
)
"""In the order of their keys; the first stays below all others."""


def make_page(name: str) -> "Page":
    """A page by its name, loaded when it is first wanted: the first paint does not wait for it."""
    module: Any = import_module(f"tui.screen.pages.{name}")
    (class_name,) = (entry.class_name for entry in PAGES if entry.name == name)
    page: Page = getattr(module, class_name)()
    return page
