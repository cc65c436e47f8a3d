"""Point with its verdict as one line of text."""

from pfwd.facts import fact_of_modulus, fact_of_value
from pfwd.judging import PointView
from pfwd.judging.job import target_text
from pfwd.procedures import PointProgress, Verdict
from pfwd.units import SI
from tui.output import clean


def has_verdict_line(progress: PointProgress) -> bool:
    """Return whether a complete point gets a line, because it has a procedure or a target."""
    return progress.measured_wanted is not None or progress.verdict is not Verdict.NONE


def point_text(point: PointView) -> str:
    """Return a complete point as a line: judged value, interval, target, verdict, settlements."""
    progress = point.progress
    value = progress.value
    text = "nothing to judge"
    if value is not None:
        text = f"{value.quantity.label} {SI.show(fact_of_value(value))}"
    parts = [f"point {clean(point.shown_name)}: {text}"]
    if value is not None and value.quantity.is_fitted and progress.modulus is not None:
        unjudged = value.quantity.other_fitted
        fact = fact_of_modulus(progress.modulus, unjudged)
        if fact.value is not None:
            parts.append(f"not judged: {unjudged.label} {SI.show(fact)}")
    if progress.target is not None:
        parts.append(f"target {target_text(progress.target)}")
    if progress.verdict is not Verdict.NONE:
        parts.append(f"{progress.verdict.value.upper()}: {progress.verdict_reason}")
    used = [depth for number, _, depth in progress.compaction if number in progress.used]
    if used:
        listed = ", ".join(SI.text("settlement", depth) for depth in used)
        parts.append(f"settlement {listed} {SI.unit('settlement')}")
    return "  ".join(parts)
