"""JSON as other programs read it: no NaN, no infinity."""

import json
import math
from collections.abc import Mapping
from typing import Any


def json_text(data: Any) -> str:
    """`data` as JSON on one line, NaN and infinity as null.

    Examples
    --------
    >>> json_text({"modulus_pa": 4e7, "modulus_sd_pa": float("nan")})
    '{"modulus_pa": 40000000.0, "modulus_sd_pa": null}'
    """
    return json.dumps(without_nan(data), allow_nan=False)


def without_nan(value: Any) -> Any:
    """The same with None for every number that JSON does not know."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    match value:
        case float():
            return value if math.isfinite(value) else None
        case Mapping():
            return {str(key): without_nan(item) for key, item in value.items()}
        case list() | tuple():
            return [without_nan(item) for item in value]
    return value
