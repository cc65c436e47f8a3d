"""Results of inversions as text with units; texts from files are cleaned of control characters."""

import itertools
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Literal

from pfwd.analysis.options import METHOD_WORDS, PLATE_WORDS
from pfwd.analysis.results import DropResult
from pfwd.digits import MISSING, declared, significant
from pfwd.export.json_text import json_text
from pfwd.facts import UNEXPLAINED, fact_of_modulus, facts_of_drop
from pfwd.message_groups import Notice, as_ranges, group_messages, text_of
from pfwd.procedures import Kind, PointDrop, Quantity, judge
from pfwd.procedures.point import UNSUPPORTED_MARK
from pfwd.units import SI, Fact, percent
from tui.output import clean, counted, spelled

By = Literal["point", "drop"]
"""Rows of a table: one for each point, or one for each drop."""

MODEL_WORDS = {"layer": "soil on bedrock"}
"""Texts for models of the JSON output; a model without a text is shown as it is."""

MAX_NAME_LETTERS = 20
"""Largest number of characters of a point's name in a table; a longer name ends with an ellipsis.
"""

_MARK_NOTE = f"{UNSUPPORTED_MARK} not supported by the data, decides no verdict"
_CONTACT_NOTE = "contact: residual of the contact phase, of the peak"
_GROUND = ("drop", "E MPa", "95 % MPa", "equivalent MPa", "bedrock m")
_DAMPING = ("drop", "η kPa s", "ρ kg/m³")
_PULSE = ("drop", "kind", "kN", "kPa", "ms", "peak E MPa", "residual %", "contact %", "fit")
_DROPS = ("point", "drop", "kN", "E MPa", "95 % MPa", "equivalent MPa", "contact %", "fit")
_POINTS = ("point", "drops", "E MPa", "95 % MPa", "equivalent MPa", "contact %", "fit")


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
        For each file its name, for each setting of the fit the tables, then rejected drops and
        warnings, each once. A single point has tables of all values, several points have one table.
        The tables fit into 80 columns.
    """
    lines = []
    for file, group in itertools.groupby(results, key=lambda result: result.file):
        of_file = list(group)
        lines.append(clean(file))
        is_single = by == "drop" and len({result.point for result in of_file}) == 1
        inverted = [result for result in of_file if result.status != "rejected"]
        for _, rows in itertools.groupby(inverted, key=lambda r: settings_lines(r, [""])):
            lines += _settings_block(list(rows), by, is_single=is_single)
        notes = [_MARK_NOTE] if any(UNSUPPORTED_MARK in line for line in lines) else []
        notes += [_CONTACT_NOTE] if inverted and not is_single else []
        lines += ["  " + "; ".join(notes)] if notes else []
        rejected = [(r, r.reason) for r in of_file if r.reason is not None]
        lines += _message_lines(of_file, "rejected", rejected)
        # The reason of a rejected drop is printed already.
        warnings = [(r, text) for r in of_file for text in r.warnings if text != r.reason]
        lines += _message_lines(of_file, "warning", warnings)
    return lines


def _settings_block(rows: Sequence[DropResult], by: By, *, is_single: bool) -> list[str]:
    """Return the settings that drops of a file share, and the tables of the drops."""
    models = dict.fromkeys(result.model for result in rows)
    lines = [f"  {line}" for line in settings_lines(rows[0], models)]
    cells: list[dict[str, str]] = []
    points = [(name, list(drops)) for name, drops in itertools.groupby(rows, key=_point)]
    if is_single:
        cells += map(drop_cells, rows)
        lines += _table(_GROUND, cells)
        lines += _table(_DAMPING, [drop_cells(row) for row in rows if not _is_layered(row)])
        return [*lines, *_layer_lines(rows), *_table(_PULSE, cells), *_search_lines(rows)]
    if by == "point":
        lines += _table(_POINTS, [_point_cells(*point) for point in points])
    else:
        for name, drops in points:
            for place, drop in enumerate(drops):
                kind = "" if drop.status == "measured" else f" {_text(drop.status)}"
                heads = {"point": "" if place else name, "drop": f"{_text(drop.drop)}{kind}"}
                cells.append(drop_cells(drop) | heads | {"fit": _fit(drop)})
        lines += _table(_DROPS, cells)
    return [
        *lines,
        *(f"  {name},{line[1:]}" for name, drops in points for line in _layer_lines(drops)),
    ]


def _is_layered(result: DropResult) -> bool:
    return result.layers is not None and len(result.layers) > 1


def settings_lines(
    result: DropResult, models: Collection[str | None] | None = None
) -> tuple[str, ...]:
    """Return the settings of a fit as lines of text; drops with equal lines share a table.

    Parameters
    ----------
    result : DropResult
    models : collection of str, optional
        Models of all drops of the table, if they differ from drop to drop.
    """
    model = " or ".join(word(MODEL_WORDS, text) for text in models or [result.model])
    return (
        f"{word(PLATE_WORDS, result.plate)}, "
        f"radius {declared(result.plate_radius_m, 'm')}; "
        f"Poisson's ratio {declared(result.poisson_ratio)}; "
        f"peak-method factor {significant(result.peak_factor)}",
        f"{model}; {_text(result.load)} load; "
        f"{word(METHOD_WORDS, result.method)}, seed {_text(result.seed)}",
    )


def word(words: Mapping[str, str], value: str | None) -> str:
    """Return the text for a value of the JSON output; the value itself if it has no text."""
    return words.get(value or "", _text(value))


def drop_cells(result: DropResult) -> dict[str, str]:
    """Return the texts of a drop by the titles of their columns."""
    facts = facts_of_drop(result)
    texts = {key: SI.show(fact, with_unit=False) for key, fact in facts.items()}
    return {
        "drop": _text(result.drop),
        "kind": _text(result.status),
        **_modulus_cells(facts["modulus"]),
        "equivalent MPa": texts["equivalent"],
        "bedrock m": texts["bedrock"],
        "η kPa s": texts["viscosity"],
        "ρ kg/m³": texts["density"],
        "kN": texts["load"],
        "kPa": texts["pressure"],
        "ms": texts["duration"],
        "peak E MPa": texts["peak modulus"],
        "residual %": _share(result.residual_rms_over_peak),
        "contact %": _share(result.contact_residual_rms_over_peak),
        "fit": _explained(result),
    }


def _modulus_cells(fact: Fact) -> dict[str, str]:
    value, ends = SI.value_and_ends(fact)
    return {"E MPa": value, "95 % MPa": ends or MISSING}


def _point_cells(name: str, results: Sequence[DropResult]) -> dict[str, str]:
    """Return the texts of a point with the mean modulus of its measured drops, as in reports."""
    from pfwd.analysis.drop_facts import with_modulus
    from pfwd.procedures import NO_PROCEDURE

    measured = [r for r in results if r.status == "measured"]
    facts = [
        with_modulus(PointDrop(number, Kind.MEASURED), result)
        for number, result in enumerate(measured, 1)
    ]
    radius = results[0].plate_radius_m or 0.0
    modulus = judge(NO_PROCEDURE, facts, plate_radius=radius).fitted_modulus
    equivalent = fact_of_modulus(modulus, Quantity.EQUIVALENT_MODULUS)
    residuals = [part for r in measured if (part := r.contact_residual_rms_over_peak) is not None]
    ends = dict.fromkeys(_share(end(residuals)) for end in (min, max)) if residuals else ()
    seating = len(results) - len(measured)
    counts = Counter(map(_fit, measured))
    worst_first = sorted(counts, key=lambda word: (word != UNEXPLAINED, word))
    return {
        "point": name,
        "drops": f"{len(measured)}" + (f" + {seating} seating" if seating else ""),
        **_modulus_cells(fact_of_modulus(modulus)),
        "equivalent MPa": SI.show(equivalent, with_unit=False),
        "contact %": " to ".join(ends) or MISSING,
        "fit": ", ".join(f"{counts[word]} {word}" for word in worst_first)
        if len(counts) > 1
        else next(iter(counts), MISSING),
    }


def _point(result: DropResult) -> str:
    name = MISSING if result.point is None else clean(result.point)
    return name if len(name) <= MAX_NAME_LETTERS else f"{name[: MAX_NAME_LETTERS - 1]}…"


def _layer_lines(rows: Iterable[DropResult]) -> list[str]:
    """Return a table of the layers of drops with several layers, and one modulus for all layers."""
    layered = [row for row in rows if _is_layered(row)]
    cells = []
    for row in layered:
        layers = row.layers or ()
        for number, layer in enumerate(layers, 1):
            # The lowest layer has no modulus if the data do not determine it.
            is_open = row.modulus_pa is None and number == len(layers)
            modulus = None if is_open else layer.modulus_pa
            thickness, ends = SI.value_and_ends(
                Fact("depth", layer.thickness_m, layer.thickness_interval_m)
            )
            cells.append(
                {
                    "drop": _text(row.drop),
                    "layer": str(number),
                    **_modulus_cells(Fact("modulus", modulus, layer.modulus_interval_pa)),
                    "h m": thickness,
                    "95 % m": ends or MISSING,
                    "η kPa s": SI.text("viscosity", layer.viscosity_pa_s),
                    "ρ kg/m³": SI.text("density", layer.density_kg_m3),
                }
            )
    lines = _table(tuple(cells[0]) if cells else (), cells)
    for row in layered:
        effective = SI.show(facts_of_drop(row)["effective"])
        depth = SI.with_unit("depth", row.effective_depth_m)
        lines.append(f"  drop {_text(row.drop)}: one modulus for all {effective}, down to {depth}")
    return lines


def _search_lines(rows: Sequence[DropResult]) -> list[str]:
    """Return the drops whose search did not converge or ended at a bound, as lines."""
    order = [_text(row.drop) for row in rows]
    drops: dict[str, list[str]] = {}
    for row in rows:
        bounds = ", ".join(map(clean, row.at_bound or ()))
        faults = [] if row.converged else ["NOT CONVERGED"]
        faults += [f"AT BOUND: {bounds}"] if bounds else []
        if faults:
            drops.setdefault("; ".join(faults), []).append(_text(row.drop))
    return [f"  {_named('drop', names, order)}: {faults}" for faults, names in drops.items()]


def _message_lines(
    results: Sequence[DropResult], kind: str, messages: Iterable[tuple[DropResult, Notice]]
) -> list[str]:
    """Return messages about drops as lines, each once with its points, or the drops of a point."""
    points, drops = (
        list(dict.fromkeys(map(name, results))) for name in (_point, lambda r: _text(r.drop))
    )
    lines = []
    # Identified by their index, because two drops may have the same name.
    places = {id(result): place for place, result in enumerate(results)}
    for group in group_messages((places[id(result)], text) for result, text in messages):
        concerned = [results[place] for place in group.places]
        where = _named("drop", [_text(result.drop) for result in concerned], drops)
        if len(points) > 1:
            names = set(map(_point, concerned))
            where = "all points" if len(names) == len(points) else _named("point", names, points)
            where += f" ({counted(len(concerned), 'drop')})"
        lines.append(f"  {kind}, {where}: {clean(group.text)}")
    return lines


def _named(noun: str, names: Collection[str], order: Sequence[str]) -> str:
    return f"{noun}{'s' if len(names) > 1 else ''} {as_ranges(names, order)}"


def _table(titles: Sequence[str], rows: Iterable[Mapping[str, str]]) -> list[str]:
    """Return the lines of a table: names of points and last columns to the left, others right."""
    cells = [[spelled(row[title]) for title in titles] for row in rows]
    if not cells:
        return []
    cells.insert(0, list(map(spelled, titles)))
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lefts = {0, len(titles) - 1} if titles[0] == "point" else set()
    return [
        "  "
        + "  ".join(
            text.ljust(width) if column in lefts else text.rjust(width)
            for column, (text, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in cells
    ]


def _explained(result: DropResult) -> str:
    """Return "explained" if the model explains the record, else `UNEXPLAINED`."""
    if result.explained is None:
        return MISSING
    return "explained" if result.explained else UNEXPLAINED


def _fit(result: DropResult) -> str:
    return "NOT CONVERGED" if result.converged is False else _explained(result)


def _text(value: object) -> str:
    return MISSING if value is None else clean(value)


def _share(part: float | None) -> str:
    return percent(part).removesuffix(" %")


def drop_line(point: str, number: int, result: DropResult) -> str:
    """Return one drop as a line of text: modulus, settings of the fit, load, residual.

    Parameters
    ----------
    point : str
        Name of the point.
    number : int
        Number of the drop within the point.
    result : DropResult
    """
    name = f"{clean(point)}/{number}"
    status = _text(result.status)
    facts = facts_of_drop(result)
    if SI.value("modulus", result.modulus_pa) is None:
        return f"{name}  {status}" + (f": {clean(text_of(result.reason))}" if result.reason else "")
    equivalent = SI.show(facts["equivalent"])
    parts = [
        f"{name}  E {SI.show(facts['modulus'])}",
        *([] if equivalent == MISSING else [f"equivalent {equivalent}"]),
        f"{word(MODEL_WORDS, result.model)}, {word(PLATE_WORDS, result.plate)} "
        f"{declared(result.plate_radius_m, 'm')}, ν {declared(result.poisson_ratio)}",
        SI.show(facts["load"]),
        f"residual {percent(result.residual_rms_over_peak)}",
        word(METHOD_WORDS, result.method),
    ]
    parts += ["seating"] if status == "seating" else []
    parts += [] if result.explained is not False else [UNEXPLAINED]
    parts += [f"AT BOUND {clean(name)}" for name in result.at_bound or ()]
    return "  ".join(parts)
