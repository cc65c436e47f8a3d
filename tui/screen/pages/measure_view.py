"""The measure page as lines of text: what happens, what to do, the last drop, the point."""

from collections.abc import Sequence
from dataclasses import dataclass

from pfwd.procedures import NO_PROCEDURE, PLAIN, Quantity
from pfwd.session.live_trace import WINDOW, Envelope
from tui.output import counted
from tui.screen.drawing.digits import (
    BLOCK_SIZES,
    LETTER_ROWS,
    digit_lines,
    digit_width,
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
    QUANTITY_NAMES,
    VERDICTS,
    Judged,
    beside_modulus,
    drop_columns,
    drop_row,
    judged_of,
    modulus_text,
    plain,
    point_summary,
    point_value_text,
    verdict_of,
)
from tui.screen.pages.layer_texts import effective_text, has_layers, top_and_subgrade
from tui.screen.session.drop_state import DropState
from tui.screen.session.state import SessionState
from tui.screen.session.stations import ReceiverStatus, lot_progress, next_station
from tui.screen.session.status import StatusWord
from tui.screen.units import NO_VALUE, Units, judged_quantity

PANELS = ("live", "load", "deflection", "residual")
"""What the one plot of a small terminal shows in turn."""

NARROW, LOW = 64, 18
"""Columns and rows below which there is no room for large figures and traces."""

WIDE, TALL = 100, 30
"""Columns and rows from which on everything is shown at once."""


@dataclass(frozen=True, slots=True)
class MeasureView:
    """What the page needs beside the state."""

    state: SessionState
    word: StatusWord
    units: Units
    glyphs: Glyphs
    envelope: Envelope
    clock: str
    title: str
    keys: Sequence[tuple[str, str]]
    chosen: int | None = None
    """Number of the drop that is looked at; None: the newest."""
    panel: str = ""
    """One of PANELS; empty: what fits the moment."""
    large: bool = False
    pace: str = ""
    """Of a replay."""
    message: str = ""
    """The last thing that was said."""
    verdict: str = ""
    """Of the diagnosis of this point, when it was made."""
    position: ReceiverStatus | None = None
    """What the receiver says; None: there is none."""
    coordinates: tuple[float, float] | None = None
    """Latitude and longitude now, degrees."""

    @property
    def drops(self) -> dict[int, DropState]:
        """Drops of the current point by their number."""
        return self.state.current_drops

    @property
    def drop(self) -> DropState | None:
        """The drop that is looked at."""
        if self.chosen is not None:
            return self.drops.get(self.chosen)
        return self.state.last


def measure_lines(view: MeasureView, width: int, height: int) -> list[Line]:
    """The page as exactly `height` lines of `width` columns at most."""
    foot = [_mean_line(view, width), key_line(view.keys, width)]
    top = [*head_lines(view, width), *_word_lines(view, width), *_procedure_lines(view, width)]
    room = height - len(top) - len(foot)
    full = width >= WIDE and height >= TALL
    tiny = width < NARROW or height < LOW
    body = _large(view, width, room) if view.large and not tiny else None
    body = _tiny(view, width, room) if tiny else body
    if is_done(view) and room >= LEAST_DONE:
        body = done_lines(view, width, room)
    if body is None:
        body = _full(view, width, room) if full else _small(view, width, room)
    return [pad(row, width) for row in [*top, *pad_rows(body, room), *foot]]


LEAST_DONE = 6
"""Rows below which there is no room for a verdict in large letters."""


def is_done(view: MeasureView) -> bool:
    """Whether the point is done, and nobody looks at one of its drops.

    Also when the instrument has ended after it, as a demonstration does.
    """
    state, word = view.state, view.word.word
    ended = word == "END" and not state.recorded and bool(view.drops)
    complete = word == "POINT DONE" or (ended and state.progress.next_kind is None)
    return complete and view.chosen is None


def done_lines(view: MeasureView, width: int, room: int) -> list[Line]:
    """How the point stands, in letters that are read from afar, and what that rests on."""
    state, units = view.state, view.units
    progress = state.progress
    word, role = VERDICTS.get(progress.verdict, ("DONE", "strong"))
    value, error, unit = point_value_text(progress, units)
    quantity = judged_quantity(state.job.quantity)
    name = QUANTITY_NAMES[state.job.quantity]
    drops = 0 if progress.value is None else progress.value.drops
    target = "no target"
    if progress.target is not None:
        side = "at most" if quantity == "settlement" else "at least"
        target = f"target {side} {units.with_unit(quantity, progress.target)}"
    sure = f" ± {error}" if error else ""
    said = [f"{name} {value}{sure} {unit}", target, f"mean of {counted(drops, 'drop')}"]
    pieces = [piece(rank, cell(text, "strong")) for rank, text in enumerate(said)]
    facts = [line(" ", *row) for row in flow(pieces, width - 1, 2, "   ")]
    if progress.verdict in VERDICTS:
        facts += [line(" ", cell(text, role)) for text in wrap(progress.verdict_reason, width - 2)]
    settled = [
        units.text("settlement", depth)
        for number, _, depth in progress.compaction
        if number in progress.used
    ]
    if settled:
        facts.append(line(f" settlement {', '.join(settled)} {units.unit('settlement')}"))
    facts += [line(" ", cell(text, "warn")) for text in advice_lines(view, width - 2)]
    if state.job.quantity is Quantity.MODULUS:
        facts.append(footnote(state.last, view, width))
    facts = facts[: max(1, room - LETTER_ROWS - 1)]
    table = min(len(view.drops) + 1, max(0, (room - len(facts)) // 4))
    space = room - len(facts) - 1
    if space - table < BOTH_ROWS <= space:
        table = 0  # word and value are read from afar, the table is not
    large = _verdict_digits((word, role), (value, error), width - 2, space - table)
    lines = pad_rows([(), *[(Cell(" "), *row) for row in large]], room - len(facts) - table)
    return [*lines, *facts, *(drop_table(view, width, table) if table > 1 else [()] * table)]


BOTH_ROWS = 2 * LETTER_ROWS + 1
"""The verdict and the value below it, in the smallest figures."""


def _verdict_digits(
    verdict: tuple[str, TextRole], judged: tuple[str, str], width: int, rows: int
) -> list[Line]:
    """The verdict in large letters and what is judged: below it, or beside it on a low terminal."""
    word, role = verdict
    value, error = judged
    if value == NO_VALUE:
        return digit_lines(word, role, *(largest_size(word, width, rows) or (1, 1)))
    figures = f"{value} ±{error}" if error else value
    if rows < BOTH_ROWS:
        size = largest_size(f"{word} {value}", width, rows)
        if size is None:
            return digit_lines(word, role, *(largest_size(word, width, rows) or (1, 1)))
        beside_it = figures if digit_width(f"{word} {figures}", size[0]) <= width else value
        left = digit_lines(f"{word} ", role, *size)
        right = digit_lines(beside_it, "strong", *size)
        gap = Cell(" " * size[0])
        return [(*one, gap, *other) for one, other in zip(left, right, strict=True)]
    below = max(LETTER_ROWS, rows // 2 - 1)
    lines = digit_lines(word, role, *(largest_size(word, width, rows - below - 1) or (1, 1)))
    under = largest_size(figures, width, below) or largest_size(value, width, below)
    if under is None:
        return lines
    shown = figures if digit_width(figures, under[0]) <= width else value
    return [*lines, (), *digit_lines(shown, "strong", *under)]


def head_lines(view: MeasureView, width: int) -> list[Line]:
    """Survey, point and device."""
    state, device = view.state, view.state.device
    point = shorten(state.current.shown_name, 24 if width >= NARROW else 10)
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
            sure: TextRole = "good" if view.position.is_good else "warn"
            pieces.append(piece(1, cell(view.position.fix, sure)))
            if view.position.place:
                pieces.append(piece(2, cell(view.position.place, sure)))
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
    whole = fit(separated, 10_000, " ")
    if width_of(name) + width_of(whole) + 2 <= width:
        return [both_ends(name, whole, width)]
    return [name, line(" ", *fit(separated, width - 1, " "))]


def _rate(rate: float | None) -> str:
    if rate is None:
        return ""
    return f"{rate / 1e3:g} kHz" if rate >= 1e3 else f"{rate:g} Hz"


def _word_lines(view: MeasureView, width: int) -> list[Line]:
    """The word and what to do; an alarm is never cut, it takes another line."""
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
    for name, done, whole in (
        ("seating", progress.seating_done, progress.seating_wanted),
        ("measured", progress.measured_done, progress.measured_wanted),
    ):
        if whole != 0 or done:
            parts.append(piece(0, f"{name} ", _boxes(done, whole)))
    target = progress.target
    quantity = judged_quantity(view.state.job.quantity)
    wanted = f"target {view.units.with_unit(quantity, target)}" if target else "no target"
    parts.append(piece(1, wanted))
    if view.state.procedure.name != PLAIN:
        name = view.state.procedure.name
        parts.append(piece(3, cell("no procedure" if name == NO_PROCEDURE.name else name, "dim")))
    parts += _lot_pieces(view)
    gap = "   " if width >= WIDE else "  "
    parts_width = width_of(fit(parts, width - 1, gap))
    if view.message in view.word.action:  # it stands above already
        return [(Cell(" "), *fit(parts, width - 1, gap))]
    if view.message and parts_width + len(view.message) + 4 <= width:
        parts.append(piece(4, cell(view.message, "warn")))
        return [(Cell(" "), *fit(parts, width - 1, gap))]
    lines: list[Line] = [(Cell(" "), *fit(parts, width - 1, gap))]
    if view.message:  # a sentence is never cut: it takes lines of its own for a while
        lines += [line(" ", cell(text, "warn")) for text in wrap(view.message, width - 2)[:3]]
    return lines


def _lot_pieces(view: MeasureView) -> list[Piece]:
    """How much of the lot is measured, and where the next station is."""
    state = view.state
    points = state.points.values()
    complete = {point.shown_name for point in points if point.progress.complete}
    progress = lot_progress(state.job, complete)
    if not progress:
        return []
    names = {point.shown_name for point in points}
    coming = next_station(state.job, names, view.coordinates, state.current.shown_name)
    found = [piece(1, progress)]
    if coming is not None:
        found.append(piece(2, cell(coming.text, "strong")))
    return found


def _boxes(done: int, whole: int | None) -> Cell:
    if whole is None:
        return cell(f"{done}", "strong")
    counted, more = min(done, whole), max(0, done - whole)
    beyond = f" +{more}" if more else ""
    if whole > 12:
        return cell(f"{counted} of {whole}{beyond}", "strong")
    marks = ["■" if place < counted else "□" for place in range(whole)]
    return cell(f"{' '.join(marks)} ({counted}/{whole}){beyond}", "strong")


def key_line(keys: Sequence[tuple[str, str]], width: int) -> Line:
    """What can be pressed; the last ones give way first."""
    pieces = [
        Piece((cell(key, "key"), Cell(f" {what}")), rank) for rank, (key, what) in enumerate(keys)
    ]
    return (Cell(" "), *fit(pieces, width - 1, "  "))


def _full(view: MeasureView, width: int, room: int) -> list[Line]:
    rows_wanted = min(len(view.drops) + 1, max(5, room // 4))
    live_rows = max(4, min(8, room // 6))
    middle = room - rows_wanted - live_rows - 1
    live = _live_lines(view, width, live_rows)
    right_width = max(44, min(76, width * 2 // 5))
    left_width = width - right_width - 3
    figures = _figures(view)
    left = _stacked(figures, left_width, middle, view.glyphs)
    right = _with_each_drop(view, result_lines(view, right_width, middle), right_width)
    both = join_blocks(left, right, left_width, middle)
    return [*live, *both, footnote(view.drop, view, width), *drop_table(view, width, rows_wanted)]


LEAST_BARS, MOST_BARS = 8, 16
"""Rows of what the drops of the point say beside each other: with fewer it is not read, more show
nothing new."""


def _with_each_drop(view: MeasureView, lines: list[Line], width: int) -> list[Line]:
    """The result with what every drop of the point says below it, where there is room."""
    used = max((place for place, row in enumerate(lines, 1) if row), default=0)
    rows = min(MOST_BARS, len(lines) - used - 1)
    drops = [drop for _, drop in sorted(view.drops.items()) if not drop.discarded]
    if rows < LEAST_BARS or len(drops) < 2:
        return lines
    job = view.state.job
    quantity = judged_quantity(job.quantity)
    title = f"{QUANTITY_NAMES[job.quantity]} of each drop, {view.units.unit(quantity)}"
    bars = []
    for drop in drops:
        found = view.state.value_of(drop)
        value = None if found is None or drop.status == "rejected" else found.value
        shown = drop.modulus if job.quantity is Quantity.MODULUS else value
        role: TextRole = "dim" if drop.status == "seating" else "measured"
        chosen = drop is view.drop
        bars.append(Bar(str(drop.number), view.units.value(quantity, shown), role, chosen))
    target = view.units.value(quantity, view.state.progress.target)
    whole = not view.glyphs.has_dots
    chart = profile_lines(bars, width, rows, title, target, full_blocks_only=whole)
    return pad_rows([*lines[:used], (), *chart], len(lines))


def _small(view: MeasureView, width: int, room: int) -> list[Line]:
    rows_wanted = max(2, min(len(view.drops) + 1, 5, room // 4 + 1))
    panel_rows = max(0, room - rows_wanted - LETTER_ROWS - 2)
    right = result_lines(view, width, LETTER_ROWS + 1, wide=True)
    lines = [*right, footnote(view.drop, view, width)]
    if panel_rows >= 4:
        lines += _one_panel(view, width, panel_rows)
    return [*lines, *drop_table(view, width, rows_wanted)]


def _tiny(view: MeasureView, width: int, room: int) -> list[Line]:
    """A terminal that is too small for anything but the numbers."""
    judged = judged_of(view.state, view.drop, view.units)
    sure = f" ± {judged.error} {judged.unit} (95 %)" if judged.error else f" {judged.unit}"
    lines = [line(cell(f" {judged.name} {judged.value}{sure}", "strong"))]
    lines += [line(" ", *row) for row in _verdict_lines(view, width - 1)]
    lines.append(footnote(view.drop, view, width))
    return [*lines, *drop_table(view, width, max(2, room - len(lines)))]


def _large(view: MeasureView, width: int, room: int) -> list[Line] | None:
    """Figures first: the modulus as large as the terminal has room for."""
    drop = view.drop
    if room < LETTER_ROWS + 4:
        return None
    rows_wanted = min(4, room - LETTER_ROWS - 4)
    space = room - rows_wanted - 4
    judged = judged_of(view.state, drop, view.units)
    figures = _figures_of(judged.value, judged.error, width - 2, space)
    lines: list[Line] = [(Cell(" "), *row) for row in figures]
    name = "" if judged.is_fit else f"  {judged.name}"
    lines.append(line(cell(f" {_unit_text(judged)}{name}", "strong")))
    lines += [line(" ", *row) for row in _verdict_lines(view, width - 1)][:2]
    lines = [*pad_rows(lines, room - rows_wanted - 1), footnote(drop, view, width)]
    return [*lines, *drop_table(view, width, rows_wanted)]


def _live_lines(view: MeasureView, width: int, rows: int) -> list[Line]:
    load, motion = live_figures(view.envelope, view.units, WINDOW)
    half = (width - 3) // 2
    return join_blocks(
        plot_lines(load, half, rows, view.glyphs),
        plot_lines(motion, width - 3 - half, rows, view.glyphs),
        half,
        rows,
    )


def _figures(view: MeasureView) -> list[Figure]:
    return [] if view.drop is None else drop_figures(view.drop, view.units)


def _stacked(figures: Sequence[Figure], width: int, rows: int, glyphs: Glyphs) -> list[Line]:
    if not figures:
        text = "  no traces yet: they come with the first drop"
        return pad_rows([(), line(cell(text, "dim"))], rows)
    return stacked_plots(figures, width, rows, glyphs, shares=(3, 4, 3))


def _one_panel(view: MeasureView, width: int, rows: int) -> list[Line]:
    figures = {figure.name: figure for figure in _figures(view)}
    panel = view.panel or ("live" if not figures else "deflection")
    if panel == "live" or panel not in figures:
        figure = live_figures(view.envelope, view.units, WINDOW)[0]
    else:
        figure = figures[panel]
    return plot_lines(figure, width, rows, view.glyphs)


def result_lines(view: MeasureView, width: int, rows: int, *, wide: bool = False) -> list[Line]:
    """The modulus in large figures with everything that belongs to it."""
    drop = view.drop
    judged = judged_of(view.state, drop, view.units)
    value, error = judged.value, judged.error
    details = _details(view, drop)
    if wide:
        shown = f"{value} ±{error}" if error else value
        digits = [()] * LETTER_ROWS if value == NO_VALUE else digit_lines(shown, "strong", 1, 1)
        taken = max(width_of(row) for row in digits) + 2
        side = width - taken - 3
        sure = fit(
            [piece(0, cell(_unit_text(judged, short=True), "strong")), Piece(_refining(drop), 1)],
            side,
        )
        text = [sure, *[fit([piece(0, detail)], side) for detail in details]]
        said = _verdict_lines(view, side)[: rows - 1]
        text = [*text[: rows - len(said)], *said]
        return join_blocks(
            [line(" ", *row) for row in digits], pad_rows(text, rows), taken, rows, "  "
        )
    layered = judged.is_fit and drop is not None and has_layers(drop.result)
    name = "modulus of the subgrade" if layered else judged.name
    title = name if drop is None else f"{name}, drop {drop.number}"
    verdict = _verdict_lines(view, width)
    used = len(details) + len(verdict) + 2
    space = max(LETTER_ROWS, rows - used)
    lines: list[Line] = [line(cell(title, "dim"), *_refining(drop))]
    lines += _figures_of(value, error, width, space)
    lines.append(line(cell(_unit_text(judged), "strong")))
    lines += [line(detail) for detail in details if len(detail) <= width]
    room = rows - len(lines)
    return pad_rows([*lines, *verdict[: max(0, room)]], rows)


def _unit_text(judged: Judged, *, short: bool = False) -> str:
    """The unit below large figures, and what the ± is."""
    if judged.value == NO_VALUE:
        return "no result yet" if judged.is_fit else f"no {judged.name} yet"
    if not judged.is_fit:
        return f"{judged.unit}  {judged.name}" if short else judged.unit
    return f"{judged.unit}, ± for 95 %" + ("" if short else " with the model's error")


def _figures_of(value: str, error: str, width: int, rows: int) -> list[Line]:
    """Value and uncertainty as large as there is room: one below the other, or side by side."""
    if value == NO_VALUE:  # a bar of blocks would look like a result
        return [()] * LETTER_ROWS
    if not error:
        return digit_lines(value, "strong", *(largest_size(value, width, rows) or (1, 1)))
    best: list[Line] = digit_lines(f"{value} ±{error}", "strong", 1, 1)
    for wide, high in BLOCK_SIZES:
        below = (wide // 2, max(1, high // 2)) if wide > 1 else (1, 1)
        needed = LETTER_ROWS * high + 1 + LETTER_ROWS * below[1]
        fits = max(digit_width(value, wide), digit_width(f"±{error}", below[0])) <= width
        if fits and needed <= rows:
            lines = digit_lines(value, "strong", wide, high)
            return [*lines, (), *digit_lines(f"±{error}", "strong", *below)]
        side_by_side = digit_width(f"{value} ±{error}", wide) <= width
        if side_by_side and LETTER_ROWS * high <= rows:
            return digit_lines(f"{value} ±{error}", "strong", wide, high)
    return best


def _refining(drop: DropState | None) -> Line:
    if drop is None or not drop.results or drop.final:
        return ()
    return (cell("  first answer, refining", "warn"),)


def _details(view: MeasureView, drop: DropState | None) -> list[str]:
    result = drop.result if drop is not None else None
    units = view.units
    lines = [] if result is None else top_and_subgrade(result, units)
    if result is not None and lines:
        lines.append(effective_text(result, units))
    if drop is None or result is None or drop.modulus is None:
        return [text for text in lines if text]
    if view.state.job.quantity is not Quantity.MODULUS:
        fitted, sure = modulus_text(drop, units)
        lines.insert(0, f"modulus of the fit {fitted} ±{sure or NO_VALUE} {units.unit('modulus')}")
    noise = result.modulus_sd_pa
    value, error = units.with_uncertainty("modulus", drop.modulus, noise)
    lines.append(f"{value} {units.unit('modulus')}, noise alone ± {error or NO_VALUE}")
    peak = units.with_unit("modulus", result.peak_modulus_pa)
    factor, ratio = result.peak_factor, result.poisson_ratio
    lines.append(f"peak method {peak} (f {plain(factor)}, ν {plain(ratio)})")
    for name, (amount, deviation, unit) in beside_modulus(result, units).items():
        given = f"± {deviation}" if deviation else "(given)"
        lines.append(f"{name:9} {amount} {given} {unit}")
    return lines


def _verdict_lines(view: MeasureView, width: int) -> list[Line]:
    text, role = verdict_of(view.drop, view.verdict)
    lines = [line(cell(row, role)) for row in wrap(text, width)]
    return [*lines, *[line(cell(row, "warn")) for row in advice_lines(view, width)]]


def advice_lines(view: MeasureView, width: int) -> list[str]:
    """What is to be done about the drop that is looked at, or about the point."""
    found = []
    for text in view.state.advice(view.drop):
        found += wrap(f"→ {text}", width)
    return found


def footnote(drop: DropState | None, view: MeasureView, width: int) -> Line:
    """What the modulus rests on."""
    result = drop.result if drop is not None else None
    if result is None or result.modulus_pa is None:
        return ()
    media = f"lowest of {len(result.layers or ())} media, " if has_layers(result) else ""
    units = view.units
    radius = units.with_unit("length", result.plate_radius_m)
    pieces = [
        piece(0, cell(f" {media}{result.model}", "dim")),
        piece(0, cell(f"{result.plate} plate, radius {radius}", "dim")),
        piece(0, cell(f"Poisson's ratio {plain(result.poisson_ratio)}", "dim")),
        piece(1, cell(f"{result.method}", "dim")),
        piece(2, cell(f"{result.load} load", "dim")),
    ]
    return flow(pieces, width, 1, ", ")[0]


def drop_table(view: MeasureView, width: int, rows: int) -> list[Line]:
    """The drops of the point, newest last."""
    drops = [view.drops[number] for number in sorted(view.drops)]
    place = next((at for at, drop in enumerate(drops) if drop.number == view.chosen), None)
    shown = window(len(drops), place, max(1, rows - 1))
    table = [
        drop_row(
            drops[at],
            view.units,
            chosen=drops[at].number == view.chosen,
            left_out=view.state.exclusion_reason(drops[at]),
        )
        for at in shown
    ]
    if not table:
        return pad_rows([line(cell(" no drops at this point yet", "dim"))], rows)
    return pad_rows(table_lines(drop_columns(view.units), table, width), rows)


def _mean_line(view: MeasureView, width: int) -> Line:
    state = view.state
    return line(" ", *point_summary(state, state.current, view.units, width - 1))
