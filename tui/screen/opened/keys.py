"""The toolkit's line of keys, made anew only where it differs."""

from typing import Any

from textual import events
from textual.screen import Screen
from textual.widgets import Footer

WIDE = 104
"""Columns from which all keys have room with the palette beside them; below that they stand closer
and the palette, which ctrl+p opens all the same, is not named."""


class KeysLine(Footer):
    """The keys that can be pressed now.

    The toolkit takes the line down and builds it again whenever the focus moves, 25 ms each time
    and three times a change of the tab, though what it says is the same.
    """

    DEFAULT_CSS = """
    KeysLine.-compact FooterKey.-command-palette { display: none; }
    """

    _said: tuple[tuple[str, str, bool], ...] = ()

    def on_resize(self, event: events.Resize) -> None:
        """Closer where there is little room."""
        self.compact = event.size.width < WIDE

    def bindings_changed(self, screen: Screen[Any]) -> None:
        """Build the line again where another key, another word or another state is to be shown."""
        said = tuple(
            (key, active.binding.description, active.enabled)
            for key, active in screen.active_bindings.items()
            if active.binding.show
        )
        if said == self._said or not screen.app.app_focus:
            return
        self._said = said
        super().bindings_changed(screen)
