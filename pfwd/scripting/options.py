"""The options of `pfwd.invert` and `pfwd.diagnose`, named as on the command line."""

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
from pfwd.errors import OptionError, TraceError, quote, refusal
from pfwd.files.header import KEYS, check_value

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
    """What `pfwd.diagnose` takes; None: not said."""

    elastic: bool
    load: Load | None
    plate_radius: float | None
    plate_mass: float | None
    poisson_ratio: float | None
    density: float | None


class InvertOptions(DiagnoseOptions, total=False):
    """What `pfwd.invert` takes; None: not said."""

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


def analysis_options(known: tuple[str, ...], given: Mapping[str, Any]) -> AnalysisOptions:
    """The options, each checked.

    Raises
    ------
    OptionError
        If one is unknown, of the wrong kind, outside its range, or contradicts another.
    """
    given = {name: _listed(value) for name, value in given.items()}
    for name, value in given.items():
        if name not in known:
            close = difflib.get_close_matches(name, known, 1)
            hint = f"did you mean {close[0]}?" if close else ""
            raise OptionError(refusal(name, f"one of {', '.join(known)}", quote(name), hint))
        if value is not None:
            _check(name, value)
    said = {name: value for name, value in given.items() if value is not None}
    if "thickness" in said and not isinstance(said["thickness"], str):
        said["thickness"] = tuple(_plain(value) for value in said["thickness"])
    numbers = {n: _plain(v) for n, v in said.items() if isinstance(v, Real) and n not in _FLAGS}
    return AnalysisOptions(**{**said, **numbers})


def _check(name: str, value: object) -> None:
    if name in _CHOICES and value not in _CHOICES[name]:
        raise OptionError(refusal(name, f"one of {', '.join(_CHOICES[name])}", quote(value)))
    if name in _FLAGS and not isinstance(value, bool):
        raise OptionError(refusal(name, "True or False", quote(value)))
    if name == "seed" and (isinstance(value, bool) or not isinstance(value, Integral)):
        raise OptionError(refusal(name, "a whole number >= 0", quote(value)))
    if name == "bedrock_depth":
        plain = _plain(value)
        number = isinstance(plain, int | float) and not isinstance(plain, bool) and plain > 0
        if not number and value not in ("unknown", "none"):
            expected = "a number > 0, in m, or 'unknown' or 'none'"
            raise OptionError(refusal(name, expected, quote(value)))
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if name == "layers" and value != "auto" and not whole:
        raise OptionError(refusal(name, "a whole number from 1 to 4, or 'auto'", quote(value)))
    if name == "thickness" and value != "unknown":
        parts = value if isinstance(value, Sequence) and not isinstance(value, str) else [None]
        if not all(isinstance(_plain(part), int | float) for part in parts):
            expected = "a list of numbers in m, from the top, or 'unknown'"
            raise OptionError(refusal(name, expected, quote(value)))
    if name in _DECLARED:
        try:
            check_value(_DECLARED[name], _plain(value), name)
        except TraceError as err:
            raise OptionError(str(err)) from err


def _plain(value: Any) -> Any:
    """A number of numpy as one of Python."""
    return value.item() if hasattr(value, "item") and getattr(value, "ndim", 0) == 0 else value


def _listed(value: Any) -> Any:
    """An array of numpy as a list: it compares with words number by number."""
    return value.tolist() if hasattr(value, "tolist") and getattr(value, "ndim", 0) > 0 else value


def reading(
    header: str | os.PathLike[str] | Mapping[str, object] | None, options: AnalysisOptions
) -> tuple[str | os.PathLike[str] | None, dict[str, object]]:
    """The file of a header, and the keys that win over what files say.

    Raises
    ------
    OptionError
        If the header is neither a path of a file nor a mapping of known keys.
    """
    if isinstance(header, Mapping):
        for key, value in header.items():
            try:
                if key in KEYS:
                    check_value(key, _plain(value), f"header key {key}")
            except TraceError as err:
                raise OptionError(str(err)) from err
        return None, {**{str(k): _plain(v) for k, v in header.items()}, **options.overrides()}
    if header is not None and not (
        isinstance(header, str | os.PathLike) and os.path.isfile(header)
    ):
        expected = "the path of a TOML file, or its keys as a dict"
        raise OptionError(refusal("header", expected, quote(header)))
    return header, dict(options.overrides())
