"""How the roles of text look: a dark theme, and a daylight one of highest contrast.

Colour only repeats what words, forms and places say already.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from rich.style import Style
from textual.theme import Theme

from tui.screen.drawing.lines import TextRole


@dataclass(frozen=True, slots=True)
class Look:
    """A theme."""

    name: str
    title: str
    background: str
    styles: Mapping[TextRole, Style]
    theme: Theme


def _look(name: str, title: str, back: str, colours: Mapping[TextRole, str], theme: Theme) -> Look:
    ground = Style.parse(f"{colours['text']} on {back}")
    styles = {role: ground + Style.parse(text) for role, text in colours.items()}
    return Look(name, title, back, styles, theme)


DARK = _look(
    "pfwd-dark",
    "dark",
    "#101418",
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
    Theme(
        name="pfwd-dark",
        primary="#8ecbff",
        secondary="#ffb454",
        accent="#ffd166",
        foreground="#e6e6e6",
        background="#101418",
        surface="#1a2128",
        panel="#24303a",
        success="#7ee787",
        warning="#ffd166",
        error="#ff8b81",
        dark=True,
    ),
)

DAYLIGHT = _look(
    "pfwd-daylight",
    "daylight",
    "#ffffff",
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
    Theme(
        name="pfwd-daylight",
        primary="#00307a",
        secondary="#a03000",
        accent="#000000",
        foreground="#000000",
        background="#ffffff",
        surface="#ffffff",
        panel="#e8e8e8",
        success="#004d12",
        warning="#6b3d00",
        error="#8f0000",
        dark=False,
    ),
)

LOOKS: Mapping[str, Look] = {"dark": DARK, "daylight": DAYLIGHT}
