"""Colours for the roles of text: a dark theme, and a daylight theme of highest contrast.

Colour repeats what words, shapes and positions show already.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from rich.style import Style
from textual.theme import Theme

from tui.screen.drawing.lines import TextRole


@dataclass(frozen=True, slots=True)
class ScreenTheme:
    """Colours of the screen, for the roles of lines and for the widgets of the toolkit."""

    styles: Mapping[TextRole, Style]
    theme: Theme


def _theme(
    name: str, colours: Mapping[TextRole, str], background: str, surface: str, panel: str
) -> ScreenTheme:
    base = Style.parse(f"{colours['text']} on {background}")
    own = {role: Style.parse(text) for role, text in colours.items()}
    colour = {role: style.color.name for role, style in own.items() if style.color}
    theme = Theme(
        name=name,
        primary=colour["load"],
        secondary=colour["fitted"],
        accent=colour["key"],
        foreground=colour["text"],
        background=background,
        surface=surface,
        panel=panel,
        success=colour["good"],
        warning=colour["warn"],
        error=colour["bad"],
        dark=name == "pfwd-dark",
    )
    return ScreenTheme({role: base + style for role, style in own.items()}, theme)


DARK = _theme(
    "pfwd-dark",
    {
        "text": "#e6e6e6",
        "dim": "#9aa4ad",
        "strong": "bold #ffffff",
        "title": "bold #ffffff on #24303a",
        "good": "bold #7ee787",
        "bad": "bold #ff8b81",
        "warn": "bold #ffd166",
        "load": "#8ecbff",
        "measured": "#e6e6e6",
        "fitted": "#ffb454",
        "residual": "#d2a8ff",
        "axis": "#8a949e",
        "cursor": "bold #101418 on #ffd166",
        "key": "bold #ffd166",
        "ready": "bold #06210c on #7ee787",
        "busy": "bold #0b1a2b on #8ecbff",
        "alarm": "bold #2b0500 on #ff8b81",
    },
    background="#101418",
    surface="#1a2128",
    panel="#24303a",
)

DAYLIGHT = _theme(
    "pfwd-daylight",
    {
        "text": "#000000",
        "dim": "#303030",
        "strong": "bold #000000",
        "title": "bold #ffffff on #000000",
        "good": "bold #004d12",
        "bad": "bold #8f0000",
        "warn": "bold #6b3d00",
        "load": "bold #00307a",
        "measured": "bold #000000",
        "fitted": "bold #a03000",
        "residual": "bold #4b0082",
        "axis": "#303030",
        "cursor": "bold #ffffff on #000000",
        "key": "bold underline #000000",
        "ready": "bold #ffffff on #004d12",
        "busy": "bold #ffffff on #00307a",
        "alarm": "bold #ffffff on #8f0000",
    },
    background="#ffffff",
    surface="#ffffff",
    panel="#e8e8e8",
)

THEMES: Mapping[str, ScreenTheme] = {"dark": DARK, "daylight": DAYLIGHT}
