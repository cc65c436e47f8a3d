"""A diagnosis in one sentence."""

from pfwd.analysis.results import DiagnosisResult, FittedState
from tui.screen.units import Units, percent


def verdict_text(result: DiagnosisResult, units: Units) -> str:
    """The diagnosis of a point in one sentence; what could not be diagnosed says why."""
    if result.after is None and not result.effects:
        said = next(iter(result.warnings or ()), "no reason was said")
        return f"not made: {said}"
    before, after = result.before or FittedState(), result.after or FittedState()
    old, new = (units.text("modulus", state.modulus_pa) for state in (before, after))
    part = percent(after.residual_rms_over_peak)
    effects = ", ".join(str(effect.name).replace("_", " ") for effect in result.effects or ())
    if result.verdict == "unexplained" and result.corrected:
        unit = units.unit("modulus")
        return f"EXPLAINED to {part} of the peak by {effects}: {old} → {new} {unit}"
    match result.verdict:
        case "clean":
            return f"CLEAN: residual {part} of the peak, noise only"
        case "explained":
            unit = units.unit("modulus")
            return f"EXPLAINED by {effects}: {old} → {new} {unit}, residual {part}"
        case _:
            hint = f"; best guess {effects}" if effects else ""
            return f"UNEXPLAINED: residual {part} of the peak{hint}; repeat the drop"
