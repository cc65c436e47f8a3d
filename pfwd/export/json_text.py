"""JSON without NaN and infinity, which the standard does not allow."""

import json
from typing import Any

from inversion.records import without_nan


def json_text(data: Any) -> str:
    """Return data as JSON on one line, with null in place of NaN and infinity.

    Examples
    --------
    >>> json_text({"modulus_pa": 4e7, "modulus_sd_pa": float("nan")})
    '{"modulus_pa": 40000000.0, "modulus_sd_pa": null}'
    """
    return json.dumps(without_nan(data), allow_nan=False)
