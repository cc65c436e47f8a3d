"""Numbers as texts of a report: with unit and justified digits."""

import re
from collections.abc import Collection
from typing import Any

from inversion.records import is_number
from pfwd.analysis.results import DropResult
from pfwd.digits import MISSING, significant
from pfwd.facts import fact_of_value, facts_of_drop
from pfwd.procedures import PointValue, Quantity
from pfwd.report.blocks import Table
from pfwd.report.texts import Texts
from pfwd.units import SI, Fact

NO_VALUE = "–"

_INNER_SPACE = re.compile(r"(?<=[\d*±–]) | (?=[\d±–])")
"""Space beside a number, but not the one before a bracket."""


def symbol_title(symbol: str, unit: str) -> str:
    """Return the title of a column that a symbol names, on one line."""
    return f"{symbol},\N{NO-BREAK SPACE}{unit}"


def show(fact: Fact, texts: Texts, *, with_unit: bool = True) -> str:
    """Return a fact as a text that breaks only between value and interval; a dash for none."""
    text = SI.show(fact, texts.figures, with_unit=with_unit)
    return NO_VALUE if text == MISSING else _INNER_SPACE.sub("\N{NO-BREAK SPACE}", text)


def basis_of(result: DropResult | None, texts: Texts, *, with_depth: bool = True) -> str:
    """Return the model, the plate and Poisson's ratio that a modulus depends on."""
    if result is None or result.model is None:
        return NO_VALUE
    model = texts.word(result.model)
    if result.layers and len(result.layers) > 1:
        model = f"{texts.say('lowest_of', count=len(result.layers))}, {model}"
    if with_depth and result.bedrock_depth_m is not None:
        model = on_rock(model, show(facts_of_drop(result)["bedrock"], texts), texts)
    plate = f"{texts.word(str(result.plate))} {_plain(result.plate_radius_m)} m"
    return f"{model}, {plate}, ν {_plain(result.poisson_ratio)}"


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
