"""Options of `pfwd.invert` and `pfwd.diagnose`, named as on the command line."""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypedDict, get_args

from pfwd.analysis.options import (
    OPTION_OF_KEY,
    AnalysisOptions,
    Depth,
    Layers,
    Load,
    Method,
    Model,
    Plate,
    Sensors,
    Thickness,
)
from pfwd.errors import OptionError, quote, refusal
from pfwd.files.header import HEADER_KEYS

Header = str | os.PathLike[str] | Mapping[str, object] | None


class CommonOptions(TypedDict, total=False):
    """Options of `pfwd.invert` and of `pfwd.diagnose`; None stands for the default."""

    header: Header
    quantity: Literal["displacement", "velocity"]
    offsets: float | Sequence[float] | None
    elastic: bool
    load: Load | None
    plate_radius: float | None
    plate_mass: float | None
    poisson_ratio: float | None
    density: float | None


class DiagnoseOptions(CommonOptions, total=False):
    """Options of `pfwd.diagnose`."""

    device: str | os.PathLike[str] | None
    jobs: int
    refit: bool


class InvertOptions(CommonOptions, total=False):
    """Options of `pfwd.invert`."""

    model: Model | None
    bedrock_depth: Depth | None
    layers: Layers | None
    thickness: Thickness | Sequence[float] | None
    plate: Plate | None
    sensors: Sensors | None
    joint: bool
    method: Method | None
    published: bool
    priors: bool
    seed: int


_WORDS = {"model": Model, "load": Load, "plate": Plate, "sensors": Sensors, "method": Method}
_DECLARED = {option: key for key, option in OPTION_OF_KEY.items()}
_OPTION_CHECKS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    **{
        name: (f"one of {', '.join(get_args(words))}", get_args(words).__contains__)
        for name, words in _WORDS.items()
    },
    **dict.fromkeys(
        ("elastic", "joint", "published", "priors"),
        ("True or False", lambda value: isinstance(value, bool)),
    ),
    "seed": ("a whole number >= 0", lambda value: type(value) is int),
    "bedrock_depth": (
        "a number > 0, in m, or 'unknown' or 'none'",
        lambda value: value in ("unknown", "none") or (type(value) in (int, float) and value > 0),
    ),
    "layers": (
        "a whole number from 1 to 4, or 'auto'",
        lambda value: value == "auto" or type(value) is int,
    ),
    "thickness": (
        "a list of numbers in m, from the top, or 'unknown'",
        lambda value: (
            value == "unknown"
            or (isinstance(value, list) and all(type(part) in (int, float) for part in value))
        ),
    ),
}
"""Expected value and check of each option that no file declares."""

INVERT_OPTIONS = tuple({**_DECLARED, **_OPTION_CHECKS})
DIAGNOSE_OPTIONS = ("elastic", "load", *_DECLARED)


def analysis_options(names: tuple[str, ...], options: Mapping[str, Any]) -> AnalysisOptions:
    """Check options and return them as the options of an analysis.

    Parameters
    ----------
    names : tuple of str
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
        if value is None:
            continue
        if name in _DECLARED:
            HEADER_KEYS[_DECLARED[name]].check(value, name, OptionError)
        elif not _OPTION_CHECKS[name][1](value):
            raise OptionError(refusal(name, _OPTION_CHECKS[name][0], quote(value)))
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
