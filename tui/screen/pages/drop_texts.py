"""Texts of a drop and of a point for tables, verdicts and summaries on every page."""

import dataclasses
from collections.abc import Mapping

from pfwd.analysis.options import PLATE_WORDS
from pfwd.analysis.results import DropResult
from pfwd.digits import MISSING
from pfwd.facts import UNEXPLAINED, fact_of_modulus, fact_of_value, facts_of_drop
from pfwd.judging import PointView
from pfwd.message_groups import text_of
from pfwd.procedures import Quantity, Verdict
from pfwd.procedures.point import UNSUPPORTED_MARK
from pfwd.units import Fact, Units, percent
from tui.format import MODEL_WORDS, word
from tui.screen.drawing.lines import Line, TableColumn, TableRow, TextRole, cell, fit, piece
from tui.screen.session.screen_drop import ScreenDrop
from tui.screen.session.state import SessionState


def modulus_of_drop(drop: ScreenDrop | None, quantity: Quantity = Quantity.MODULUS) -> Fact:
    """Return a fitted modulus of a drop, of the diagnosis of its point if that counts."""
    result = drop.result if drop is not None else None
    modulus, interval = (None, None) if drop is None else drop.fitted(quantity)
    if drop is None or result is None or modulus is None:
        return Fact("modulus", None)
    is_supported = result.not_supported is None or drop.is_diagnosed
    return Fact("modulus", modulus, interval, mark="" if is_supported else UNSUPPORTED_MARK)


def judged_value(state: SessionState, drop: ScreenDrop | None) -> Fact:
    """Return the judged quantity of a drop."""
    quantity = state.job.quantity
    if quantity.is_fitted:
        return modulus_of_drop(drop, quantity)
    judged = None if drop is None else drop.value()
    return Fact(quantity.dimension, None if judged is None else judged.value)


def ground_parameters(result: DropResult, units: Units) -> dict[str, str]:
    """Return the parameters of the ground besides the modulus that the model has, as texts."""
    facts = facts_of_drop(result)
    texts = {key: units.show(facts[key]) for key in ("viscosity", "bedrock", "density")}
    return {key: text for key, text in texts.items() if text != MISSING}


METHOD_TEXTS: Mapping[str, str] = {"mpga": "full search", "posterior": "quick fit"}
MODEL_TEXTS: Mapping[str, str] = {**MODEL_WORDS, "half-space": "soil without bedrock"}


def assumption_texts(result: DropResult, units: Units) -> tuple[str, str, str, str]:
    """Return ground, plate, method and load of a fit in words."""
    n_layers = len(result.layers or ())
    ground = word(MODEL_TEXTS, result.model)
    radius = units.with_unit("length", result.plate_radius_m)
    return (
        f"lowest of {n_layers} layers, {ground}" if n_layers > 1 else ground,
        f"{word(PLATE_WORDS, result.plate)}, radius {radius}",
        word(METHOD_TEXTS, result.method),
        f"{result.load} load",
    )


def verdict_of(drop: ScreenDrop | None, diagnosed: str = "") -> tuple[str, TextRole]:
    """Return one sentence on a drop: discarded, rejected, or how well its fit explains it."""
    if drop is None:
        return "no drop yet", "dim"
    if drop.moved_to:
        return f"MOVED: {drop.moved_to}", "warn"
    if drop.discarded:
        return "DISCARDED by the operator; d restores it", "warn"
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
    names = ", ".join(bounds).replace("_", " ")
    warning = f"; AT THE LIMIT of the search: {names}" if bounds else ""
    if result.converged is False:
        warning += "; SEARCH NOT FINISHED"
    part = percent(result.residual_rms_over_peak)
    if drop.saturated:
        return f"SATURATED: the peak was not recorded; residual {part} of the peak{warning}", "bad"
    if diagnosed:
        return f"fit {diagnosed}{warning}", "warn" if bounds else "text"
    if result.explained:
        text = f"fit EXPLAINED: residual {part} of the peak, as small as the noise"
        return text + warning, "warn" if warning else "good"
    contact = percent(result.contact_residual_rms_over_peak)
    text = f"fit {UNEXPLAINED}: residual {part} of the peak, {contact} in contact; 4 finds causes"
    poor = (result.residual_rms_over_peak or 0.0) > MAX_FIT_RESIDUAL
    return text + warning, "bad" if poor else "warn"


MAX_FIT_RESIDUAL = 0.05
"""Residual over the peak above which the fitted modulus is wrong: the curves differ visibly.
Drops on ground stay below a few percent (docs/validation.md)."""


_DROP_TABLE_COLUMNS = (
    TableColumn("drop", 0),
    TableColumn("kind", 2, is_text=True),
    TableColumn("load", 3),
    TableColumn("defl", 4),
    TableColumn("judged", 0),
    TableColumn("E", 1),
    TableColumn("95 %", 1),
    TableColumn("residual", 5),
    TableColumn("remark", 6, is_flexible=True),
)


def drop_columns(quantity: Quantity, units: Units) -> tuple[TableColumn, ...]:
    """Return the columns of a table of drops; that of the judged quantity stands before E."""
    unit = units.unit(quantity.dimension)
    name = quantity.label if quantity is Quantity.EQUIVALENT_MODULUS else "E"
    titles = {
        "load": f"load {units.unit('load')}",
        "defl": f"defl {units.unit('deflection')}",
        "judged": f"{quantity.label} {unit}",
        "E": f"{name} {units.unit('modulus')}" + ("" if quantity.is_fitted else ", not judged"),
    }
    return tuple(
        dataclasses.replace(column, title=titles.get(column.title, column.title))
        for column in _DROP_TABLE_COLUMNS
        if column.title not in _hidden_columns(quantity)
    )


def _hidden_columns(quantity: Quantity) -> tuple[str, ...]:
    """Return the titles of columns that would repeat another one or have no value."""
    if quantity.is_fitted:
        return ("judged",)
    return ("95 %", "judged") if quantity is Quantity.DEFLECTION else ("95 %",)


def drop_row(state: SessionState, drop: ScreenDrop, units: Units, *, chosen: bool) -> TableRow:
    """Return the texts of a drop for a table with the columns of `drop_columns`."""
    quantity = state.job.quantity
    value, ends = units.value_and_ends(modulus_of_drop(drop, quantity))
    exclusion = drop.exclusion_reason
    residual = None if drop.curves_result is None else drop.curves_result.residual_rms_over_peak
    if drop.is_diagnosed:  # the ground is that of the point, and no single drop has its own
        value, ends = MISSING, ""
    kind = drop.edited_word or (drop.status if drop.safe else "NOT SAFE")
    role: TextRole = "text"
    if drop.discarded or drop.status == "seating":
        role = "dim"
    if drop.status == "rejected" or not drop.safe:
        role = "bad"
    texts = (
        str(drop.number),
        kind,
        units.text("load", drop.peak_load),
        units.text("deflection", drop.peak_deflection),
        units.value_and_ends(judged_value(state, drop))[0],
        "..." if drop.awaits_modulus else value,
        ends or ("" if drop.awaits_modulus else MISSING),
        percent(residual),
        cell(f"{exclusion}; {remark(drop, units)}" if exclusion else remark(drop, units)).text,
    )
    hidden = _hidden_columns(quantity)
    return TableRow(
        tuple(
            text
            for column, text in zip(_DROP_TABLE_COLUMNS, texts, strict=True)
            if column.title not in hidden
        ),
        role,
        chosen,
    )


def remark(drop: ScreenDrop, units: Units) -> str:
    """Return the irregularities of a drop, most important first."""
    parts = []
    if drop.moved_to:
        parts.append(drop.moved_to)
    elif drop.reason:
        parts.append(drop.reason)
    elif drop.fault:
        parts.append(f"NO FIT: {drop.fault}")
    elif not drop.safe:
        parts.append("only in memory")
    elif drop.is_refined:
        parts.append("refining the fit")
    elif drop.withheld is not None:
        parts.append(f"no modulus: {text_of(drop.withheld)}")
    parts += map(text_of, drop.view.marks)
    if drop.curves_result is not None and drop.curves_result.explained is False:
        parts.append("unexplained")
    parts += [f"note: {note}" for note in drop.view.notes]
    if drop.view.identical is False:
        parts.append("stored traces differ from those recorded")
    if rebounds := drop.view.rebounds:
        loads = ", ".join(units.text("load", load, 2) for load in rebounds[:3])
        count = len(rebounds)
        parts.append(f"{count} rebound{'s'[: count > 1]} ({loads} {units.unit('load')})")
    return "; ".join(parts) if parts else "safe"


VERDICT_WORDS: dict[Verdict, tuple[str, TextRole]] = {
    Verdict.PASS: ("PASS", "good"),
    Verdict.FAIL: ("FAIL", "bad"),
    Verdict.UNDECIDED: ("UNDECIDED", "warn"),
}


def verdict_word(point: PointView) -> tuple[str, TextRole] | None:
    """Return the verdict on a point, or that it is pending; None: there is none."""
    if point.is_verdict_pending and point.progress.target is not None:
        return "PENDING", "strong"
    return VERDICT_WORDS.get(point.progress.verdict)


def point_summary(state: SessionState, point: PointView, units: Units, width: int) -> Line:
    """Return the judged value of a point and its verdict; other values follow as not judged."""
    progress = point.progress
    pieces = []
    judged = progress.value
    if judged is None:
        withheld = progress.withheld
        text = "nothing measured yet" if withheld is None else f"no modulus: {text_of(withheld)}"
        return fit([piece(0, cell(f"point: {text}", "dim"))], width)
    value = units.show(fact_of_value(judged))
    text = f"point: {judged.quantity.label} {value}, mean of {judged.drops}"
    pieces.append(piece(0, cell(text, "strong")))
    if UNSUPPORTED_MARK in text:
        pieces.append(piece(1, cell(f"{UNSUPPORTED_MARK} not supported", "warn")))
    if verdict := verdict_word(point):
        pieces.append(piece(0, cell(*verdict)))
        pieces.append(piece(3, cell(text_of(progress.verdict_reason))))
    if progress.modulus is not None:
        other = judged.quantity.other_fitted
        modulus = units.show(fact_of_modulus(progress.modulus, other))
        rank = 4 if judged.quantity.is_fitted else 2
        pieces.append(piece(rank, cell(f"not judged: {other.label} {modulus}", "dim")))
    return fit(pieces, width)
