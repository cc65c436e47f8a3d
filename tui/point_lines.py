"""Point with its verdict as one line of text."""

from pfwd.digits import modulus_text, with_ends
from pfwd.judging import PointView
from pfwd.judging.job import target_text
from pfwd.procedures import PointModulus, PointProgress, PointValue, Quantity, Verdict
from pfwd.procedures.point import UNSUPPORTED_MARK
from tui.output import clean


def has_verdict_line(progress: PointProgress) -> bool:
    """Return whether a complete point gets a line, because it has a procedure or a target."""
    return progress.measured_wanted is not None or progress.verdict is not Verdict.NONE


def point_text(point: PointView) -> str:
    """Return a complete point as a line: judged value, interval, target, verdict, settlements."""
    progress = point.progress
    value = progress.value
    text = "nothing to judge" if value is None else value_text(value)
    parts = [f"point {clean(point.shown_name)}: {text}"]
    if value is not None and value.quantity.is_fitted and progress.modulus is not None:
        parts += other_modulus_texts(progress.modulus, value.quantity)
    if progress.target is not None:
        parts.append(f"target {target_text(progress.target)}")
    if progress.verdict is not Verdict.NONE:
        parts.append(f"{progress.verdict.value.upper()}: {progress.verdict_reason}")
    used = [depth for number, _, depth in progress.compaction if number in progress.used]
    if used:
        listed = ", ".join(f"{depth * 1e3:.3f}" for depth in used)
        parts.append(f"settlement {listed} mm")
    return "  ".join(parts)


def other_modulus_texts(modulus: PointModulus, judged: Quantity) -> list[str]:
    """Return the fitted modulus that is not judged, with its interval; empty: there is none."""
    other = judged.other_fitted
    text = modulus_text(*modulus.in_quantity(other))
    return [f"not judged: {other.symbol} {text}"] if text else []


def value_text(value: PointValue) -> str:
    """Return the judged value with unit and interval, with the digits that these support."""
    unit, scale = value.quantity.display_unit
    number = value.value / scale
    name = value.quantity.symbol
    mark = UNSUPPORTED_MARK if value.not_supported is not None else ""
    bounds = value.interval or value.drop_range
    if bounds is None:
        return f"{name} {number:.3g}{mark} {unit}"
    text, low, high = with_ends(number, (bounds[0] / scale, bounds[1] / scale))
    ends = f"{low} to {high}"
    if value.interval is None:
        ends = f"{value.drops} drops: {ends}, no interval"
    return f"{name} {text}{mark} {unit} ({ends})"
