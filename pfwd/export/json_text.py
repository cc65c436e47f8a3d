"""JSON without NaN and infinity, which the standard does not allow."""

import json
import math
from collections.abc import Mapping
from typing import Any


def json_text(data: Any) -> str:
    """Return data as JSON on one line, with null in place of NaN and infinity.

    Examples
    --------
    >>> json_text({"modulus_pa": 4e7, "modulus_sd_pa": float("nan")})
    '{"modulus_pa": 40000000.0, "modulus_sd_pa": null}'
    """
    return json.dumps(without_nan(data), allow_nan=False)


def without_nan(value: Any) -> Any:
    """Return a value with None in place of every NaN and infinity in it; arrays become lists."""
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
