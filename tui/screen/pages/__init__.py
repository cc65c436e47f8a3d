"""Pages of the live screen, one file each.

A new page is a module here with a subclass of :class:`tui.screen.pages.page.Page` and an entry in
``PAGES``.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from tui.screen.pages.page import Page


class PageEntry(NamedTuple):
    """Entry of `PAGES`: a page and the key that opens it."""

    name: str
    """Name of the module."""
    class_name: str
    key: str
    title: str
    """Title in the help and in the command palette."""


PAGES = (
    PageEntry("measure", "MeasurePage", "1", "Measure"),
    PageEntry("points", "PointsPage", "2", "Points"),
    PageEntry("drop", "DropPage", "3", "Drop"),
    PageEntry("diagnosis", "DiagnosisPage", "4", "Diagnosis"),
    PageEntry("setup", "SetupPage", "5", "Setup"),
)
"""Pages in the order of their keys; the first stays below all other pages."""


def make_page(name: str) -> "Page":
    """Return a page by its name; its module is imported now, so that the program starts faster."""
    module: Any = import_module(f"tui.screen.pages.{name}")
    (class_name,) = (entry.class_name for entry in PAGES if entry.name == name)
    page: Page = getattr(module, class_name)()
    return page
