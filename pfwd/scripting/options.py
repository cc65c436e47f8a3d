"""Options of `pfwd.invert` and `pfwd.diagnose`, named as on the command line."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Mapping
from typing import Any

from pfwd.analysis.options import OPTION_OF_KEY, OPTIONS, AnalysisOptions
from pfwd.errors import OptionError, quote, refusal
from pfwd.files.header import HEADER_KEYS

Header = str | os.PathLike[str] | Mapping[str, object] | None

DECLARED_OPTIONS = tuple(OPTION_OF_KEY.values())
INVERT_OPTIONS = tuple(name for name in OPTIONS if name != "header")
DIAGNOSE_OPTIONS = ("elastic", "load", *DECLARED_OPTIONS)


def analysis_options(names: Iterable[str], options: Mapping[str, Any]) -> AnalysisOptions:
    """Check options and return them as the options of an analysis.

    Parameters
    ----------
    names : iterable of str
        Names of the permitted options.
    options : mapping
        Values by name; None: the default.

    Raises
    ------
    OptionError
        If an option is unknown, of the wrong type, outside its range, or contradicts another.
    """
    values: dict[str, Any] = {}
    for name, raw in options.items():
        if name not in names:
            close = difflib.get_close_matches(name, names, 1)
            hint = f"did you mean {close[0]}?" if close else ""
            raise OptionError(refusal(name, f"one of {', '.join(names)}", quote(name), hint))
        value = _plain(raw)
        if value is not None:
            OPTIONS[name].check(value, name, OptionError)
            values[name] = tuple(value) if isinstance(value, list) else value
    return AnalysisOptions(**values)


def _plain(value: Any) -> Any:
    """Convert numpy scalars to Python numbers, and arrays and tuples to lists."""
    if hasattr(value, "tolist"):
        return value.tolist()
    return list(map(_plain, value)) if isinstance(value, list | tuple) else value


def reading(
    header: Header, options: AnalysisOptions
) -> tuple[str | os.PathLike[str] | None, dict[str, object]]:
    """Return the header file to read, and the header keys that override those of files.

    Parameters
    ----------
    header : path of a TOML file, its keys as a mapping, or None
    options : AnalysisOptions
        Its declared values override the header.

    Returns
    -------
    file : path or None
        None: there is no header file.
    overrides : dict of header key to value

    Raises
    ------
    OptionError
        If the header is neither an existing file nor a mapping, or a value is outside its range.
    """
    if isinstance(header, Mapping):
        for key, value in header.items():
            if key in HEADER_KEYS:
                HEADER_KEYS[key].check(_plain(value), f"header key {key}", OptionError)
        return None, {**{str(k): _plain(v) for k, v in header.items()}, **options.overrides()}
    if header is not None and not (
        isinstance(header, str | os.PathLike) and os.path.isfile(header)
    ):
        expected = "the path of a TOML file, or its keys as a dict"
        raise OptionError(refusal("header", expected, quote(header)))
    return header, dict(options.overrides())
