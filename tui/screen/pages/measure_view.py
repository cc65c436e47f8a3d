"""Measure page as lines of text: status, instruction, last drop, point."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from pfwd.digits import MISSING, declared
from pfwd.facts import fact_of_value
from pfwd.message_groups import text_of
from pfwd.procedures import NO_PROCEDURE, PLAIN
from pfwd.session.live_trace import WINDOW, Envelope
from pfwd.units import Units
from tui.output import counted
from tui.screen.drawing.digits import (
    LETTER_ROWS,
    digit_lines,
    largest_size,
)
from tui.screen.drawing.drop_figures import drop_figures, live_figures
from tui.screen.drawing.glyphs import Glyphs
from tui.screen.drawing.lines import (
    Cell,
    Line,
    Piece,
    TextRole,
    both_ends,
    cell,
    fit,
    flow,
    join_blocks,
    line,
    pad,
    pad_rows,
    piece,
    shorten,
    table_lines,
    width_of,
    window,
    wrap,
)
from tui.screen.drawing.plot import Figure, plot_lines, stacked_plots
from tui.screen.drawing.profile import Bar, profile_lines
from tui.screen.pages.drop_texts import (
    assumption_texts,
    drop_columns,
    drop_row,
    ground_parameters,
    judged_value,
    modulus_of_drop,
    point_summary,
    verdict_of,
    verdict_word,
)
from tui.screen.pages.layer_texts import effective_text, has_layers, top_and_subgrade
from tui.screen.session.screen_drop import ScreenDrop
from tui.screen.session.state import SessionState
from tui.screen.session.stations import ReceiverStatus, lot_progress, next_station
from tui.screen.session.status import StatusWord

MEASURE_PLOTS = ("live", "load", "deflection", "residual")
"""Plots of a small terminal, which shows one at a time."""

MIN_DIGITS_WIDTH, MIN_DIGITS_HEIGHT = 64, 18
"""Smallest terminal with room for large digits and traces, columns and rows."""

FULL_WIDTH, FULL_HEIGHT = 100, 30
"""Smallest terminal that shows everything at once, columns and rows."""


@dataclass(frozen=True)
class MeasureView:
    """All that the measure page shows: the session, units, and what the operator chose."""

    state: SessionState
    word: StatusWord
    units: Units
    glyphs: Glyphs
    envelope: Envelope
    clock: str
    title: str
    keys: Sequence[tuple[str, str]]
    chosen: int | None = None
    """Number of the chosen drop; None: the newest."""
    panel: str = ""
    """One of MEASURE_PLOTS; empty: the deflection, or the live trace without one."""
    large: bool = False
    pace: str = ""
    """Speed of a replay in words."""
    message: str = ""
    """Last message."""
    verdict: str = ""
    """Sentence of the diagnosis of this point; empty: there is none."""
    position: ReceiverStatus | None = None
    """Position of the receiver; None: there is no receiver."""
    coordinates: tuple[float, float] | None = None
    """Present latitude and longitude, degrees."""

    @cached_property
    def drops(self) -> dict[int, ScreenDrop]:
        """Drops of the current point by their number."""
        return self.state.current_drops

    @cached_property
    def drop(self) -> ScreenDrop | None:
        """Drop on the page: the chosen one, else the newest."""
        if self.chosen is not None:
            return self.drops.get(self.chosen)
        return self.state.last


def measure_lines(view: MeasureView, width: int, height: int) -> list[Line]:
    """Return the measure page as exactly `height` lines of at most `width` columns."""
    summary = point_summary(view.state, view.state.current, view.units, width - 1)
    foot = [line(" ", *summary), key_line(view.keys, width)]
    top = [*head_lines(view, width), *_word_lines(view, width), *_procedure_lines(view, width)]
    room = height - len(top) - len(foot)
    full = width >= FULL_WIDTH and height >= FULL_HEIGHT
    tiny = width < MIN_DIGITS_WIDTH or height < MIN_DIGITS_HEIGHT
    body = _large(view, width, room) if view.large and not tiny else None
    body = _tiny(view, width, room) if tiny else body
    if is_point_complete(view) and room >= MIN_VERDICT_ROWS:
        body = complete_point_lines(view, width, room)
    if body is None:
        body = _full(view, width, room) if full else _small(view, width, room)
    return [pad(row, width) for row in [*top, *pad_rows(body, room), *foot]]


MIN_VERDICT_ROWS = 6
"""Smallest number of rows for a verdict in large letters."""


def is_point_complete(view: MeasureView) -> bool:
    """Return True if the point is complete and no drop of it is chosen.

    A session that ended after a complete point, as the demonstration does, counts too.
    """
    state, word = view.state, view.word.word
    ended = word == "END" and not state.recorded and bool(view.drops)
    complete = word == "POINT DONE" or (ended and state.progress.next_kind is None)
    return complete and view.chosen is None


def complete_point_lines(view: MeasureView, width: int, room: int) -> list[Line]:
    """Return the verdict on a complete point in large letters, and its reasons."""
    state, units = view.state, view.units
    progress = state.progress
    verdict = verdict_word(state.current)
    word, role = verdict or ("DONE", "strong")
    quantity = state.job.quantity.dimension
    judged = fact_of_value(progress.value)
    name = state.job.quantity.label
    text = f"no {name}" if progress.value is None else f"{name} {units.show(judged)}"
    drops = 0 if progress.value is None else progress.value.drops
    target = "no target"
    if progress.target is not None:
        side = "at most" if quantity == "settlement" else "at least"
        target = f"target {side} {units.with_unit(quantity, progress.target)}"
    texts = [text, target, f"mean of {counted(drops, 'drop')}"]
    pieces = [piece(rank, cell(text, "strong")) for rank, text in enumerate(texts)]
    facts = [line(" ", *row) for row in flow(pieces, width - 1, 2, "   ")]
    if verdict is not None:
        facts += [
            line(" ", cell(text, role))
            for text in wrap(text_of(progress.verdict_reason), width - 2)
        ]
    settled = [
        units.text("settlement", depth)
        for number, _, depth in progress.compaction
        if number in progress.used
    ]
    if settled:
        facts.append(line(f" settlement {', '.join(settled)} {units.unit('settlement')}"))
    facts += [line(" ", cell(text, "warn")) for text in advice_lines(view, width - 2)]
    if state.job.quantity.is_fitted:
        facts.append(model_line(state.last, view, width))
    facts = facts[: max(1, room - LETTER_ROWS - 1)]
    table = min(len(view.drops) + 1, max(0, (room - len(facts)) // 4))
    space = room - len(facts) - 1
    if table == 1 or space - table < MIN_ROWS_FOR_BOTH <= space:
        table = 0  # verdict and value in large letters matter more than the table
    rows = room - len(facts) - table
    plots = _figures(view) if width >= TRACES_WIDTH and rows >= TRACES_HEIGHT else []
    digits_width = width * 3 // 5 if plots else width
    value, _ = units.value_and_ends(judged)
    large = _verdict_digits((word, role), value, digits_width - 2, space - table)
    lines = pad_rows([(), *[(Cell(" "), *row) for row in large]], rows)
    if plots:
        traces = _stacked(plots, width - digits_width - 3, rows, view.glyphs)
        lines = join_blocks(lines, traces, digits_width, rows)
    return [*lines, *facts, *(drop_table(view, width, table) if table else ())]


TRACES_WIDTH, TRACES_HEIGHT = 160, 24
"""Smallest width of the terminal, and rows, for the traces of the last drop beside the verdict."""

MIN_ROWS_FOR_BOTH = 2 * LETTER_ROWS + 1
"""Rows of the verdict with the value below it in the smallest letters."""


def _verdict_digits(verdict: tuple[str, TextRole], value: str, width: int, rows: int) -> list[Line]:
    """Return verdict and judged value in large letters; with few rows side by side."""
    word, role = verdict
    if value == MISSING:
        return digit_lines(word, role, *(largest_size(word, width, rows) or (1, 1)))
    if rows < MIN_ROWS_FOR_BOTH:
        size = largest_size(f"{word} {value}", width, rows)
        if size is None:
            return digit_lines(word, role, *(largest_size(word, width, rows) or (1, 1)))
        words = digit_lines(f"{word} ", role, *size)
        numbers = digit_lines(value, "strong", *size)
        gap = Cell(" " * size[0])
        return [(*start, gap, *end) for start, end in zip(words, numbers, strict=True)]
    below = max(LETTER_ROWS, rows // 2 - 1)
    lines = digit_lines(word, role, *(largest_size(word, width, rows - below - 1) or (1, 1)))
    size = largest_size(value, width, below)
    return lines if size is None else [*lines, (), *digit_lines(value, "strong", *size)]


def head_lines(view: MeasureView, width: int) -> list[Line]:
    """Return the head of the page: survey, point and instrument."""
    state, device = view.state, view.state.device
    point = shorten(state.current.shown_name, 24 if width >= MIN_DIGITS_WIDTH else 10)
    title = shorten(view.title, max(3, min(30, width - 16 - width_of([cell(point)]))))
    name = line(cell(" PFWD  ", "strong"), title, " · point ", cell(point, "strong"))
    link: TextRole = "good" if device.connected else "warn"
    url = device.url.rsplit("/", 1)[-1]
    pieces: list[Piece] = []
    if state.device.serial_number or device.connected:
        mark = "● " if device.connected else "○ no link, "
        pieces += [
            piece(0, cell(mark, link), shorten(url, 24)),
            piece(4, f"SN {device.serial_number}"),
            piece(3, _rate(device.rate)),
            piece(1, cell(f"lost {device.lost_samples}", "bad" if device.lost_samples else "text")),
        ]
        if device.battery is not None:
            low = " LOW" if device.battery_low else ""
            pieces.append(piece(1 if low else 5, cell(f"battery {device.battery:.1f} V{low}")))
        if device.due is not None:
            pieces.append(piece(6, f"cal. until {device.due}"))
        if view.position is not None:
            quality: TextRole = "good" if view.position.is_good else "warn"
            pieces.append(piece(1, cell(view.position.fix, quality)))
            if view.position.place:
                pieces.append(piece(2, cell(view.position.place, quality)))
    elif view.pace:
        pieces = [piece(0, "○ recording")]
    else:
        pieces = [piece(0, cell("○ no instrument", "warn"))]
    if view.pace:
        pieces.append(piece(1, cell(view.pace, "strong")))
    separated = [
        Piece(line(cell("· ", "dim"), *part.cells) if place else part.cells, part.rank)
        for place, part in enumerate(pieces)
    ]
    instrument = fit(separated, 10_000, " ")
    if width_of(name) + width_of(instrument) + 2 <= width:
        return [both_ends(name, instrument, width)]
    return [name, line(" ", *fit(separated, width - 1, " "))]


def _rate(rate: float | None) -> str:
    if rate is None:
        return ""
    return f"{rate / 1e3:g} kHz" if rate >= 1e3 else f"{rate:g} Hz"


def _word_lines(view: MeasureView, width: int) -> list[Line]:
    """Return the status word and the instruction, on up to three lines."""
    word = view.word
    badge = cell(f" ▶ {word.word} ", word.role)
    room = width - width_of([badge]) - 2
    first, *more = wrap(word.action, room)
    head = (badge, Cell(" "), cell(first, "strong"))
    if more:
        rest = wrap(" ".join(more), width - 2)[:2]
        return [head, *[line(" ", cell(text, "strong")) for text in rest]]
    return [both_ends(head, (cell(view.clock),), width)]


def _procedure_lines(view: MeasureView, width: int) -> list[Line]:
    progress = view.state.progress
    parts = []
    for name, count, total in (
        ("seating", progress.seating_done, progress.seating_wanted),
        ("measured", progress.measured_done, progress.measured_wanted),
    ):
        if total != 0 or count:
            parts.append(piece(0, f"{name} ", _boxes(count, total)))
    target = progress.target
    quantity = view.state.job.quantity.dimension
    text = f"target {view.units.with_unit(quantity, target)}" if target else "no target"
    parts.append(piece(1, text))
    if view.state.procedure.name != PLAIN:
        name = view.state.procedure.name
        parts.append(piece(3, cell("no procedure" if name == NO_PROCEDURE.name else name, "dim")))
    parts += _lot_pieces(view)
    gap = "   " if width >= FULL_WIDTH else "  "
    parts_width = width_of(fit(parts, width - 1, gap))
    if view.message in view.word.action:  # the line above shows it
        return [(Cell(" "), *fit(parts, width - 1, gap))]
    if view.message and parts_width + len(view.message) + 4 <= width:
        parts.append(piece(4, cell(view.message, "warn")))
        return [(Cell(" "), *fit(parts, width - 1, gap))]
    lines: list[Line] = [(Cell(" "), *fit(parts, width - 1, gap))]
    if view.message:  # a sentence is never cut: it takes lines of its own
        lines += [line(" ", cell(text, "warn")) for text in wrap(view.message, width - 2)[:3]]
    return lines


def _lot_pieces(view: MeasureView) -> list[Piece]:
    """Return the progress of the lot and the next station."""
    state = view.state
    points = state.points.values()
    complete = {point.shown_name for point in points if point.progress.complete}
    progress = lot_progress(state.job, complete)
    if not progress:
        return []
    names = {point.shown_name for point in points}
    coming = next_station(state.job, names, view.coordinates, state.current.shown_name)
    pieces = [piece(1, progress)]
    if coming is not None:
        pieces.append(piece(2, cell(coming.text, "strong")))
    return pieces


def _boxes(count: int, total: int | None) -> Cell:
    if total is None:
        return cell(f"{count}", "strong")
    within, more = min(count, total), max(0, count - total)
    beyond = f" +{more}" if more else ""
    if total > 12:
        return cell(f"{within} of {total}{beyond}", "strong")
    marks = ["■" if place < within else "□" for place in range(total)]
    return cell(f"{' '.join(marks)} ({within}/{total}){beyond}", "strong")


def key_line(keys: Sequence[tuple[str, str]], width: int) -> Line:
    """Return the line of keys; the last keys are dropped without room."""
    return key_lines(keys, width, 1)[0]


def key_lines(keys: Sequence[tuple[str, str]], width: int, rows: int) -> list[Line]:
    """Return the keys on at most `rows` lines; the last keys are dropped without room."""
    pieces = [
        Piece((cell(key, "key"), Cell(f" {effect}")), rank)
        for rank, (key, effect) in enumerate(keys)
    ]
    return [(Cell(" "), *row) for row in flow(pieces, width - 1, rows, "  ")]


def _full(view: MeasureView, width: int, room: int) -> list[Line]:
    table_rows = min(len(view.drops) + 1, max(5, room // 4))
    live_rows = max(4, min(8, room // 6))
    rows = room - table_rows - live_rows - 1
    load, motion = live_figures(view.envelope, view.units, WINDOW)
    half = (width - 3) // 2
    live = join_blocks(
        plot_lines(load, half, live_rows, view.glyphs),
        plot_lines(motion, width - 3 - half, live_rows, view.glyphs),
        half,
        live_rows,
    )
    result_width = max(44, min(76, width * 2 // 5))
    plot_width = width - result_width - 3
    plots = _stacked(_figures(view), plot_width, rows, view.glyphs)
    result = _with_each_drop(view, result_lines(view, result_width, rows), result_width)
    both = join_blocks(plots, result, plot_width, rows)
    return [*live, *both, model_line(view.drop, view, width), *drop_table(view, width, table_rows)]


MIN_BAR_ROWS, MAX_BAR_ROWS = 8, 16
"""Rows of the bars of all drops: fewer are hard to read, more show nothing new."""


def _with_each_drop(view: MeasureView, lines: list[Line], width: int) -> list[Line]:
    """Add a bar for every drop of the point below the result, where there is room."""
    used = max((place for place, row in enumerate(lines, 1) if row), default=0)
    rows = min(MAX_BAR_ROWS, len(lines) - used - 1)
    drops = [drop for _, drop in sorted(view.drops.items()) if not drop.discarded]
    if rows < MIN_BAR_ROWS or len(drops) < 2:
        return lines
    job = view.state.job
    quantity = job.quantity.dimension
    title = f"{job.quantity.label} of each drop, {view.units.unit(quantity)}"
    bars = []
    for drop in drops:
        judged = drop.value()
        value = None if judged is None or drop.status == "rejected" else judged.value
        if job.quantity.is_fitted:
            value, _ = drop.fitted(job.quantity)
        role: TextRole = "dim" if drop.status == "seating" else "measured"
        chosen = view.drop is not None and drop.number == view.drop.number
        bars.append(Bar(str(drop.number), view.units.value(quantity, value), role, chosen))
    target = view.units.value(quantity, view.state.progress.target)
    chart = profile_lines(bars, width, rows, title, target)
    return pad_rows([*lines[:used], (), *chart], len(lines))


def _small(view: MeasureView, width: int, room: int) -> list[Line]:
    table_rows = max(2, min(len(view.drops) + 1, 5, room // 4 + 1))
    advice = [line(" ", cell(row, "warn")) for row in advice_lines(view, width - 2)]
    panel_rows = max(0, room - table_rows - LETTER_ROWS - 2 - len(advice))
    result = result_lines(view, width, LETTER_ROWS + 1, wide=True)
    lines = [*result, *advice, model_line(view.drop, view, width)]
    if panel_rows >= 4:
        lines += _single_plot(view, width, panel_rows)
    return [*lines, *drop_table(view, width, table_rows)]


def _tiny(view: MeasureView, width: int, room: int) -> list[Line]:
    """Return the page for a terminal that has room for the numbers only."""
    value = view.units.show(judged_value(view.state, view.drop))
    lines = [line(cell(f" {view.state.job.quantity.label} {value}", "strong"))]
    lines += [line(" ", *row) for row in _verdict_lines(view, width - 1)]
    lines.append(model_line(view.drop, view, width))
    return [*lines, *drop_table(view, width, max(2, room - len(lines)))]


def _large(view: MeasureView, width: int, room: int) -> list[Line] | None:
    """Return the page in large type: the result as large as the terminal allows."""
    drop = view.drop
    if room < LETTER_ROWS + 4:
        return None
    table_rows = min(4, room - LETTER_ROWS - 4)
    verdict = _verdict_lines(view, width - 1)
    space = room - table_rows - 2 - max(2, len(verdict))
    value, ends = view.units.value_and_ends(judged_value(view.state, drop))
    digits = _large_number(value, ends, width - 2, space)
    lines: list[Line] = [(Cell(" "), *row) for row in digits]
    quantity = view.state.job.quantity
    name = "" if quantity.is_fitted else f"  {quantity.label}"
    lines.append(line(cell(f" {_unit_text(view, drop)}{name}", "strong")))
    lines += [line(" ", *row) for row in verdict]
    lines = [*pad_rows(lines, room - table_rows - 1), model_line(drop, view, width)]
    return [*lines, *drop_table(view, width, table_rows)]


def _figures(view: MeasureView) -> list[Figure]:
    return [] if view.drop is None else drop_figures(view.drop, view.units)


def _stacked(figures: Sequence[Figure], width: int, rows: int, glyphs: Glyphs) -> list[Line]:
    if not figures:
        text = "  no traces yet: they come with the first drop"
        return pad_rows([(), line(cell(text, "dim"))], rows)
    return stacked_plots(figures, width, rows, glyphs, shares=(3, 4, 3))


def _single_plot(view: MeasureView, width: int, rows: int) -> list[Line]:
    figures = {figure.name: figure for figure in _figures(view)}
    panel = view.panel or ("live" if not figures else "deflection")
    if panel == "live" or panel not in figures:
        figure = live_figures(view.envelope, view.units, WINDOW)[0]
    else:
        figure = figures[panel]
    return plot_lines(figure, width, rows, view.glyphs)


def result_lines(view: MeasureView, width: int, rows: int, *, wide: bool = False) -> list[Line]:
    """Return the judged value of a drop in large digits, with its details and verdict."""
    drop = view.drop
    quantity = view.state.job.quantity
    value, ends = view.units.value_and_ends(judged_value(view.state, drop))
    details = _details(view, drop)
    if wide:
        digits = [()] * LETTER_ROWS if value == MISSING else digit_lines(value, "strong", 2, 1)
        digits_width = max(width_of(row) for row in digits) + 2
        side = width - digits_width - 3
        unit = fit(
            [
                piece(0, cell(_unit_text(view, drop, short=True), "strong")),
                Piece(_refining(drop), 1),
            ],
            side,
        )
        verdict = _verdict_lines(view, side, advice=False)[: rows - 1]
        text = [unit, *[fit([piece(0, cell(detail, "dim"))], side) for detail in details]]
        text = [*text[: rows - len(verdict)], *verdict]
        return join_blocks([line(" ", *row) for row in digits], text, digits_width, rows, "  ")
    layered = quantity.is_fitted and drop is not None and has_layers(drop.result)
    name = "modulus of the subgrade" if layered else quantity.label
    title = name if drop is None else f"{name}, drop {drop.number}"
    if quantity.is_fitted and drop is not None and drop.is_diagnosed:
        title = f"{name}, by the diagnosis of all drops"
    verdict = _verdict_lines(view, width)
    unit_rows = wrap(_unit_text(view, drop), width)
    used = len(details) + len(verdict) + len(unit_rows) + 1
    space = max(LETTER_ROWS, rows - used)
    lines: list[Line] = [line(cell(title, "dim"), *_refining(drop))]
    lines += _large_number(value, ends, width, space)
    lines += [line(cell(row, "strong")) for row in unit_rows]
    for detail in details:
        rows_of_detail = [detail] if len(detail) <= width else wrap(detail, width)
        lines += [line(cell(row, "dim")) for row in rows_of_detail]
    room = rows - len(lines)
    return pad_rows([*lines, *verdict[: max(0, room)]], rows)


def _unit_text(view: MeasureView, drop: ScreenDrop | None, *, short: bool = False) -> str:
    """Return the unit of the large digits and the interval."""
    fact, quantity = judged_value(view.state, drop), view.state.job.quantity
    unit, (value, ends) = view.units.unit(fact.quantity), view.units.value_and_ends(fact)
    if value == MISSING:
        if quantity.is_fitted and drop is not None and drop.withheld is not None:
            return f"no modulus: {text_of(drop.withheld)}"
        return "no result yet" if quantity.is_fitted else f"no {quantity.label} yet"
    if not quantity.is_fitted:
        return f"{unit}  {quantity.label}" if short else unit
    text = f"{ends}, 95 %" if short else f"{ends}; 95 %, model error included"
    return f"{unit} ({text})" if ends else unit


def _large_number(value: str, ends: str, width: int, rows: int) -> list[Line]:
    """Return a value as large as possible, and the interval below it where that fits as well."""
    if value == MISSING:  # a dash of blocks would look like a result
        return [()] * LETTER_ROWS
    size = largest_size(value, width, rows) or (1, 1)
    lines = digit_lines(value, "strong", *size)
    space = rows - len(lines) - 1
    below = largest_size(ends, width, min(space, len(lines) // 2)) if ends else None
    return lines if below is None else [*lines, (), *digit_lines(ends, "strong", *below)]


def _refining(drop: ScreenDrop | None) -> Line:
    if drop is None or not drop.is_refined:
        return ()
    return (cell("  first result, refining", "warn"),)


def _details(view: MeasureView, drop: ScreenDrop | None) -> list[str]:
    """Return the parameters of the ground, and the modulus where another value is judged.

    The drop page has all further moduli: one number is in force here.
    """
    result = drop.result if drop is not None else None
    if drop is None or result is None:
        return []
    units = view.units
    lines = top_and_subgrade(result, units)
    if lines:
        lines.append(effective_text(result, units))
    if drop.modulus is not None:
        other = view.state.job.quantity.other_fitted
        lines.insert(0, f"not judged: {other.label} {units.show(modulus_of_drop(drop, other))}")
        parameters = {} if drop.is_diagnosed else ground_parameters(result, units)
        for name, text in parameters.items():
            lines.append(f"{name:9} {text}")
    return [text for text in lines if text]


def _verdict_lines(view: MeasureView, width: int, *, advice: bool = True) -> list[Line]:
    text, role = verdict_of(view.drop, view.verdict)
    lines = [line(cell(row, role)) for row in wrap(text, width)]
    return (
        lines
        if not advice
        else [*lines, *[line(cell(row, "warn")) for row in advice_lines(view, width)]]
    )


def advice_lines(view: MeasureView, width: int) -> list[str]:
    """Return the advice on the chosen drop and on the point."""
    return [row for text in view.state.advice(view.drop) for row in wrap(f"→ {text}", width)]


def model_line(drop: ScreenDrop | None, view: MeasureView, width: int) -> Line:
    """Return the line with model, plate, Poisson's ratio, method and load of a fit."""
    result = drop.result if drop is not None else None
    if result is None or result.modulus_pa is None:
        return ()
    ground, plate, method, load = assumption_texts(result, view.units)
    if drop is not None and drop.is_diagnosed:
        ground = "diagnosis of all drops"
    pieces = [
        piece(0, cell(f" {ground}", "dim")),
        piece(0, cell(plate, "dim")),
        piece(0, cell(f"Poisson's ratio {declared(result.poisson_ratio)}", "dim")),
        piece(1, cell(method, "dim")),
        piece(2, cell(load, "dim")),
    ]
    return flow(pieces, width, 1, ", ")[0]


def drop_table(view: MeasureView, width: int, rows: int) -> list[Line]:
    """Return the table of the drops of the point, newest last."""
    drops = [drop for _, drop in sorted(view.drops.items())]
    place = next((at for at, drop in enumerate(drops) if drop.number == view.chosen), None)
    table = [
        drop_row(view.state, drops[at], view.units, chosen=drops[at].number == view.chosen)
        for at in window(len(drops), place, max(1, rows - 1))
    ]
    if not table:
        return pad_rows([line(cell(" no drops at this point yet", "dim"))], rows)
    columns = drop_columns(view.state.job.quantity, view.units)
    return pad_rows(table_lines(columns, table, width), rows)
