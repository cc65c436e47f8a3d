"""Results as text for people: units shown, numbers never cut, nothing of a terminal's mark-up."""

import itertools
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Literal

from pfwd.analysis.results import DropResult, HalfSinePulse, LayerResult, relative_spread
from pfwd.digits import rounded, significant, with_ends
from pfwd.message_groups import as_ranges, group_messages
from tui.output import clean, spelled

NOTHING = "-"

By = Literal["point", "drop"]
"""What has a line of its own."""

UNEXPLAINED = "UNEXPLAINED"
"""More is left of the record than noise and the model's error: its modulus may be wrong."""


def lines_of_one_point(results: Sequence[DropResult]) -> list[str]:
    """Drops of one point as lines of text.

    Returns
    -------
    list of str
        For each setting of the fit a table of the ground and a table of the pulse and the fit; then
        the rejected drops and the warnings. The tables are made for 80 columns.
    """
    lines = []
    used = [result for result in results if not _is_rejected(result)]
    for settings, same in itertools.groupby(used, key=rests_on):
        rows = list(same)
        lines += [f"  {line}" for line in settings]
        lines += _table(_GROUND, rows)
        lines += layer_lines(rows)
        lines += _table(_PULSE, rows)
        lines += _search_lines(rows)
    rejected = [(r, r.reason or NOTHING) for r in results if _is_rejected(r)]
    warnings = [(r, text) for r in results for text in r.warnings or ()]
    return [
        *lines,
        *_said_of_drops(results, "rejected", rejected),
        *_said_of_drops(results, "warning", warnings),
    ]


def _is_rejected(result: DropResult) -> bool:
    return result.status == "rejected"


def rests_on(result: DropResult) -> tuple[str, ...]:
    """What the numbers of a drop rest on; equal for drops that can share a table."""
    return (
        f"plate radius {_fixed(_finite(result.plate_radius_m), 3)} m, {_text(result.plate)}; "
        f"Poisson's ratio {_short(_finite(result.poisson_ratio))}; "
        f"peak-method factor {_short(_finite(result.peak_factor))}",
        f"model {_text(result.model)}, load {_text(result.load)}, "
        f"method {_text(result.method)}, seed {_text(result.seed)}",
    )


def layer_lines(rows: Iterable[DropResult]) -> list[str]:
    """A table of the layers of every drop that has more than one, and what stands for all."""
    lines = []
    layered = [row for row in rows if row.layers is not None and len(row.layers) > 1]
    found = [(row, number) for row in layered for number in range(len(row.layers or ()))]
    if found:
        cells = [list(_LAYER), *([show(*item) for show in _LAYER.values()] for item in found)]
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
    """What went wrong with searches; nothing where they went well."""
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


def _said_of_drops(
    results: Iterable[DropResult], what: str, said: Iterable[tuple[DropResult, str]]
) -> list[str]:
    """What is said of the drops of a point: each sentence once, with the drops as ranges."""
    order = list(dict.fromkeys(_text(result.drop) for result in results))
    lines = []
    for group in group_messages((_text(result.drop), text) for result, text in said):
        drops = "drop" if len(group.places) == 1 else "drops"
        lines.append(f"  {what}, {drops} {as_ranges(group.places, order)}: {clean(group.text)}")
    return lines


def _table(
    columns: Mapping[str, Callable[[DropResult], str]], rows: Sequence[DropResult]
) -> list[str]:
    return aligned([list(columns), *([show(row) for show in columns.values()] for row in rows)])


def aligned(cells: Sequence[Sequence[str]], left: Collection[int] = ()) -> list[str]:
    """The lines of a table; columns are aligned to the right, but for those named."""
    cells = [[spelled(cell) for cell in row] for row in cells]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return [
        "  "
        + "  ".join(
            text.ljust(width) if column in left else text.rjust(width)
            for column, (text, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in cells
    ]


def _with_deviation(key: str, unit: str, scale: float = 1.0) -> Callable[[DropResult], str]:
    """Shows ``<key>_<unit>`` over `scale` with its standard deviation.

    The deviation is that of the noise alone. Digits that the interval of the modulus, or what is
    left of the record, does not support are not shown.
    """

    def show(result: DropResult) -> str:
        value = _finite(getattr(result, f"{key}_{unit}"), scale)
        deviation = _finite(getattr(result, f"{key}_sd_{unit}"), scale)
        if value is None:
            return NOTHING
        if deviation is None:
            return f"{_short(value)} given"
        spread = max(deviation, abs(value) * relative_spread(result))
        text, around = rounded(value, spread), rounded(deviation, spread)
        return text if float(around) == 0.0 else f"{text} ± {around}"

    return show


def modulus_and_ends(result: DropResult) -> tuple[str, str]:
    """The modulus and its 95 % interval, MPa, with the digits that the interval supports."""
    return value_and_ends(result.modulus_pa, result.modulus_interval_pa, 1e6)


def value_and_ends(
    value: float | None, ends: tuple[float, float] | None, scale: float = 1.0
) -> tuple[str, str]:
    """A value and its interval over `scale`; of one without an interval three digits."""
    found = _finite(value, scale)
    known = ends is not None and all(map(math.isfinite, ends))
    if ends is None or not known:
        return _short(found), NOTHING
    low, high = (end / scale for end in ends)
    middle = math.sqrt(low * high) if low > 0 else (low + high) / 2
    shown, *shown_ends = with_ends(middle if found is None else found, (low, high))
    return (NOTHING if found is None else shown), " to ".join(shown_ends)


def _modulus(result: DropResult) -> str:
    return modulus_and_ends(result)[0]


def _interval(result: DropResult) -> str:
    return modulus_and_ends(result)[1]


def depth_of_rock(result: DropResult) -> str:
    """The depth of the rock with its interval, m; what was given has none."""
    depth = _finite(result.bedrock_depth_m)
    ends = result.bedrock_depth_interval_m
    if depth is None or result.bedrock_depth_sd_m is None or ends is None:
        return _with_deviation("bedrock_depth", "m")(result)
    shown, interval = value_and_ends(depth, ends)
    return f"{shown} ({interval})"


def verdict_of_fit(result: DropResult) -> str:
    """Whether the model explains the record, in a word."""
    if result.explained is None:
        return NOTHING
    return "explained" if result.explained else UNEXPLAINED


def peak_load(result: DropResult) -> str:
    """As it was measured, kN; of results that do not know it that of the half-sine."""
    return _short(_finite(result.peak_load_or_half_sine_n, 1e3))


def _peak_pressure(result: DropResult) -> str:
    """Mean of the peak load under the plate, kPa."""
    load, radius = result.peak_load_or_half_sine_n, result.plate_radius_m
    if load is None or not radius:
        return NOTHING
    return _short(_finite(load / (math.pi * radius**2), 1e3))


def _layer(result: DropResult, number: int) -> LayerResult:
    return (result.layers or ())[number]


def _layer_modulus(result: DropResult, number: int) -> tuple[str, str]:
    """MPa; of the lowest layer what the result says of the subgrade: nothing if not known."""
    layer = _layer(result, number)
    unknown = result.modulus_pa is None and number == len(result.layers or ()) - 1
    return value_and_ends(None if unknown else layer.modulus_pa, layer.modulus_interval_pa, 1e6)


def _thickness(layer: LayerResult) -> tuple[str, str]:
    return value_and_ends(layer.thickness_m, layer.thickness_interval_m)


def _pulse(result: DropResult) -> HalfSinePulse:
    return result.half_sine or HalfSinePulse()


_GROUND: dict[str, Callable[[DropResult], str]] = {
    "drop": lambda result: _text(result.drop),
    "E MPa": _modulus,
    "95 % MPa": _interval,
    "η kPa s": _with_deviation("viscosity", "pa_s", 1e3),
    "ρ kg/m³": _with_deviation("density", "kg_m3"),
    "bedrock m": depth_of_rock,
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
    "verdict": verdict_of_fit,
}


def _finite(value: float | None, scale: float = 1.0) -> float | None:
    """A number over `scale`; None when there is none or it is not finite."""
    return float(value) / scale if value is not None and math.isfinite(value) else None


def _text(value: object) -> str:
    return NOTHING if value is None else clean(value)


def _short(value: float | None) -> str:
    """Three digits that count, or all digits before the point when there are more."""
    return NOTHING if value is None else significant(value)


def percent(part: float | None) -> str:
    """A part of one as percent, with two digits that count: a residual is not known better."""
    value = _finite(part, 1e-2)
    return NOTHING if value is None else significant(value, 2)


def _fixed(value: float | None, decimals: int) -> str:
    return NOTHING if value is None else f"{value:.{decimals}f}"


def drop_line(point: str, number: int, result: DropResult) -> str:
    """One drop on one line, as it comes from the instrument; the modulus with all it rests on.

    Parameters
    ----------
    point : str
    number : int
        Of the drop within the point.
    result : DropResult
    """
    name = f"{clean(point)}/{number}"
    modulus = _finite(result.modulus_pa, 1e6)
    status = _text(result.status)
    if modulus is None:
        return f"{name}  {status}" + (f": {clean(result.reason)}" if result.reason else "")
    parts = [
        f"{name}  E {_modulus(result)} MPa ({_interval(result)})",
        f"{_text(result.model)}, {_text(result.plate)} plate "
        f"{_fixed(_finite(result.plate_radius_m), 3)} m, "
        f"ν {_short(_finite(result.poisson_ratio))}",
        f"{peak_load(result)} kN",
        f"residual {percent(result.residual_rms_over_peak)} %",
        _text(result.method),
    ]
    parts += ["seating"] if status == "seating" else []
    parts += [] if result.explained is not False else ["NOT EXPLAINED"]
    parts += [f"AT BOUND {clean(name)}" for name in result.at_bound or ()]
    return "  ".join(parts)
