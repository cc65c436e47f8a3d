"""What an operator chooses once and finds again tomorrow; kept where the platform wants settings.

A folder that cannot be written and a damaged file are survived: the choices last for the day then.
"""

import dataclasses
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pfwd.files.disk import replaced_at_once


@dataclass(frozen=True, slots=True)
class ScreenSettings:
    """Of the screen."""

    theme: Literal["dark", "daylight"] = "dark"
    units: Literal["si", "us"] = "si"
    large: bool = False
    """Large type: figures first, traces only where there is room."""
    bell: bool = True


_CHOICES: dict[str, tuple[Any, ...]] = {
    "theme": ("dark", "daylight"),
    "units": ("si", "us"),
    "large": (True, False),
    "bell": (True, False),
}


def settings_file() -> Path:
    """Where they are kept; ``PFWD_SETTINGS`` names another file."""
    said = os.environ.get("PFWD_SETTINGS")
    if said:
        return Path(said)
    from platformdirs import user_config_path

    return user_config_path("pfwd", appauthor=False) / "screen.json"


def load_settings(path: Path | None = None) -> ScreenSettings:
    """The settings as they were saved; what is missing or wrong is as ever."""
    try:
        with open(path or settings_file(), encoding="utf-8") as stream:
            value = json.loads(stream.read(10_000))
    except (OSError, ValueError, RecursionError):
        return ScreenSettings()
    if not isinstance(value, dict):
        return ScreenSettings()
    sound = {
        key: value[key]
        for key, choices in _CHOICES.items()
        if any(type(value.get(key)) is type(choice) and value[key] == choice for choice in choices)
    }
    return ScreenSettings(**sound)


def save_settings(settings: ScreenSettings, path: Path | None = None) -> bool:
    """Store the settings; return whether that succeeded."""
    target = path or settings_file()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with replaced_at_once(target) as draft:
            draft.write_text(json.dumps(dataclasses.asdict(settings)) + "\n", encoding="utf-8")
    except OSError:
        return False
    return True
