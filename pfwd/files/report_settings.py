"""Settings file of reports, with company and logo of the first page."""

from pathlib import Path

from pfwd.errors import OptionError
from pfwd.toml_reading import parse_user_toml, read_toml_text
from pfwd_device.schema import Key, TableReader, Text

REPORT_KEYS = {
    "company": Key(Text(), meaning="Name of the company on the first page"),
    "logo": Key(Text(), meaning="Picture on the first page, from the folder of this file"),
}


def read_report_settings(file: Path) -> dict[str, str]:
    """Return company and logo from ``report.toml``; empty if there is no such file.

    Raises
    ------
    OptionError
        If the file has other keys.
    """
    if not file.is_file():
        return {}
    table = parse_user_toml(read_toml_text(file, OptionError), str(file), OptionError)
    values = TableReader(OptionError, str(file)).read(table, REPORT_KEYS)
    if "logo" in values:
        values["logo"] = str(file.parent / values["logo"])  # an absolute path is not changed
    return values
