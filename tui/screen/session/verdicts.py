"""A diagnosis in one sentence."""

from collections.abc import Mapping
from typing import Any

from tui.screen.units import Units, percent


def verdict_text(record: Mapping[str, Any], units: Units) -> str:
    """The diagnosis of a point in one sentence."""
    before, after = record.get("before") or {}, record.get("after") or {}
    old, new = (units.text("modulus", state.get("modulus_pa")) for state in (before, after))
    part = percent(after.get("residual_rms_over_peak"))
    effects = ", ".join(str(one["name"]).replace("_", " ") for one in record.get("effects") or ())
    match record.get("verdict"):
        case "clean":
            return f"CLEAN: residual {part} of the peak, noise only"
        case "explained":
            unit = units.unit("modulus")
            return f"EXPLAINED by {effects}: {old} to {new} {unit}, residual {part}"
        case _:
            hint = f"; best guess {effects}" if effects else ""
            return f"UNEXPLAINED: residual {part} of the peak{hint}; repeat the drop"
