"""Options of `pfwd.invert` and `pfwd.diagnose`, named as on the command line."""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from typing import Any, TypedDict, get_args

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

_CHOICES = {
    "model": get_args(Model),
    "load": get_args(Load),
    "plate": get_args(Plate),
    "sensors": get_args(Sensors),
    "method": get_args(Method),
}
_FLAGS = ("elastic", "joint", "published", "priors")
_DECLARED = {option: key for key, option in OPTION_OF_KEY.items()}


class DiagnoseOptions(TypedDict, total=False):
    """Options of `pfwd.diagnose`; None stands for the default."""

    elastic: bool
    load: Load | None
    plate_radius: float | None
    plate_mass: float | None
    poisson_ratio: float | None
    density: float | None


class InvertOptions(DiagnoseOptions, total=False):
    """Options of `pfwd.invert`; None stands for the default."""

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


INVERT_OPTIONS = tuple(InvertOptions.__annotations__)
DIAGNOSE_OPTIONS = tuple(DiagnoseOptions.__annotations__)


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
    for name, array_or_value in options.items():
        if name not in names:
            close = difflib.get_close_matches(name, names, 1)
            hint = f"did you mean {close[0]}?" if close else ""
            raise OptionError(refusal(name, f"one of {', '.join(names)}", quote(name), hint))
        value = _as_list(array_or_value)
        if value is None:
            continue
        _check(name, value)
        if name == "thickness" and not isinstance(value, str):
            value = tuple(map(_as_number, value))
        elif isinstance(value, Real) and name not in _FLAGS:
            value = _as_number(value)
        values[name] = value
    return AnalysisOptions(**values)


def _check(name: str, value: object) -> None:
    if name in _CHOICES and value not in _CHOICES[name]:
        raise OptionError(refusal(name, f"one of {', '.join(_CHOICES[name])}", quote(value)))
    if name in _FLAGS and not isinstance(value, bool):
        raise OptionError(refusal(name, "True or False", quote(value)))
    if name == "seed" and (isinstance(value, bool) or not isinstance(value, Integral)):
        raise OptionError(refusal(name, "a whole number >= 0", quote(value)))
    if name == "bedrock_depth":
        plain = _as_number(value)
        number = isinstance(plain, int | float) and not isinstance(plain, bool) and plain > 0
        if not number and value not in ("unknown", "none"):
            expected = "a number > 0, in m, or 'unknown' or 'none'"
            raise OptionError(refusal(name, expected, quote(value)))
    is_integer = isinstance(value, Integral) and not isinstance(value, bool)
    if name == "layers" and value != "auto" and not is_integer:
        raise OptionError(refusal(name, "a whole number from 1 to 4, or 'auto'", quote(value)))
    if name == "thickness" and value != "unknown":
        parts = value if isinstance(value, Sequence) and not isinstance(value, str) else [None]
        if not all(isinstance(_as_number(part), int | float) for part in parts):
            expected = "a list of numbers in m, from the top, or 'unknown'"
            raise OptionError(refusal(name, expected, quote(value)))
    if name in _DECLARED:
        HEADER_KEYS[_DECLARED[name]].check(_as_number(value), name, OptionError)


def _as_number(value: Any) -> Any:
    """Convert a numpy scalar to a Python number; return any other value unchanged."""
    return value.item() if hasattr(value, "item") and getattr(value, "ndim", 0) == 0 else value


def _as_list(value: Any) -> Any:
    """Convert an array to a list, so that it can be compared with a word; return other values
    unchanged.
    """
    return value.tolist() if hasattr(value, "tolist") and getattr(value, "ndim", 0) > 0 else value


def reading(
    header: str | os.PathLike[str] | Mapping[str, object] | None, options: AnalysisOptions
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
                HEADER_KEYS[key].check(_as_number(value), f"header key {key}", OptionError)
        return None, {**{str(k): _as_number(v) for k, v in header.items()}, **options.overrides()}
    if header is not None and not (
        isinstance(header, str | os.PathLike) and os.path.isfile(header)
    ):
        expected = "the path of a TOML file, or its keys as a dict"
        raise OptionError(refusal("header", expected, quote(header)))
    return header, dict(options.overrides())
