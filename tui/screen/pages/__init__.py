"""The screens, one file each."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tui.screen.pages.page import Page

_HOMES = {
    "points": "PointsPage",
    "drop": "DropPage",
    "diagnosis": "DiagnosisPage",
    "setup": "SetupPage",
}


def make_page(name: str) -> "Page":
    """A page by its name, loaded when it is first wanted: the first paint does not wait for it."""
    module: Any = import_module(f"tui.screen.pages.{name}")
    page: Page = getattr(module, _HOMES[name])()
    return page
