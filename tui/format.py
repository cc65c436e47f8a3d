"""Results as text for people: units shown, numbers never cut, nothing of a terminal's mark-up."""

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence

from pfwd_survey.exporting.json_text import json_text
from pfwd_survey.inverting.results import DropResult, HalfSinePulse, LayerResult
from tui.output import clean

NOTHING = "-"


def printed_results(results: Sequence[DropResult], *, as_json: bool) -> list[str]:
    """The results of ``pfwd invert`` as they are printed: for machines, or for people."""
    return [json_text(r.to_json()) for r in results] if as_json else result_lines(results)


def result_lines(results: Sequence[DropResult]) -> list[str]:
    """The results of ``pfwd invert`` as lines of text.

    Parameters
    ----------
    results : sequence of DropResult
        One a drop.

    Returns
    -------
    list of str
        For every file a line with what the numbers rest on, a table of the ground, a table of the
        pulse and the fit, the rejected drops and the warnings. The tables are made for 80 columns.
    """
    lines = []
    for file, group in itertools.groupby(results, key=lambda result: result.file):
        of_file = list(group)
        lines.append(clean(file))
        used = [result for result in of_file if result.status != "rejected"]
        for settings, same in itertools.groupby(used, key=_settings):
            rows = list(same)
            lines += [f"  {line}" for line in settings]
            lines += _table(_GROUND, rows)
            lines += _layer_lines(rows)
            lines += _table(_PULSE, rows)
            lines += _search_lines(rows)
        lines += [
            f"  drop {_text(result.drop)} rejected: {_text(result.reason)}"
            for result in of_file
            if result.status == "rejected"
        ]
        lines += _warning_lines(of_file)
    return lines


def _settings(result: DropResult) -> tuple[str, ...]:
    """What the numbers of a drop rest on; equal for drops that can share a table."""
    return (
        f"plate radius {_fixed(_finite(result.plate_radius_m), 3)} m, {_text(result.plate)}; "
        f"Poisson's ratio {_short(_finite(result.poisson_ratio))}; "
        f"peak-method factor {_short(_finite(result.peak_factor))}",
        f"model {_text(result.model)}, load {_text(result.load)}, "
        f"method {_text(result.method)}, seed {_text(result.seed)}",
    )


def _layer_lines(rows: Iterable[DropResult]) -> list[str]:
    """A table of the layers of every drop that has more than one, and what stands for all."""
    lines = []
    layered = [row for row in rows if row.layers is not None and len(row.layers) > 1]
    found = [(row, number) for row in layered for number in range(len(row.layers or ()))]
    if found:
        cells = [list(_LAYER), *([show(*item) for show in _LAYER.values()] for item in found)]
        lines += _aligned(cells)
    for row in layered:
        modulus = _finite(row.effective_modulus_pa, 1e6)
        ends = _ends(row.effective_modulus_interval_pa, 1e6)
        lines.append(
            f"  drop {_text(row.drop)}: one modulus for all {_short(modulus)} MPa ({ends}), down "
            f"to {_short(_finite(row.effective_depth_m))} m"
        )
    return lines


def _search_lines(rows: Iterable[DropResult]) -> list[str]:
    """What went wrong with a search; nothing for a drop whose search went well."""
    lines = []
    for row in rows:
        bounds = ", ".join(map(clean, row.at_bound or ()))
        faults = [] if row.converged else ["NOT CONVERGED"]
        faults += [f"AT BOUND: {bounds}"] if bounds else []
        if faults:
            lines.append(f"  drop {_text(row.drop)}: {'; '.join(faults)}")
    return lines


def _warning_lines(results: Iterable[DropResult]) -> list[str]:
    drops: dict[str, list[str]] = {}
    for result in results:
        for warning in result.warnings or ():
            drops.setdefault(clean(warning), []).append(_text(result.drop))
    return [
        f"  warning, drop{'s' if len(numbers) > 1 else ''} {', '.join(numbers)}: {warning}"
        for warning, numbers in drops.items()
    ]


def _table(
    columns: Mapping[str, Callable[[DropResult], str]], rows: Sequence[DropResult]
) -> list[str]:
    return _aligned([list(columns), *([show(row) for show in columns.values()] for row in rows)])


def _aligned(cells: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return [
        "  " + "  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True))
        for row in cells
    ]


def _with_deviation(key: str, unit: str, scale: float = 1.0) -> Callable[[DropResult], str]:
    """Shows ``<key>_<unit>`` over `scale` with its standard deviation."""

    def show(result: DropResult) -> str:
        value = _finite(getattr(result, f"{key}_{unit}"), scale)
        deviation = _finite(getattr(result, f"{key}_sd_{unit}"), scale)
        if value is None:
            return NOTHING
        if deviation is None:
            # Whatever has a value but no deviation was given, except the modulus, which never is.
            return _short(value) if key == "modulus" else f"{_short(value)} given"
        # Never more digits than the value is worth, however small the noise of its fit.
        decimals = min(_decimals(deviation or value, digits=2), _decimals(value, digits=4))
        least = 10.0**-decimals
        if 0.0 < deviation < 0.5 * least:
            return f"{value:.{decimals}f} ±<{least:.{decimals}f}"
        return f"{value:.{decimals}f} ± {deviation:.{decimals}f}"

    return show


def _interval(result: DropResult) -> str:
    return _ends(result.modulus_interval_pa, 1e6)


def _ends(ends: tuple[float, float] | None, scale: float = 1.0) -> str:
    """An interval over `scale`, with the digits that its width is worth."""
    if ends is None or not all(map(math.isfinite, ends)):
        return NOTHING
    low, high = (end / scale for end in ends)
    decimals = _decimals((high - low) / 2, digits=2)
    return f"{low:.{decimals}f} to {high:.{decimals}f}"


def _peak_load(result: DropResult) -> str:
    return _short(_finite(result.half_sine_load_n, 1e3))


def _layer(result: DropResult, number: int) -> LayerResult:
    return (result.layers or ())[number]


def _layer_modulus(result: DropResult, number: int) -> float | None:
    """MPa; of the lowest layer what the result says of the subgrade: nothing if not known."""
    layers = result.layers or ()
    if result.modulus_pa is None and number == len(layers) - 1:
        return None
    return _finite(layers[number].modulus_pa, 1e6)


def _pulse(result: DropResult) -> HalfSinePulse:
    return result.half_sine or HalfSinePulse()


_GROUND: dict[str, Callable[[DropResult], str]] = {
    "drop": lambda result: _text(result.drop),
    "E MPa": _with_deviation("modulus", "pa", 1e6),
    "95 % MPa": _interval,
    "η kPa s": _with_deviation("viscosity", "pa_s", 1e3),
    "ρ kg/m³": _with_deviation("density", "kg_m3"),
    "bedrock m": _with_deviation("bedrock_depth", "m"),
}
_LAYER: dict[str, Callable[[DropResult, int], str]] = {
    "drop": lambda result, number: _text(result.drop),
    "layer": lambda result, number: str(number + 1),
    "E MPa": lambda result, number: _short(_layer_modulus(result, number)),
    "95 % MPa": lambda result, number: _ends(_layer(result, number).modulus_interval_pa, 1e6),
    "h m": lambda result, number: _short(_finite(_layer(result, number).thickness_m)),
    "95 % m": lambda result, number: _ends(_layer(result, number).thickness_interval_m),
    "η kPa s": lambda result, number: _short(_finite(_layer(result, number).viscosity_pa_s, 1e3)),
    "ρ kg/m³": lambda result, number: _short(_finite(_layer(result, number).density_kg_m3)),
}
_PULSE: dict[str, Callable[[DropResult], str]] = {
    "drop": lambda result: _text(result.drop),
    "kind": lambda result: _text(result.status),
    "kN": _peak_load,
    "kPa": lambda result: _short(_finite(_pulse(result).peak_pressure_pa, 1e3)),
    "ms": lambda result: _short(_finite(_pulse(result).duration_s, 1e-3)),
    "peak E MPa": lambda result: _short(_finite(result.peak_modulus_pa, 1e6)),
    "R²": lambda result: _fixed(_finite(result.r_squared), 4),
    "residual %": lambda result: _short(_finite(result.residual_rms_over_peak, 1e-2)),
    "contact %": lambda result: _short(_finite(result.contact_residual_rms_over_peak, 1e-2)),
}


def _finite(value: float | None, scale: float = 1.0) -> float | None:
    """A number over `scale`; None when there is none or it is not finite."""
    return float(value) / scale if value is not None and math.isfinite(value) else None


def _text(value: object) -> str:
    return NOTHING if value is None else clean(value)


def _short(value: float | None) -> str:
    """Three digits that count, or all digits before the point when there are more."""
    return NOTHING if value is None else _fixed(value, _decimals(value, digits=3))


def _fixed(value: float | None, decimals: int) -> str:
    return NOTHING if value is None else f"{value:.{decimals}f}"


def _decimals(value: float, digits: int) -> int:
    """Decimals that show so many digits that count, at most six."""
    if value == 0:
        return 0
    return min(6, max(0, digits - 1 - math.floor(math.log10(abs(value)))))


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
        f"{name}  E {_short(modulus)} MPa ({_interval(result)})",
        f"{_text(result.model)}, {_text(result.plate)} plate "
        f"{_fixed(_finite(result.plate_radius_m), 3)} m, "
        f"ν {_short(_finite(result.poisson_ratio))}",
        f"{_peak_load(result)} kN",
        f"residual {_short(_finite(result.residual_rms_over_peak, 1e-2))} %",
        _text(result.method),
    ]
    parts += ["seating"] if status == "seating" else []
    parts += [] if result.explained is not False else ["NOT EXPLAINED"]
    parts += [f"AT BOUND {clean(name)}" for name in result.at_bound or ()]
    return "  ".join(parts)
