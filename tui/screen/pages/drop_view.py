"""Drop page as lines of text."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pfwd.analysis.results import DiagnosisResult, DropResult
from pfwd.analysis.screening.drops import channels_outward
from pfwd.digits import MISSING, declared, significant
from pfwd.facts import facts_of_drop, facts_of_state
from pfwd.message_groups import text_of
from pfwd.units import Units, percent
from tui.diagnosis_lines import diagnosis_lines, diagnosis_sentence
from tui.format import word
from tui.screen.drawing.drop_figures import (
    bowl_figure,
    curves_of,
    drop_figures,
    spectrum_figure,
)
from tui.screen.drawing.glyphs import Glyphs
from tui.screen.drawing.lines import (
    Line,
    TextRole,
    cell,
    fit,
    head_with_message,
    join_blocks,
    line,
    pad,
    pad_rows,
    piece,
    shorten,
    wrap,
)
from tui.screen.drawing.plot import plot_lines, stacked_plots
from tui.screen.pages.drop_texts import (
    METHOD_TEXTS,
    assumption_texts,
    ground_parameters,
    remark,
    verdict_of,
)
from tui.screen.pages.layer_texts import effective_text, has_layers, layer_lines, sensor_lines
from tui.screen.pages.measure_view import key_line
from tui.screen.session.screen_drop import ScreenDrop
from tui.screen.session.screen_events import Refit
from tui.screen.session.state import SessionState

FIGURE_NAMES = ("load", "deflection", "residual", "spectrum", "bowl")
MIN_TWO_COLUMNS = 100
MIN_PLOT_ROWS = 6
"""Smallest height of a plot, rows."""


@dataclass(frozen=True, slots=True)
class DropPageState:
    """All that the drop page shows: the drop, units, and what the operator chose."""

    drop: ScreenDrop | None
    state: SessionState
    units: Units
    glyphs: Glyphs
    message: str
    keys: Sequence[tuple[str, str]]
    refit: Refit | None = None
    span: tuple[float, float] | None = None
    cursor: float | None = None
    panel: str = ""
    sensor: int = 0
    first: int = 0
    busy: str = ""

    @property
    def result(self) -> DropResult:
        """Result on the page; without one an empty result."""
        if self.refit is not None:
            return self.refit.result or DropResult()
        return (self.drop and self.drop.curves_result) or DropResult()


def drop_lines(view: DropPageState, width: int, height: int) -> list[Line]:
    """Return the drop page as exactly `height` lines."""
    drop = view.drop
    if drop is None:
        body = [(), line(cell(" there is no drop yet", "dim"))]
        return [*pad_rows(body, height - 1), key_line(view.keys, width)]
    title = _title(view, drop, width)
    head = [
        *head_with_message(title, view.message or view.busy, width),
        *_verdict(view, drop, width),
    ]
    foot = [_cursor_line(view, drop, width), key_line(view.keys, width)]
    room = height - len(head) - len(foot)
    if width >= MIN_TWO_COLUMNS:
        text_width = max(46, width * 2 // 5)
        plot_width = width - text_width - 3
        text = text_lines(view, drop, text_width)
        first = min(view.first, max(0, len(text) - room))
        plots = _plots(view, drop, plot_width, room)
        body = join_blocks(plots, _part(text, first, room), plot_width, room)
    else:
        text = text_lines(view, drop, width - 1)
        rows = max(MIN_PLOT_ROWS, room // 2)
        first = min(view.first, max(0, len(text) - (room - rows)))
        lower = [line(" ", *row) for row in _part(text, first, room - rows)]
        body = [*_plots(view, drop, width, rows), *pad_rows(lower, room - rows)]
    return [pad(row, width) for row in [*head, *pad_rows(body, room), *foot]]


def _part(text: Sequence[Line], first: int, rows: int) -> list[Line]:
    """Return `rows` lines from `first` on; if more follow, the last one names the key for them."""
    part = list(text[first : first + rows])
    if len(text) > first + rows and part:
        part[-1] = line(cell("... pagedown shows more", "dim"))
    return part


def _title(view: DropPageState, drop: ScreenDrop, width: int) -> Line:
    name = shorten(drop.owner.shown_name, 24)
    role: TextRole = "bad" if drop.status == "rejected" else "text"
    kind = drop.edited_word or drop.status
    which = "result in force" if view.refit is None else f"trial fit: {view.refit.label}"
    pieces = [
        piece(0, cell(f" Drop {drop.number} of point {name} ", "title")),
        piece(1, cell(kind, role)),
        piece(2, cell(shorten(which, 40), "strong")),
    ]
    return fit(pieces, width)


def _verdict(view: DropPageState, drop: ScreenDrop, width: int) -> list[Line]:
    diagnosed = "" if drop.diagnosed is None else diagnosis_sentence(drop.diagnosed, view.units)
    text, role = verdict_of(drop, diagnosed)
    if view.refit is not None and view.refit.result is not None:
        trial = replace_result(drop, view.refit.result)
        text, role = verdict_of(trial)
    return [line(" ", cell(row, role)) for row in wrap(text, width - 2)[:2]]


def replace_result(drop: ScreenDrop, result: DropResult) -> ScreenDrop:
    """Return a drop with another result in force."""
    return replace(drop, view=drop.view.with_result(result))


def _plots(view: DropPageState, drop: ScreenDrop, width: int, rows: int) -> list[Line]:
    traces = drop_figures(drop, view.units, view.span, view.sensor, view.refit)
    spectrum = spectrum_figure(drop, view.units, view.sensor, view.refit)
    bowl = bowl_figure(drop, view.units, view.refit)
    everything = [*traces, *(figure for figure in (spectrum, bowl) if figure is not None)]
    if not everything:
        text = "no traces in memory; they are being read from the survey"
        return pad_rows([(), line(cell(f"  {text}", "dim"))], rows)
    cursor = None if view.cursor is None else 1e3 * view.cursor
    marked = [
        replace(figure, cursor=cursor) if figure.time_unit == "ms" else figure
        for figure in everything
    ]
    by_name = {figure.name: figure for figure in marked}
    if view.panel in by_name:
        return plot_lines(replace(by_name[view.panel], time_axis=True), width, rows, view.glyphs)
    count = max(1, min(len(marked), rows // MIN_PLOT_ROWS))
    if count == 1:
        name = "deflection" if "deflection" in by_name else next(iter(by_name))
        return plot_lines(replace(by_name[name], time_axis=True), width, rows, view.glyphs)
    return stacked_plots(marked[:count], width, rows, view.glyphs)


def _cursor_line(view: DropPageState, drop: ScreenDrop, width: int) -> Line:
    if view.cursor is None:
        return line(cell(" left and right move a cursor that shows the values", "dim"))
    units = view.units
    pieces = [piece(0, cell(f" at {1e3 * view.cursor:.2f} ms", "cursor"))]
    curves, _ = curves_of(drop, view.refit)
    if curves is not None:
        sensor = min(view.sensor, len(curves.offsets) - 1)
        place = int(np.argmin(np.abs(curves.time - view.cursor)))
        observed, predicted = curves.observed[sensor][place], curves.predicted[sensor][place]
        pieces += [
            piece(1, f"load {units.with_unit('load', float(curves.load[place]), 4)}"),
            piece(1, f"measured {units.with_unit('deflection', float(observed), 4)}"),
            piece(3, f"fitted {units.with_unit('deflection', float(predicted), 4)}"),
            piece(2, f"residual {units.with_unit('deflection', float(predicted - observed))}"),
        ]
    elif drop.saved is not None and drop.saved.drop.time.size:
        place = int(np.argmin(np.abs(drop.saved.drop.time - view.cursor)))
        pieces.append(
            piece(1, f"load {units.with_unit('load', float(drop.saved.drop.load[place]))}")
        )
    return fit(pieces, width)


def text_lines(view: DropPageState, drop: ScreenDrop, width: int) -> list[Line]:
    """Return the text of the page: parameters, fit, sensors, record, results, causes."""
    result = view.result
    lines: list[Line] = []
    if drop.status == "rejected" and not drop.moved_to:
        lines += _paragraph(f"rejected: {drop.reason or 'no result'}", width, "bad")
    if result.modulus_pa is not None:
        lines += _parameters(view, result, width)
    elif view.refit is None and drop.diagnosed is not None:
        lines += _diagnosed_ground(drop.diagnosed, view.units, width)
    lines += layer_lines(result, view.units, width)
    if result.modulus_pa is not None:
        lines += _fit_lines(view, result, width)
    if drop.saved is not None:
        recorded = [channel.offset for channel in channels_outward(drop.saved.drop)]
        lines += sensor_lines(curves_of(drop, view.refit)[0], recorded, view.units)
    lines += _warnings(result, width)
    lines += _heading("record")
    lines += _paragraph(remark(drop, view.units), width)
    if drop.saved is not None:
        count = len(drop.saved.drop.channels)
        sensors = "sensor" if count == 1 else "sensors"
        samples = len(drop.saved.drop.time)
        length = f"{drop.saved.drop.sampling_rate:g} Hz, {samples} samples" if samples else "peaks"
        lines += _paragraph(f"{count} {sensors}, {length}", width)
        if drop.saved.file:
            lines += _paragraph(Path(drop.saved.file).name, width, "dim")
    if drop.memory.delay is not None:
        lines += _paragraph(f"first modulus {drop.memory.delay:.2f} s after the last sample", width)
    lines += _alternatives(view, drop, width)
    lines += _effects(view, drop, width)
    return lines


def _heading(text: str) -> list[Line]:
    return [line(cell(text, "strong"))]


def _paragraph(text: str, width: int, role: TextRole = "text") -> list[Line]:
    return [line(cell(row, role)) for row in wrap(text, width)]


def _parameters(view: DropPageState, result: DropResult, width: int) -> list[Line]:
    units = view.units
    facts = facts_of_drop(result)
    modulus = units.show(facts["modulus"])
    lines = _heading("ground")
    name = "subgrade" if has_layers(result) else "modulus"
    lines += _paragraph(f"{name:10} {modulus}", width, "strong")
    if result.modulus_interval_pa is not None:
        lines += _paragraph("95 %, with the error of the model", width)
    bounds = result.at_bound or ()
    for name, text in ground_parameters(result, units).items():
        mark = "  AT THE LIMIT" if any(name in bound for bound in bounds) else ""
        lines.append(line(f"{name:10} {text}", cell(mark, "bad")))
    correlation = result.modulus_depth_correlation
    if correlation is not None and math.isfinite(correlation):
        text = f"correlation of the errors of modulus and depth {correlation:+z.2f}"
        lines += _paragraph(text, width)
    peak = units.show(facts["peak modulus"])
    factor = significant(result.peak_factor, 3)
    text = f"for comparison: modulus from the peaks {peak}, factor {factor}"
    lines += _paragraph(text, width, "dim")
    return lines


def _diagnosed_ground(diagnosis: DiagnosisResult, units: Units, width: int) -> list[Line]:
    """Return the ground by a diagnosis that counts, and its residual over all drops."""
    after = diagnosis.after
    assert after is not None  # its modulus counts
    lines = _heading("ground, by the diagnosis of all drops")
    for name, fact in facts_of_state(after).items():
        if (text := units.show(fact)) != MISSING:
            role: TextRole = "strong" if name == "modulus" else "text"
            lines += _paragraph(f"{name:10} {text}", width, role)
    return lines + _paragraph(
        f"residual {percent(after.residual_rms_over_peak)} of the peak, "
        f"{percent(after.contact_residual_rms_over_peak)} in contact",
        width,
    )


def _fit_lines(view: DropPageState, result: DropResult, width: int) -> list[Line]:
    units = view.units
    ratio = declared(result.poisson_ratio)
    ground, plate, method, load = assumption_texts(result, units)
    lines = _heading("model and fit")
    text = (
        f"{ground}, {plate}, Poisson's ratio {ratio}, {load}, {method}, random seed {result.seed}"
    )
    lines += _paragraph(text, width)
    lines += _paragraph(
        f"residual {percent(result.residual_rms_over_peak)} of the peak, "
        f"{percent(result.contact_residual_rms_over_peak)} in contact; R² "
        f"{significant(result.r_squared, 5)}; noise "
        f"{units.with_unit('deflection', result.noise_rms_m, 2)}",
        width,
    )
    pulse = result.half_sine
    if pulse is not None:
        pressure = units.with_unit("pressure", pulse.peak_pressure_pa)
        duration = significant(1e3 * (pulse.duration_s or math.nan))
        rms = percent(pulse.rms_over_peak)
        lines += _paragraph(f"half-sine {pressure}, {duration} ms, load off by {rms}", width)
    state = "search finished" if result.converged else "SEARCH NOT FINISHED"
    seconds = significant(result.elapsed_s, 2)
    solves = result.forward_solves
    lines += _paragraph(f"{state}: {solves} evaluations of the model in {seconds} s", width)
    return lines


def _warnings(result: DropResult, width: int) -> list[Line]:
    lines: list[Line] = []
    for warning in result.warnings:
        lines += _paragraph(f"warning: {text_of(warning)}", width, "warn")
    return lines


def _alternatives(view: DropPageState, drop: ScreenDrop, width: int) -> list[Line]:
    lines = _heading("results")
    kind = "in force" if drop.diagnosed is None else "without effects"
    in_force = [] if drop.result is None else [(kind, drop.result)]
    results = drop.memory.results if drop.withheld is None else ()
    earlier = [("before it", result) for result in results[:-1]]
    units = view.units
    for kind, result in [*in_force, *earlier]:
        method = word(METHOD_TEXTS, result.method)
        lines += _paragraph(f"{_short_result(result, units)}, {method} ({kind})", width)
    for refit in drop.memory.refits:
        if refit.result is not None:
            mark: TextRole = "strong" if refit is view.refit else "text"
            lines += _paragraph(f"{_short_result(refit.result, units)}, {refit.label}", width, mark)
    return lines if len(lines) > 1 else []


def _short_result(result: DropResult, units: Units) -> str:
    modulus = result.modulus_pa
    if modulus is None:
        open_below = effective_text(result, units) if has_layers(result) else ""
        return open_below or text_of(result.reason) or "no modulus"
    text = units.show(facts_of_drop(result)["modulus"])
    return f"{text}, residual {percent(result.residual_rms_over_peak)}"


def _effects(view: DropPageState, drop: ScreenDrop, width: int) -> list[Line]:
    diagnosis = view.state.diagnoses.get(drop.saved.file) if drop.saved is not None else None
    lines = _heading("causes of the residual")
    if diagnosis is not None and diagnosis.error:
        return [*lines, *_paragraph(diagnosis.error, width, "bad")]
    results = [drop.diagnosed] if diagnosis is None else diagnosis.results
    if results == [None]:
        return [*lines, *_paragraph("v looks for them; it takes some seconds", width, "dim")]
    for result in filter(None, results):
        for text in diagnosis_lines(result)[1:]:
            lines += _paragraph(text.strip(), width)
    return lines
