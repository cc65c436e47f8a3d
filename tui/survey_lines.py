"""Results of inversions as text: a block or a line for each point, and each warning once."""

import itertools
from collections import Counter
from collections.abc import Sequence

from pfwd.analysis.results import DropResult
from pfwd.export.json_text import json_text
from pfwd.message_groups import as_ranges, group_messages
from pfwd.procedures import Kind, PointDrop, judge
from pfwd.procedures.point import UNSUPPORTED_MARK
from tui.format import (
    NO_VALUE,
    UNEXPLAINED,
    By,
    aligned,
    equivalent_modulus,
    fit_word,
    in_megapascals,
    layer_lines,
    modulus_and_ends,
    peak_load,
    percent,
    point_lines,
    settings_lines,
    value_and_ends,
)
from tui.output import clean, counted

MAX_NAME_LETTERS = 20
"""Largest number of characters of a point's name in a table; a longer name ends with an ellipsis.
"""

_MARK_NOTE = f"{UNSUPPORTED_MARK} not supported by the data, decides no verdict"
_NOTE = "residual: contact phase, in % of the peak"


def printed_results(results: Sequence[DropResult], *, as_json: bool, by: By = "drop") -> list[str]:
    """Return the lines that ``pfwd invert`` prints: one JSON object for each drop, or text."""
    return [json_text(r.to_json()) for r in results] if as_json else result_lines(results, by)


def result_lines(results: Sequence[DropResult], by: By = "drop") -> list[str]:
    """Return the results of ``pfwd invert`` as lines of text.

    Parameters
    ----------
    results : sequence of DropResult
    by : "point" or "drop"
        A line for each point, or for each drop.

    Returns
    -------
    list of str
        For each file its name, then :func:`tui.format.point_lines` for a single point or
        :func:`survey_lines` for several.
    """
    lines = []
    for file, group in itertools.groupby(results, key=lambda result: result.file):
        of_file = list(group)
        lines.append(clean(file))
        if by == "point" or len({result.point for result in of_file}) > 1:
            lines += survey_lines(of_file, by)
        else:
            lines += point_lines(of_file)
    return lines


def survey_lines(results: Sequence[DropResult], by: By) -> list[str]:
    """Return the results of one file as lines of text, without its name.

    Parameters
    ----------
    results : sequence of DropResult
        Results of one file, in its order.
    by : "point" or "drop"
        A line for each point, or for each drop.

    Returns
    -------
    list of str
        Settings of the fit, a table of the points, then reasons of rejected drops and warnings,
        each once with its points.
    """
    points = [(key, list(group)) for key, group in itertools.groupby(results, key=_point)]
    inverted = [(name, [r for r in drops if r.status != "rejected"]) for name, drops in points]
    inverted = [(name, drops) for name, drops in inverted if drops]
    lines = []
    is_marked = False
    for _, group in itertools.groupby(inverted, key=lambda item: settings_lines(item[1][0], [""])):
        blocks = list(group)
        of_group = [result for _, drops in blocks for result in drops]
        models = dict.fromkeys(result.model for result in of_group)
        lines += [f"  {line}" for line in settings_lines(of_group[0], models)]
        is_marked |= any(result.not_supported is not None for result in of_group)
        rows: list[tuple[str, ...]] = [_POINT_COLUMNS] if by == "point" else [_DROP_COLUMNS]
        for name, drops in blocks:
            rows += [_point_row(name, drops)] if by == "point" else _drop_rows(name, drops)
        lines += aligned(rows, text_columns=(0, len(rows[0]) - 1))
        for name, drops in blocks:
            lines += [f"  {name},{line[1:]}" for line in layer_lines(drops)]
    notes = [_MARK_NOTE] if is_marked else []
    notes += [_NOTE] if inverted else []
    lines += ["  " + "; ".join(notes)] if notes else []
    rejected = [(r, r.reason or NO_VALUE) for r in results if r.status == "rejected"]
    order = list(dict.fromkeys(name for name, _ in points))
    lines += _message_lines(results, order, "rejected", rejected)
    # The reason of a rejected drop is printed already.
    warnings = [(r, text) for r in results for text in r.warnings or () if text != r.reason]
    return lines + _message_lines(results, order, "warning", warnings)


_DROP_COLUMNS = (
    *("point", "drop", "kN", "E MPa", "95 % MPa", "equivalent MPa", "residual %", "fit"),
)
_POINT_COLUMNS = ("point", "drops", "E MPa", "95 % MPa", "equivalent MPa", "residual %", "fit")


def _point(result: DropResult) -> str:
    name = NO_VALUE if result.point is None else clean(result.point)
    return name if len(name) <= MAX_NAME_LETTERS else f"{name[: MAX_NAME_LETTERS - 1]}…"


def _drop_rows(name: str, results: Sequence[DropResult]) -> list[tuple[str, ...]]:
    """Return a row for each drop; the first row has the name of the point."""
    rows: list[tuple[str, ...]] = []
    for result in results:
        modulus, interval = modulus_and_ends(result)
        star = UNSUPPORTED_MARK if result.not_supported is not None else ""
        kind = "" if result.status == "measured" else f" {clean(result.status)}"
        rows.append(
            (
                name if not rows else "",
                f"{NO_VALUE if result.drop is None else result.drop}{kind}",
                peak_load(result),
                f"{modulus}{star}",
                interval,
                equivalent_modulus(result),
                percent(result.contact_residual_rms_over_peak),
                _fit(result),
            )
        )
    return rows


def _point_row(name: str, results: Sequence[DropResult]) -> tuple[str, ...]:
    """Return the row of a point with the mean modulus of its measured drops, as in reports."""
    from pfwd.analysis.drop_facts import with_modulus
    from pfwd.procedures import NO_PROCEDURE

    measured = [r for r in results if r.status == "measured"]
    facts = [
        with_modulus(PointDrop(number, Kind.MEASURED), result)
        for number, result in enumerate(measured, 1)
    ]
    radius = results[0].plate_radius_m or 0.0
    modulus = judge(NO_PROCEDURE, facts, plate_radius=radius).fitted_modulus
    mean = NO_VALUE, NO_VALUE, NO_VALUE
    if modulus is not None:
        value, ends_text = value_and_ends(modulus.value, modulus.interval, 1e6)
        mean = (
            f"{value}{UNSUPPORTED_MARK if modulus.not_supported else ''}",
            ends_text,
            in_megapascals(modulus.equivalent, modulus.equivalent_interval),
        )
    residuals = [part for r in measured if (part := r.contact_residual_rms_over_peak) is not None]
    ends = (
        dict.fromkeys(percent(end) for end in (min(residuals), max(residuals))) if residuals else ()
    )
    seating = len(results) - len(measured)
    return (
        name,
        f"{len(measured)}" + (f" + {seating} seating" if seating else ""),
        *mean,
        " to ".join(ends) or NO_VALUE,
        _fits(measured),
    )


def _fit(result: DropResult) -> str:
    return "NOT CONVERGED" if result.converged is False else fit_word(result)


def _fits(results: Sequence[DropResult]) -> str:
    """Return the word that all fits share, else each word with its number of drops."""
    counts = Counter(map(_fit, results))
    if len(counts) <= 1:
        return next(iter(counts), NO_VALUE)
    worst_first = sorted(counts, key=lambda word: (word != UNEXPLAINED, word))
    return ", ".join(f"{counts[word]} {word}" for word in worst_first)


def _message_lines(
    results: Sequence[DropResult],
    order: Sequence[str],
    kind: str,
    messages: Sequence[tuple[DropResult, str]],
) -> list[str]:
    """Return messages about drops as lines, each once with its points and its number of drops."""
    # Identified by their index, because two drops may have the same name.
    places = {id(result): (_point(result), place) for place, result in enumerate(results)}
    lines = []
    for group in group_messages((places[id(result)], text) for result, text in messages):
        names = list(dict.fromkeys(name for name, _ in group.places))
        where = f"point{'s' if len(names) > 1 else ''} {as_ranges(names, order)}"
        if len(names) == len(order) > 1:
            where = "all points"
        drops = counted(len(group.places), "drop")
        lines.append(f"  {kind}, {where} ({drops}): {clean(group.text)}")
    return lines
