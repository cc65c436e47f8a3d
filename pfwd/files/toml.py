"""Writing of TOML values; the standard library only reads TOML."""

import datetime
import json
import re

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def toml_line(key: str, value: object) -> str:
    """Return ``key = value`` in TOML, on one line.

    Parameters
    ----------
    key : str
    value : bool, int, float, str, date, time, list or dict
        Value of a type that ``tomllib`` returns.

    Returns
    -------
    str

    Raises
    ------
    TypeError
        If TOML has no such value.

    Examples
    --------
    >>> toml_line("plate_radius_m", 0.15)
    'plate_radius_m = 0.15'
    >>> toml_line("my site", 'km 12 "north"')
    '"my site" = "km 12 \\\\"north\\\\""'
    """
    return f"{key if _BARE_KEY.fullmatch(key) else _string(key)} = {_value(value)}"


def _value(value: object) -> str:
    match value:
        case bool():
            return "true" if value else "false"
        case int() | float():
            return repr(value)
        case str():
            return _string(value)
        case datetime.datetime() | datetime.date() | datetime.time():
            return value.isoformat()
        case list() | tuple():
            return "[" + ", ".join(map(_value, value)) + "]"
        case dict():
            return "{" + ", ".join(toml_line(key, item) for key, item in value.items()) + "}"
    raise TypeError(f"expected a value of a TOML type, got {type(value).__name__}")


def _string(text: str) -> str:
    # TOML's basic strings are JSON's, except that DEL has to be escaped and that surrogate pairs
    # must not stand as escapes (hence no ASCII-only output).
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
