"""Numbers as texts of a report: with unit and justified digits, a modulus with its interval."""

from collections.abc import Collection, Sequence
from typing import Any

from inversion.records import is_number
from pfwd.analysis.results import DropResult
from pfwd.digits import significant, with_ends
from pfwd.procedures import PointValue, Quantity
from pfwd.procedures.point import UNSUPPORTED_MARK
from pfwd.report.blocks import Table
from pfwd.report.texts import Texts
from pfwd.units import SI, Fact
from pfwd_plugins.quantities import Unit

NO_VALUE = "–"


def symbol_title(symbol: str, unit: str) -> str:
    """Return the title of a column that a symbol names, on one line."""
    return f"{symbol},\N{NO-BREAK SPACE}{unit}"


def with_interval(
    value: float,
    interval: Any,
    unit: str,
    texts: Texts,
    missing: str = "unknown_interval",
    *,
    marked: bool = False,
) -> str:
    """Return a value with its 95 % interval, or with the words that there is none.

    Parameters
    ----------
    value : float
        In the unit.
    interval : pair of float, in the unit, or None
    unit : str
    texts : Texts
    missing : str
        Key of the words for a missing interval.
    marked : bool
        Whether the data do not support the value.
    """
    mark = UNSUPPORTED_MARK if marked else ""
    if not interval or not all(is_number(end) for end in interval):
        return f"{f'{significant(value)}{mark} {unit}'.strip()} ({texts[missing]})"
    number, low, high = with_ends(value, (interval[0], interval[1]))
    # Broken between value and interval, if at all.
    value_text = number + mark + (f"\N{NO-BREAK SPACE}{unit}" if unit else "")
    gap = "\N{NO-BREAK SPACE}–\N{NO-BREAK SPACE}"
    return f"{value_text} ({low}{gap}{high})"


def with_deviation(
    value: Any, deviation: Any, scale: float, unit: str, relative: float = 0.0
) -> str:
    """Return a value with its standard deviation as a text; a dash if it is not known.

    Parameters
    ----------
    value, deviation : float, or anything that is none
    scale : float
    unit : str
    relative : float
        Smallest spread over the value that the digits are for, where the deviation is not all.
    """
    if not is_number(value):
        return NO_VALUE
    sd = deviation if is_number(deviation) else None
    return SI.show(Fact(Unit(unit, 1.0 / scale), value, deviation=sd, spread=relative))


def depth_of(result: DropResult, texts: Texts, unit: str = "m") -> str:
    """Return the depth of the rock with its interval; a dash if the model has no rock."""
    depth = result.bedrock_depth_m
    if not is_number(depth):
        return NO_VALUE
    if result.bedrock_depth_sd_m is None:
        return f"{significant(depth)} {unit}".rstrip()
    return with_interval(depth, result.bedrock_depth_interval_m, unit, texts)


def modulus_of(result: DropResult | None, texts: Texts, unit: str = "MPa") -> str:
    """Return the modulus of a result with its interval, MPa."""
    if result is None:
        return NO_VALUE
    if not is_number(result.modulus_pa):
        return texts["no_result"]
    marked = result.not_supported is not None
    return in_megapascals(result.modulus_pa, result.modulus_interval_pa, texts, unit, marked=marked)


def in_megapascals(
    value: float | None,
    interval: Sequence[float] | None,
    texts: Texts,
    unit: str = "MPa",
    *,
    marked: bool = False,
) -> str:
    """Return a modulus in Pa with its interval as a text in MPa; a dash if it is not known."""
    if value is None:
        return NO_VALUE
    ends = None if interval is None else [end / 1e6 for end in interval]
    return with_interval(value / 1e6, ends, unit, texts, marked=marked)


def basis_of(result: DropResult | None, texts: Texts, *, with_depth: bool = True) -> str:
    """Return the model, the plate and Poisson's ratio that a modulus depends on."""
    if result is None or result.model is None:
        return NO_VALUE
    model = texts.word(result.model)
    if result.layers and len(result.layers) > 1:
        model = f"{texts.say('lowest_of', count=len(result.layers))}, {model}"
    if with_depth and result.bedrock_depth_m is not None:
        depth, ends = result.bedrock_depth_m, result.bedrock_depth_interval_m
        if result.bedrock_depth_sd_m is None or ends is None:
            model = on_rock(model, f"{significant(depth)} m", texts)
        else:
            _, low, high = with_ends(depth, ends)
            model = on_rock(model, f"{low} – {high} m", texts)
    plate = f"{texts.word(str(result.plate))} {_plain(result.plate_radius_m)} m"
    return f"{model}, {plate}, ν {_plain(result.poisson_ratio)}"


def on_rock(model: str, depth: str, texts: Texts) -> str:
    """Return a model with the depth of its rock; without a depth the model alone."""
    return texts.say("rock_at", model=model, depth=depth) if depth else model


def value_of(value: PointValue | None, texts: Texts) -> str:
    """Return the judged value of a point with its interval."""
    if value is None:
        return NO_VALUE
    unit, scale = value.quantity.display_unit
    marked = value.not_supported is not None
    if value.interval is None and value.drop_range is not None:
        smallest, largest = value.drop_range
        _, low, high = with_ends(value.value / scale, (smallest / scale, largest / scale))
        number = f"{significant(value.value / scale)}{UNSUPPORTED_MARK if marked else ''} {unit}"
        return f"{number} ({texts.say('drop_range', count=value.drops, low=low, high=high)})"
    interval = None if value.interval is None else [end / scale for end in value.interval]
    return with_interval(value.value / scale, interval, unit, texts, "one_drop", marked=marked)


def value_basis(value: PointValue | None, texts: Texts) -> str:
    """Return the numbers of the formula of a judged value: factor, radius, pressure, count."""
    if value is None:
        return NO_VALUE
    parts = []
    if value.factor is not None:
        parts.append(f"k = {value.factor:g}")
    if value.poisson_ratio is not None:
        parts.append(f"ν = {value.poisson_ratio:g}")
    if value.plate_radius is not None:
        parts.append(f"r = {value.plate_radius:g} m")
    if value.pressure is not None:
        parts.append(f"σ = {value.pressure / 1e3:.0f} kPa")
    parts.append(f"n = {value.drops}")
    return ", ".join(parts)


def name_of(quantity: Quantity, texts: Texts) -> str:
    """Return the name of the judged quantity in the language of the report."""
    names = {
        Quantity.MODULUS: texts["modulus"],
        Quantity.EQUIVALENT_MODULUS: texts["equivalent_modulus"],
        Quantity.DEFLECTION: texts["deflection"],
    }
    return names.get(quantity, str(quantity))


def target_of(target: float | None, quantity: Quantity) -> str:
    """Return a target with its unit and its direction."""
    if target is None:
        return NO_VALUE
    unit, scale = quantity.display_unit
    return f"{'≤' if quantity is Quantity.DEFLECTION else '≥'} {target / scale:g} {unit}"


def percent(value: Any, count: int = 2) -> str:
    """Return a fraction as a text in percent."""
    return f"{significant(value * 100, count)} %" if is_number(value) else NO_VALUE


def scaled(value: Any, scale: float, unit: str, count: int = 3) -> str:
    """Return a number times a scale as a text with a unit; a dash if it is not known."""
    return f"{significant(value * scale, count)} {unit}".rstrip() if is_number(value) else NO_VALUE


def without_empty_columns(table: Table, always: Collection[str] = ()) -> Table:
    """Return a table without the columns that have no value in any row, but for some titles."""
    columns = [
        place
        for place, title in enumerate(table.columns)
        if title in always or any(row[place] not in (NO_VALUE, "") for row in table.rows)
    ]
    return Table(
        tuple(table.columns[place] for place in columns),
        tuple(tuple(row[place] for place in columns) for row in table.rows),
        tuple(new for new, place in enumerate(columns) if place in table.right),
    )


def _plain(value: Any) -> str:
    return f"{value:g}" if is_number(value) else NO_VALUE
