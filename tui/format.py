"""Results of inversions as text with units; texts from files are cleaned of control characters."""

import itertools
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Literal

from pfwd.analysis.options import METHOD_WORDS, PLATE_WORDS
from pfwd.analysis.results import DropResult, HalfSinePulse, LayerResult, relative_spread
from pfwd.digits import rounded, significant, with_ends
from pfwd.message_groups import as_ranges, group_messages
from tui.output import clean, spelled

NO_VALUE = "-"
"""Text of a cell without a value."""

By = Literal["point", "drop"]
"""Rows of a table: one for each point, or one for each drop."""

UNEXPLAINED = "UNEXPLAINED"
"""Word for a residual above noise and model error, with which the modulus may be wrong."""

MODEL_WORDS = {"layer": "soil on bedrock"}
"""Texts for models of the JSON output; a model without a text is shown as it is."""


def point_lines(results: Sequence[DropResult]) -> list[str]:
    """Return the drops of one point as lines of text.

    Returns
    -------
    list of str
        For each setting of the fit tables of moduli, of damping and density, and of pulse and fit,
        then rejected drops and warnings. The tables fit into 80 columns.
    """
    lines = []
    inverted = [result for result in results if not _is_rejected(result)]
    for settings, group in itertools.groupby(inverted, key=settings_lines):
        rows = list(group)
        lines += [f"  {line}" for line in settings]
        lines += _table(_GROUND, rows)
        lines += _table(_DAMPING, [row for row in rows if not _is_layered(row)])
        lines += layer_lines(rows)
        lines += _table(_PULSE, rows)
        lines += _search_lines(rows)
    rejected = [(r, r.reason or NO_VALUE) for r in results if _is_rejected(r)]
    warnings = [(r, text) for r in results for text in r.warnings or ()]
    return [
        *lines,
        *_message_lines(results, "rejected", rejected),
        *_message_lines(results, "warning", warnings),
    ]


def _is_rejected(result: DropResult) -> bool:
    return result.status == "rejected"


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
        f"radius {_fixed(_finite(result.plate_radius_m), 3)} m; "
        f"Poisson's ratio {_short(_finite(result.poisson_ratio))}; "
        f"peak-method factor {_short(_finite(result.peak_factor))}",
        f"{model}; {_text(result.load)} load; "
        f"{word(METHOD_WORDS, result.method)}, seed {_text(result.seed)}",
    )


def word(words: Mapping[str, str], value: str | None) -> str:
    """Return the text for a value of the JSON output; the value itself if it has no text."""
    return words.get(value or "", _text(value))


def layer_lines(rows: Iterable[DropResult]) -> list[str]:
    """Return a table of the layers of drops with several layers, and one modulus for all layers."""
    lines = []
    layered = [row for row in rows if _is_layered(row)]
    layers = [(row, number) for row in layered for number in range(len(row.layers or ()))]
    if layers:
        cells = [list(_LAYER), *([show(*item) for show in _LAYER.values()] for item in layers)]
        lines += aligned(cells)
    for row in layered:
        modulus, ends = value_and_ends(
            row.effective_modulus_pa, row.effective_modulus_interval_pa, 1e6
        )
        lines.append(
            f"  drop {_text(row.drop)}: one modulus for all {modulus} MPa ({ends}), down "
            f"to {_short(_finite(row.effective_depth_m))} m"
        )
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
    return [
        f"  drop{'s' if len(names) > 1 else ''} {as_ranges(names, order)}: {faults}"
        for faults, names in drops.items()
    ]


def _message_lines(
    results: Iterable[DropResult], kind: str, messages: Iterable[tuple[DropResult, str]]
) -> list[str]:
    """Return messages about drops of a point as lines, each once with its drops."""
    order = list(dict.fromkeys(_text(result.drop) for result in results))
    lines = []
    for group in group_messages((_text(result.drop), text) for result, text in messages):
        drops = "drop" if len(group.places) == 1 else "drops"
        lines.append(f"  {kind}, {drops} {as_ranges(group.places, order)}: {clean(group.text)}")
    return lines


def _table(
    columns: Mapping[str, Callable[[DropResult], str]], rows: Sequence[DropResult]
) -> list[str]:
    cells = [[show(row) for show in columns.values()] for row in rows]
    return aligned([list(columns), *cells]) if cells else []


def aligned(cells: Sequence[Sequence[str]], text_columns: Collection[int] = ()) -> list[str]:
    """Return the lines of a table, aligned to the right.

    Parameters
    ----------
    cells : sequence of rows of texts
    text_columns : collection of int
        Indices of the columns that are aligned to the left.
    """
    cells = [[spelled(cell) for cell in row] for row in cells]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return [
        "  "
        + "  ".join(
            text.ljust(width) if column in text_columns else text.rjust(width)
            for column, (text, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in cells
    ]


def _with_deviation(key: str, unit: str, scale: float = 1.0) -> Callable[[DropResult], str]:
    """Return a function that shows a value of a result with its standard deviation.

    The standard deviation is that of the noise. Both have no digits that the interval of the
    modulus or the residual does not support.

    Parameters
    ----------
    key, unit : str
        The value is the field ``<key>_<unit>`` of the result.
    scale : float
        SI units in one shown unit.
    """

    def show(result: DropResult) -> str:
        value = _finite(getattr(result, f"{key}_{unit}"), scale)
        deviation = _finite(getattr(result, f"{key}_sd_{unit}"), scale)
        if value is None:
            return NO_VALUE
        if deviation is None:
            return f"{_short(value)} given"
        spread = max(deviation, abs(value) * relative_spread(result))
        text, around = rounded(value, spread), rounded(deviation, spread)
        return text if float(around) == 0.0 else f"{text} ± {around}"

    return show


def modulus_and_ends(result: DropResult) -> tuple[str, str]:
    """Return the modulus and its 95 % interval as texts in MPa."""
    return value_and_ends(result.modulus_pa, result.modulus_interval_pa, 1e6)


def equivalent_modulus(result: DropResult) -> str:
    """Return the equivalent modulus with its 95 % interval as text in MPa."""
    return in_megapascals(result.equivalent_modulus_pa, result.equivalent_modulus_interval_pa)


def in_megapascals(modulus: float | None, ends: tuple[float, float] | None) -> str:
    """Return a modulus, Pa, with its interval as one text in MPa without the unit."""
    value, interval = value_and_ends(modulus, ends, 1e6)
    return value if interval == NO_VALUE else f"{value} ({interval})"


def value_and_ends(
    value: float | None, ends: tuple[float, float] | None, scale: float = 1.0
) -> tuple[str, str]:
    """Return a value and its interval as two texts.

    Parameters
    ----------
    value : float or None
        None: the text is `NO_VALUE`.
    ends : pair of float or None
        None: the value has three digits, and the text of the interval is `NO_VALUE`.
    scale : float
        SI units in one shown unit.
    """
    number = _finite(value, scale)
    if ends is None or not all(map(math.isfinite, ends)):
        return _short(number), NO_VALUE
    low, high = (end / scale for end in ends)
    mean = math.sqrt(low * high) if low > 0 else (low + high) / 2
    text, *end_texts = with_ends(mean if number is None else number, (low, high))
    return (NO_VALUE if number is None else text), " to ".join(end_texts)


def _modulus(result: DropResult) -> str:
    return modulus_and_ends(result)[0]


def _interval(result: DropResult) -> str:
    return modulus_and_ends(result)[1]


def bedrock_depth(result: DropResult) -> str:
    """Return the depth of bedrock as text in m, with its interval unless it is declared."""
    depth = _finite(result.bedrock_depth_m)
    ends = result.bedrock_depth_interval_m
    if depth is None or result.bedrock_depth_sd_m is None or ends is None:
        return _with_deviation("bedrock_depth", "m")(result)
    text, interval = value_and_ends(depth, ends)
    return f"{text} ({interval})"


def fit_word(result: DropResult) -> str:
    """Return "explained" if the model explains the record, else `UNEXPLAINED`."""
    if result.explained is None:
        return NO_VALUE
    return "explained" if result.explained else UNEXPLAINED


def peak_load(result: DropResult) -> str:
    """Return the peak load as text in kN: the measured one, else that of the half-sine."""
    return _short(_finite(result.peak_load_n, 1e3))


def _peak_pressure(result: DropResult) -> str:
    """Return the mean pressure under the plate at the peak load as text in kPa."""
    load, radius = result.peak_load_n, result.plate_radius_m
    if load is None or not radius:
        return NO_VALUE
    return _short(_finite(load / (math.pi * radius**2), 1e3))


def _layer(result: DropResult, number: int) -> LayerResult:
    return (result.layers or ())[number]


def _layer_modulus(result: DropResult, number: int) -> tuple[str, str]:
    """Return modulus and interval of a layer as texts in MPa.

    The lowest layer has no modulus if the data do not determine it.
    """
    layer = _layer(result, number)
    is_open = result.modulus_pa is None and number == len(result.layers or ()) - 1
    return value_and_ends(None if is_open else layer.modulus_pa, layer.modulus_interval_pa, 1e6)


def _thickness(layer: LayerResult) -> tuple[str, str]:
    return value_and_ends(layer.thickness_m, layer.thickness_interval_m)


def _pulse(result: DropResult) -> HalfSinePulse:
    return result.half_sine or HalfSinePulse()


_GROUND: dict[str, Callable[[DropResult], str]] = {
    "drop": lambda result: _text(result.drop),
    "E MPa": _modulus,
    "95 % MPa": _interval,
    "equivalent MPa": equivalent_modulus,
    "bedrock m": bedrock_depth,
}
_DAMPING: dict[str, Callable[[DropResult], str]] = {
    "drop": lambda result: _text(result.drop),
    "η kPa s": _with_deviation("viscosity", "pa_s", 1e3),
    "ρ kg/m³": _with_deviation("density", "kg_m3"),
}
_LAYER: dict[str, Callable[[DropResult, int], str]] = {
    "drop": lambda result, number: _text(result.drop),
    "layer": lambda result, number: str(number + 1),
    "E MPa": lambda result, number: _layer_modulus(result, number)[0],
    "95 % MPa": lambda result, number: _layer_modulus(result, number)[1],
    "h m": lambda result, number: _thickness(_layer(result, number))[0],
    "95 % m": lambda result, number: _thickness(_layer(result, number))[1],
    "η kPa s": lambda result, number: _short(_finite(_layer(result, number).viscosity_pa_s, 1e3)),
    "ρ kg/m³": lambda result, number: _short(_finite(_layer(result, number).density_kg_m3)),
}
_PULSE: dict[str, Callable[[DropResult], str]] = {
    "drop": lambda result: _text(result.drop),
    "kind": lambda result: _text(result.status),
    "kN": peak_load,
    "kPa": _peak_pressure,
    "ms": lambda result: _short(_finite(_pulse(result).duration_s, 1e-3)),
    "peak E MPa": lambda result: _short(_finite(result.peak_modulus_pa, 1e6)),
    "residual %": lambda result: percent(result.residual_rms_over_peak),
    "contact %": lambda result: percent(result.contact_residual_rms_over_peak),
    "fit": fit_word,
}


def _finite(value: float | None, scale: float = 1.0) -> float | None:
    """Return a number divided by `scale`; None: it is None or not finite."""
    return float(value) / scale if value is not None and math.isfinite(value) else None


def _text(value: object) -> str:
    return NO_VALUE if value is None else clean(value)


def _short(value: float | None) -> str:
    """Return a number with three significant digits, but all digits before the point, as text."""
    return NO_VALUE if value is None else significant(value)


def percent(part: float | None) -> str:
    """Return a fraction in percent with two significant digits, without the sign."""
    value = _finite(part, 1e-2)
    return NO_VALUE if value is None else significant(value, 2)


def _fixed(value: float | None, decimals: int) -> str:
    return NO_VALUE if value is None else f"{value:.{decimals}f}"


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
    modulus = _finite(result.modulus_pa, 1e6)
    status = _text(result.status)
    if modulus is None:
        return f"{name}  {status}" + (f": {clean(result.reason)}" if result.reason else "")
    equivalent = equivalent_modulus(result)
    parts = [
        f"{name}  E {_modulus(result)} MPa ({_interval(result)})",
        *([] if equivalent == NO_VALUE else [f"equivalent {equivalent} MPa"]),
        f"{word(MODEL_WORDS, result.model)}, {word(PLATE_WORDS, result.plate)} "
        f"{_fixed(_finite(result.plate_radius_m), 3)} m, "
        f"ν {_short(_finite(result.poisson_ratio))}",
        f"{peak_load(result)} kN",
        f"residual {percent(result.residual_rms_over_peak)} %",
        word(METHOD_WORDS, result.method),
    ]
    parts += ["seating"] if status == "seating" else []
    parts += [] if result.explained is not False else ["NOT EXPLAINED"]
    parts += [f"AT BOUND {clean(name)}" for name in result.at_bound or ()]
    return "  ".join(parts)
