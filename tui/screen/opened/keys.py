"""The toolkit's line of keys, made anew only where it differs."""

from typing import Any

from textual.screen import Screen
from textual.widgets import Footer


class KeysLine(Footer):
    """The keys that can be pressed now.

    The toolkit takes the line down and builds it again whenever the focus moves, 25 ms each time
    and three times a change of the tab, though what it says is the same.
    """

    _said: tuple[tuple[str, str, bool], ...] = ()

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
