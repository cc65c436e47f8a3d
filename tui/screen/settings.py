"""Choices of the operator that last: theme, units, large type, bell.

They are stored in the settings folder of the platform. Without a writable folder, or with a damaged
file, they last until the program ends.
"""

import dataclasses
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pfwd.files.output_path import replaced_at_once


@dataclass(frozen=True, slots=True)
class ScreenSettings:
    """Settings of the screen that last from one run to the next."""

    theme: Literal["dark", "daylight"] = "dark"
    units: Literal["si", "us"] = "si"
    large: bool = False
    """Large type: the result fills the page, traces are drawn where there is room."""
    bell: bool = True


_SETTING_VALUES: dict[str, tuple[Any, ...]] = {
    "theme": ("dark", "daylight"),
    "units": ("si", "us"),
    "large": (True, False),
    "bell": (True, False),
}


def settings_file() -> Path:
    """Return the path of the stored settings; ``PFWD_SETTINGS`` names another file."""
    override = os.environ.get("PFWD_SETTINGS")
    if override:
        return Path(override)
    from platformdirs import user_config_path

    return user_config_path("pfwd", appauthor=False) / "screen.json"


def load_settings(path: Path | None = None) -> ScreenSettings:
    """Return the stored settings; missing and wrong ones have their default."""
    try:
        with open(path or settings_file(), encoding="utf-8") as stream:
            value = json.loads(stream.read(10_000))
    except (OSError, ValueError, RecursionError):
        return ScreenSettings()
    if not isinstance(value, dict):
        return ScreenSettings()
    sound = {
        key: value[key]
        for key, choices in _SETTING_VALUES.items()
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
