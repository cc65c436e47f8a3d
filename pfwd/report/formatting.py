"""Numbers of a report as texts: with unit, justified digits and the sign of the language."""

import re
from collections.abc import Iterable, Sequence
from statistics import fmean
from typing import NamedTuple

from inversion.notices import RANGE_DASH
from pfwd import digits, units
from pfwd.analysis.results import DropResult
from pfwd.facts import fact_of_value, facts_of_drop
from pfwd.procedures import PointValue, Quantity
from pfwd.report.blocks import Mark, Table
from pfwd.report.texts import Texts
from pfwd.units import SI, Fact, QuantityName
from pfwd_plugins.quantities import Measurand, Unit

NO_VALUE = "–"

_INNER_SPACE = re.compile(r"(?<=[\d*±–]) | (?=[\d±–])")
"""Space beside a number, but not the one before a bracket."""


def symbol_title(symbol: str, unit: str) -> str:
    """Return the title of a column that a symbol names, on one line."""
    return f"{symbol},\N{NO-BREAK SPACE}{unit}"


def show(fact: Fact, texts: Texts, *, with_unit: bool = True) -> str:
    """Return a fact as a text that breaks only between value and interval; a dash for none."""
    text = SI.show(fact, texts.figures, with_unit=with_unit)
    return NO_VALUE if text == digits.MISSING else _INNER_SPACE.sub("\N{NO-BREAK SPACE}", text)


def number(quantity: QuantityName | Measurand | Unit, value: float | None, texts: Texts) -> str:
    """Return a value whose uncertainty is not known, without its unit; a dash for none."""
    return show(Fact(quantity, value), texts, with_unit=False)


def mean(
    quantity: QuantityName | Measurand | Unit, values: Iterable[float | None], texts: Texts
) -> str:
    """Return the mean of those values that are known; a dash for none."""
    recorded = [value for value in values if value is not None]
    return number(quantity, fmean(recorded) if recorded else None, texts)


def declared(value: float | None, texts: Texts, unit: str = "") -> str:
    """Return a declared number as it was given; a dash for none."""
    return NO_VALUE if value is None else texts.decimals(digits.declared(value, unit))


def percent(part: float | None, texts: Texts) -> str:
    """Return a fraction as a text in percent; a dash for none."""
    text = units.percent(part)
    return NO_VALUE if text == digits.MISSING else texts.decimals(text)


def ends(lowest: str, highest: str) -> str:
    """Return a range; one text where both ends have the same text."""
    return f" {RANGE_DASH} ".join(dict.fromkeys((lowest, highest)))


def place_of_sensor(offset: float, texts: Texts) -> str:
    """Return the distance of a sensor from the centre of the plate, m."""
    return texts["centre"] if offset == 0 else declared(offset, texts, "m")


def plate_text(plate: str | None, radius: float | None, ratio: float | None, texts: Texts) -> str:
    """Return the model of a plate with its radius, m, and Poisson's ratio of the ground."""
    return f"{texts.word(str(plate))} {declared(radius, texts, 'm')}, ν {declared(ratio, texts)}"


def basis_of(result: DropResult | None, texts: Texts, *, with_depth: bool = True) -> str:
    """Return the model, the plate and Poisson's ratio that a modulus depends on."""
    if result is None or result.model is None:
        return NO_VALUE
    model = texts.word(result.model)
    if result.layers and len(result.layers) > 1:
        model = f"{texts.say('lowest_of', count=len(result.layers))}, {model}"
    if with_depth and result.bedrock_depth_m is not None:
        model = on_rock(model, show(facts_of_drop(result)["bedrock"], texts), texts)
    plate = plate_text(result.plate, result.plate_radius_m, result.poisson_ratio, texts)
    return f"{model}, {plate}"


def on_rock(model: str, depth: str, texts: Texts) -> str:
    """Return a model with the depth of its rock; without a depth the model alone."""
    return texts.say("rock_at", model=model, depth=depth) if depth else model


def value_of(value: PointValue | None, texts: Texts) -> str:
    """Return the judged value of a point with its interval."""
    fact = fact_of_value(value)
    return show(fact if fact.interval else fact._replace(note="one_drop"), texts)


def value_basis(value: PointValue | None, texts: Texts) -> str:
    """Return the numbers of the formula of a judged value: factor, radius, pressure, count."""
    if value is None:
        return NO_VALUE
    pressure = show(Fact("pressure", value.pressure), texts)
    numbers = (
        ("k", declared(value.factor, texts)),
        ("ν", declared(value.poisson_ratio, texts)),
        ("r", declared(value.plate_radius, texts, "m")),
        ("σ", pressure),
        ("n", str(value.drops)),
    )
    return ", ".join(f"{symbol} = {text}" for symbol, text in numbers if text != NO_VALUE)


def name_of(quantity: Quantity, texts: Texts) -> str:
    """Return the name of the judged quantity in the language of the report."""
    names = {
        Quantity.MODULUS: texts["modulus"],
        Quantity.EQUIVALENT_MODULUS: texts["equivalent_modulus"],
        Quantity.DEFLECTION: texts["deflection"],
    }
    return names.get(quantity, str(quantity))


def target_of(target: float | None, quantity: Quantity, texts: Texts) -> str:
    """Return a target with its unit and its direction."""
    if target is None:
        return NO_VALUE
    unit, scale = quantity.display_unit
    sign = "≤" if quantity is Quantity.DEFLECTION else "≥"
    return f"{sign} {declared(target / scale, texts, unit)}"


class Column(NamedTuple):
    """A column of a table."""

    title: str
    cells: Sequence[str | Mark]
    right: bool = True
    """True: numbers, aligned to the right."""
    always: bool = False
    """True: it stays without any value, too."""


def table(*columns: Column) -> Table:
    """Return a table without the columns that have no value in any row."""
    filled = [
        column
        for column in columns
        if column.always or any(cell not in (NO_VALUE, "") for cell in column.cells)
    ]
    rows = tuple(zip(*(column.cells for column in filled), strict=True))
    right = tuple(place for place, column in enumerate(filled) if column.right)
    return Table(tuple(column.title for column in filled), rows, right)
