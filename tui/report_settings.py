"""Company and logo on the first page of every report, declared once in a file.

``report.toml`` beside the settings of the screen; ``PFWD_SETTINGS`` names another place for both::

    company = "Erdbau Muster GmbH"
    logo = "C:/Logos/muster.png"
"""

from dataclasses import dataclass
from pathlib import Path

from pfwd.errors import OptionError, quote, refusal
from pfwd.toml_reading import parse_user_toml, read_toml_text
from tui.screen.settings import settings_file

NAME = "report.toml"
"""Name of the file in the folder of the settings."""

KEYS = ("company", "logo")


@dataclass(frozen=True, slots=True)
class ReportSettings:
    """Company and logo of the first page; None: not declared."""

    company: str | None = None
    logo: str | None = None


def load_report_settings(path: Path | None = None) -> ReportSettings:
    """Return the contents of the file; empty if there is none.

    Raises
    ------
    OptionError
        If the file is not of this kind.
    """
    file = path or settings_file().with_name(NAME)
    if not file.is_file():
        return ReportSettings()
    values = parse_user_toml(read_toml_text(file, OptionError), str(file), OptionError)
    for key, value in values.items():
        if key not in KEYS or not isinstance(value, str):
            raise OptionError(refusal(str(file), 'company = "..." or logo = "..."', quote(key)))
    logo = values.get("logo")
    if logo is not None:
        logo = str(file.parent / logo)  # an absolute one stays
    return ReportSettings(values.get("company"), logo)
