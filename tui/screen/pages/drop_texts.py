"""A drop and a point in words: for tables, verdicts and summaries on every page."""

import dataclasses
import math
from collections.abc import Mapping
from typing import NamedTuple

from pfwd.analysis.results import DropResult
from pfwd.judging import PointView
from pfwd.procedures import PointProgress, Quantity, Verdict
from pfwd.procedures.point import UNSUPPORTED_MARK
from tui.screen.drawing.lines import Line, TableColumn, TableRow, TextRole, cell, fit, piece
from tui.screen.session.drop_state import DropState
from tui.screen.session.state import SessionState
from tui.screen.units import NO_VALUE, QuantityName, Units, judged_quantity, percent


def modulus_text(drop: DropState | None, units: Units) -> tuple[str, str]:
    """Modulus and its uncertainty as figures, without the unit."""
    result = drop.result if drop is not None else None
    if drop is None or result is None or drop.modulus is None:
        return "-", ""
    value, error = units.with_uncertainty("modulus", drop.modulus, uncertainty_of(result), 3)
    return (f"{value}{UNSUPPORTED_MARK}" if result.not_supported is not None else value), error


class Judged(NamedTuple):
    """What the procedure judges, of one drop, as figures."""

    name: str
    value: str
    error: str
    """Half of the 95 % interval; empty: one drop has none."""
    unit: str
    is_fit: bool
    """Whether it is the modulus of the inversion."""


def judged_of(state: SessionState, drop: DropState | None, units: Units) -> Judged:
    """What the procedure judges, of a drop; a dash where it is not known."""
    quantity = state.job.quantity
    name, unit = QUANTITY_NAMES[quantity], units.unit(judged_quantity(quantity))
    if quantity is Quantity.MODULUS:
        value, error = modulus_text(drop, units)
        return Judged(name, value, error, unit, is_fit=True)
    found = state.value_of(drop)
    shown = None if found is None else found.value
    return Judged(name, units.text(judged_quantity(quantity), shown), "", unit, is_fit=False)


QUANTITY_NAMES: Mapping[Quantity, str] = {
    Quantity.E_VD: "E_vd",
    Quantity.E_LWD: "E_LWD",
    Quantity.MODULUS: "modulus",
    Quantity.DEFLECTION: "deflection",
}
"""What is judged, in large type and in tables."""


def point_value_text(progress: PointProgress, units: Units) -> tuple[str, str, str]:
    """What is judged of a point: its value, its 95 % interval, its unit; dashes when unknown."""
    value = progress.value
    if value is None:
        return NO_VALUE, "", ""
    quantity = judged_quantity(value.quantity)
    mark = UNSUPPORTED_MARK if value.not_supported is not None else ""
    if value.interval is None:
        return f"{units.text(quantity, value.value)}{mark}", "", units.unit(quantity)
    half = (value.interval[1] - value.interval[0]) / 2
    shown, error = units.with_uncertainty(quantity, value.value, half, 3)
    return f"{shown}{mark}", error, units.unit(quantity)


def point_modulus_text(progress: PointProgress, units: Units) -> str:
    """The modulus of a point that counts, with its interval, mark and unit; a dash for none."""
    modulus = progress.modulus
    if modulus is None:
        return NO_VALUE
    half = None if modulus.interval is None else (modulus.interval[1] - modulus.interval[0]) / 2
    value, error = units.with_uncertainty("modulus", modulus.value, half, 3)
    mark = UNSUPPORTED_MARK if modulus.not_supported is not None else ""
    return f"{value}{mark}{f' ±{error}' if error else ''} {units.unit('modulus')}"


def uncertainty_of(result: DropResult) -> float | None:
    """Half of the 95 % interval, model error included, Pa; None when there is no interval."""
    ends = result.modulus_interval_pa
    if ends is None or not all(map(math.isfinite, ends)):
        return None
    return float(ends[1] - ends[0]) / 2


class BesideModulus(NamedTuple):
    """A parameter of the ground beside the modulus, as figures."""

    amount: str
    deviation: str
    """Empty: given, not fitted."""
    unit: str


def beside_modulus(result: DropResult, units: Units) -> dict[str, BesideModulus]:
    """What the model of the ground has besides, by its name; what is not in it is left out."""
    known: tuple[tuple[str, QuantityName, float | None, float | None], ...] = (
        ("viscosity", "viscosity", result.viscosity_pa_s, result.viscosity_sd_pa_s),
        ("bedrock", "depth", result.bedrock_depth_m, result.bedrock_depth_sd_m),
        ("density", "density", result.density_kg_m3, result.density_sd_kg_m3),
    )
    found = {}
    for name, quantity, value, deviation in known:
        amount, error = units.with_uncertainty(quantity, value, deviation)
        if amount != NO_VALUE:
            found[name] = BesideModulus(amount, error, units.unit(quantity))
    return found


def plain(value: object) -> str:
    """Two decimals of whatever is a number."""
    return f"{value:.2f}" if isinstance(value, int | float) else NO_VALUE


def verdict_of(drop: DropState | None, diagnosed: str = "") -> tuple[str, TextRole]:
    """What is to be thought of a drop, in one sentence."""
    if drop is None:
        return "no drop yet", "dim"
    if drop.discarded:
        return "DISCARDED by the operator; u takes it back", "warn"
    if not drop.safe:
        return f"NOT SAFE YET: {drop.reason}", "bad"
    if drop.status == "rejected":
        return f"REJECTED: {drop.reason or 'no result'}", "bad"
    result = drop.result
    if drop.fault:
        return f"NO FIT: {drop.fault}", "bad"
    if result is None:
        return "computing", "dim"
    bounds = result.at_bound or ()
    warning = f"; AT BOUND: {', '.join(bounds)}" if bounds else ""
    if result.converged is False:
        warning += "; NOT CONVERGED"
    part = percent(result.residual_rms_over_peak)
    if drop.saturated:
        return f"SATURATED: not all was recorded; residual {part} of the peak{warning}", "bad"
    if diagnosed:
        return f"fit {diagnosed}{warning}", "warn" if bounds else "text"
    if result.explained:
        text = f"fit CLEAN: residual {part} of the peak, noise only"
        return text + warning, "warn" if warning else "good"
    contact = percent(result.contact_residual_rms_over_peak)
    text = f"fit UNEXPLAINED: residual {part} of the peak ({contact} in contact); 4 asks why"
    poor = (result.residual_rms_over_peak or 0.0) > POOR_FIT
    return text + warning, "bad" if poor else "warn"


POOR_FIT = 0.05
"""Residual over the peak from which a modulus says nothing of the ground: the curves are visibly
another's. Genuine drops on ground stay below a few percent (docs/validation.md)."""


_COLUMNS = (
    TableColumn("drop", 0),
    TableColumn("kind", 2, is_text=True),
    TableColumn("load", 3),
    TableColumn("defl", 4),
    TableColumn("E", 0),
    TableColumn("± 95 %", 1),
    TableColumn("residual", 5),
    TableColumn("remark", 6, is_flexible=True),
)


def drop_columns(units: Units) -> tuple[TableColumn, ...]:
    """The columns of a table of drops, with their units."""
    named = {
        "load": f"load {units.unit('load')}",
        "defl": f"defl {units.unit('deflection')}",
        "E": f"E {units.unit('modulus')}",
    }
    return tuple(
        dataclasses.replace(column, title=named.get(column.title, column.title))
        for column in _COLUMNS
    )


def drop_row(drop: DropState, units: Units, *, chosen: bool, left_out: str = "") -> TableRow:
    """A drop as a row; `left_out` says why it takes no part in the mean."""
    value, error = modulus_text(drop, units)
    residual = None if drop.result is None else drop.result.residual_rms_over_peak
    kind = "DISCARDED" if drop.discarded else drop.status if drop.safe else "NOT SAFE"
    role: TextRole = "text"
    if drop.discarded or drop.status == "seating":
        role = "dim"
    if drop.status == "rejected" or not drop.safe:
        role = "bad"
    return TableRow(
        (
            str(drop.number),
            kind,
            units.text("load", drop.peak_load),
            units.text("deflection", drop.peak_deflection),
            "..." if drop.awaits_modulus else value,
            error or ("" if drop.awaits_modulus else NO_VALUE),
            percent(residual),
            cell(f"{left_out}; {remark(drop, units)}" if left_out else remark(drop, units)).text,
        ),
        role,
        chosen,
        drop.number,
    )


def remark(drop: DropState, units: Units) -> str:
    """What is odd about a drop, most important first."""
    parts = []
    if drop.reason:
        parts.append(drop.reason)
    elif drop.fault:
        parts.append(f"NO FIT: {drop.fault}")
    elif not drop.safe:
        parts.append("only in memory")
    elif drop.results and not drop.final:
        parts.append("refining")
    parts += drop.marks
    if drop.results and drop.result and drop.result.explained is False:
        parts.append("unexplained")
    parts += [f"note: {note}" for note in drop.notes]
    if drop.identical is False:
        parts.append("not the recorded traces")
    if drop.rebounds:
        loads = ", ".join(units.text("load", load, 2) for load in drop.rebounds[:3])
        count = len(drop.rebounds)
        parts.append(f"{count} rebound{'s'[: count > 1]} ({loads} {units.unit('load')})")
    return "; ".join(parts) if parts else "safe"


VERDICTS: dict[Verdict, tuple[str, TextRole]] = {
    Verdict.PASS: ("PASS", "good"),
    Verdict.FAIL: ("FAIL", "bad"),
    Verdict.UNDECIDED: ("UNDECIDED", "warn"),
}


def point_summary(state: SessionState, point: PointView, units: Units, width: int) -> Line:
    """What is judged, of how many drops, and whether the target is met; the modulus beside it."""
    progress = point.progress
    pieces = []
    own = progress.value
    if own is None:
        pieces.append(piece(0, cell("point: nothing measured yet", "dim")))
    else:
        shown, error, unit = point_value_text(progress, units)
        sure = f" ±{error}" if error else ""
        text = f"point: {QUANTITY_NAMES[own.quantity]} {shown}{sure} {unit}, mean of {own.drops}"
        pieces.append(piece(0, cell(text, "strong")))
        if own.quantity is not Quantity.MODULUS and progress.modulus is not None:
            pieces.append(piece(2, cell(f"modulus {point_modulus_text(progress, units)}")))
    if own is not None and progress.verdict in VERDICTS:  # nothing measured is no verdict
        word, role = VERDICTS[progress.verdict]
        pieces.append(piece(0, cell(word, role)))
        pieces.append(piece(3, cell(progress.verdict_reason)))
    return fit(pieces, width)
