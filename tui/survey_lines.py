"""Results of files as text; of many points a block or a line for each, each warning once."""

import dataclasses
import itertools
from collections import Counter
from collections.abc import Sequence

from pfwd.analysis.results import DropResult
from pfwd.export.json_text import json_text
from pfwd.message_groups import as_ranges, group_messages
from pfwd.procedures import Kind, PointDrop, judge
from pfwd.procedures.point import UNSUPPORTED_MARK
from tui.format import (
    NOTHING,
    UNEXPLAINED,
    By,
    aligned,
    layer_lines,
    lines_of_one_point,
    modulus_and_ends,
    peak_load,
    percent,
    rests_on,
    value_and_ends,
    verdict_of_fit,
)
from tui.output import clean

LONGEST_NAME = 20
"""Letters of a point's name in a table; longer ones end with an ellipsis."""

_STAR = f"{UNSUPPORTED_MARK} not supported by the data: decides nothing; "
_NOTE = "bedrock: 95 % interval; residual: contact phase, over the peak"


def printed_results(results: Sequence[DropResult], *, as_json: bool, by: By = "drop") -> list[str]:
    """Return the results of ``pfwd invert`` as they are printed: as JSON, or as text."""
    return [json_text(r.to_json()) for r in results] if as_json else result_lines(results, by)


def result_lines(results: Sequence[DropResult], by: By = "drop") -> list[str]:
    """Return the results of ``pfwd invert`` as lines of text.

    Parameters
    ----------
    results : sequence of DropResult
        One a drop.
    by : "point" or "drop"
        What has a line of its own.

    Returns
    -------
    list of str
        For every file its name, then of a single point :func:`tui.format.lines_of_one_point`, of
        several points :func:`survey_lines`.
    """
    lines = []
    for file, group in itertools.groupby(results, key=lambda result: result.file):
        of_file = list(group)
        lines.append(clean(file))
        if by == "point" or len({result.point for result in of_file}) > 1:
            lines += survey_lines(of_file, by)
        else:
            lines += lines_of_one_point(of_file)
    return lines


def survey_lines(results: Sequence[DropResult], by: By) -> list[str]:
    """The lines of one file that follow its name.

    Parameters
    ----------
    results : sequence of DropResult
        Of one file, in its order.
    by : "point" or "drop"
        What has a line of its own.

    Returns
    -------
    list of str
        What the numbers rest on; one table with the points as blocks; then what was rejected and
        every warning, each once, with its points as ranges.
    """
    points = [(key, list(group)) for key, group in itertools.groupby(results, key=_point)]
    used = [(name, [r for r in some if r.status != "rejected"]) for name, some in points]
    used = [(name, some) for name, some in used if some]
    lines = []
    starred = False
    for _, same in itertools.groupby(used, key=lambda item: _rests_on(item[1])):
        blocks = list(same)
        every = [result for _, some in blocks for result in some]
        lines += [f"  {line}" for line in _rests_on(every, _models(every))]
        starred |= any(result.not_supported is not None for result in every)
        rows: list[tuple[str, ...]] = [_POINT_COLUMNS] if by == "point" else [_DROP_COLUMNS]
        for name, some in blocks:
            rows += [_point_row(name, some)] if by == "point" else _drop_rows(name, some)
        lines += aligned(rows, left=(0, len(rows[0]) - 1))
        for name, some in blocks:
            lines += [f"  {name},{line[1:]}" for line in layer_lines(some)]
    if used and (by == "drop" or starred):
        lines.append(f"  {_STAR if starred else ''}{_NOTE}")
    rejected = [(r, r.reason or NOTHING) for r in results if r.status == "rejected"]
    order = list(dict.fromkeys(name for name, _ in points))
    lines += _said(results, order, "rejected", rejected)
    # What a drop is rejected for was said.
    warned = [(r, text) for r in results for text in r.warnings or () if text != r.reason]
    return lines + _said(results, order, "warning", warned)


_DROP_COLUMNS = (
    *("point", "drop", "kN", "E MPa", "95 % MPa", "bedrock m", "residual %", "verdict"),
)
_POINT_COLUMNS = ("point", "drops", "E MPa", "95 % MPa", "residual %", "verdict")


def _rests_on(results: Sequence[DropResult], model: str = "") -> tuple[str, ...]:
    """What the numbers rest on, whichever of the models a drop was fitted best by."""
    return rests_on(dataclasses.replace(results[0], model=model))


def _models(results: Sequence[DropResult]) -> str:
    return " or ".join(dict.fromkeys(str(result.model) for result in results))


def _point(result: DropResult) -> str:
    name = NOTHING if result.point is None else clean(result.point)
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…"


def _drop_rows(name: str, results: Sequence[DropResult]) -> list[tuple[str, ...]]:
    """A row a drop; the name stands in the first one."""
    rows: list[tuple[str, ...]] = []
    for result in results:
        modulus, interval = modulus_and_ends(result)
        star = UNSUPPORTED_MARK if result.not_supported is not None else ""
        kind = "" if result.status == "measured" else f" {clean(result.status)}"
        rows.append(
            (
                name if not rows else "",
                f"{NOTHING if result.drop is None else result.drop}{kind}",
                peak_load(result),
                f"{modulus}{star}",
                interval,
                _depth(result),
                percent(result.contact_residual_rms_over_peak),
                _verdict(result),
            )
        )
    return rows


def _depth(result: DropResult) -> str:
    """The interval of the depth alone: many records leave it open, and then no value is one."""
    depth, ends = result.bedrock_depth_m, result.bedrock_depth_interval_m
    if depth is None:
        return NOTHING
    if result.bedrock_depth_sd_m is None or ends is None:
        return f"{value_and_ends(depth, None)[0]} given"
    return value_and_ends(depth, ends)[1]


def _point_row(name: str, results: Sequence[DropResult]) -> tuple[str, ...]:
    """Mean of the measured drops with its interval, as reports have it."""
    from pfwd.analysis.drop_facts import with_modulus
    from pfwd.procedures import NO_PROCEDURE

    measured = [r for r in results if r.status == "measured"]
    facts = [
        with_modulus(PointDrop(number, Kind.MEASURED), result)
        for number, result in enumerate(measured, 1)
    ]
    radius = results[0].plate_radius_m or 0.0
    modulus = judge(NO_PROCEDURE, facts, plate_radius=radius).fitted_modulus
    mean = NOTHING, NOTHING
    if modulus is not None:
        value, ends_text = value_and_ends(modulus.value, modulus.interval, 1e6)
        mean = f"{value}{UNSUPPORTED_MARK if modulus.not_supported else ''}", ends_text
    residuals = [part for r in measured if (part := r.contact_residual_rms_over_peak) is not None]
    ends = (
        dict.fromkeys(percent(end) for end in (min(residuals), max(residuals))) if residuals else ()
    )
    seating = len(results) - len(measured)
    return (
        name,
        f"{len(measured)}" + (f" + {seating} seating" if seating else ""),
        *mean,
        " to ".join(ends) or NOTHING,
        _verdicts(measured),
    )


def _verdict(result: DropResult) -> str:
    return "NOT CONVERGED" if result.converged is False else verdict_of_fit(result)


def _verdicts(results: Sequence[DropResult]) -> str:
    """The word that all drops share, or how many have which."""
    counts = Counter(map(_verdict, results))
    if len(counts) <= 1:
        return next(iter(counts), NOTHING)
    worst_first = sorted(counts, key=lambda word: (word != UNEXPLAINED, word))
    return ", ".join(f"{counts[word]} {word}" for word in worst_first)


def _said(
    results: Sequence[DropResult],
    order: Sequence[str],
    what: str,
    said: Sequence[tuple[DropResult, str]],
) -> list[str]:
    """What is said of drops: each sentence once, the points as ranges, how many drops of all."""
    # By their place: two drops may be called alike.
    places = {id(result): (_point(result), place) for place, result in enumerate(results)}
    lines = []
    for group in group_messages((places[id(result)], text) for result, text in said):
        names = list(dict.fromkeys(name for name, _ in group.places))
        where = f"point{'s' if len(names) > 1 else ''} {as_ranges(names, order)}"
        if len(names) == len(order) > 1:
            where = "all points"
        count = len(group.places)
        drops = f"{count} drop{'s' if count > 1 else ''}"
        lines.append(f"  {what}, {where} ({drops}): {clean(group.text)}")
    return lines
