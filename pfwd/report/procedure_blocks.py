"""The part of a report on the procedure: its numbers, where each is from, what is enforced."""

from pfwd.procedures import Number, Procedure, Quantity
from pfwd.procedures.profile import CHECKS
from pfwd.report.blocks import Block, Heading, Pairs, Paragraph, Table
from pfwd.report.localising import with_decimals
from pfwd.report.texts import Texts

_NUMBER_UNITS = {
    "seating": (1.0, ""),
    "measured": (1.0, ""),
    "factor": (1.0, ""),
    "nominal_pressure_pa": (1e-3, "kPa"),
    "nominal_load_n": (1e-3, "kN"),
    "poisson_ratio": (1.0, ""),
    "plate_radius_m": (1.0, "m"),
    **{key: (check.scale, check.unit) for key, check in CHECKS.items()},
}


def procedure_blocks(procedure: Procedure, texts: Texts) -> list[Block]:
    """The procedure with all its numbers."""
    blocks: list[Block] = [
        Heading(f"{texts['procedure']}: {texts.title(procedure.title)}"),
        Pairs(((texts["procedure"], procedure.name), (texts["source"], procedure.source))),
    ]
    if procedure.about:
        blocks.append(Paragraph(texts.source(texts.title(procedure.about)), "note"))
    rows = []
    for key, number in procedure.numbers().items():
        rows.append(
            (
                texts.number_name(key),
                with_decimals(_number(procedure, key, number), texts),
                texts.source(number.source),
                _state(procedure, number, texts),
            )
        )
    if rows:
        columns = (texts["number"], texts["value"], texts["source"], "")
        blocks.append(Table(columns, tuple(rows), (1,)))
    return blocks


def _number(procedure: Procedure, key: str, number: Number) -> str:
    scale, unit = _NUMBER_UNITS.get(key, (1.0, ""))
    if key.startswith("target"):
        deflection = procedure.quantity is Quantity.DEFLECTION
        scale, unit = (1e3, "mm") if deflection else (1e-6, "MPa")
    for suffix in ("_pa", "_n", "_m"):
        if not unit and key.endswith(suffix):
            unit = {"_pa": "Pa", "_n": "N", "_m": "m"}[suffix]
    return f"{number.value * scale:g} {unit}".strip()


def _state(procedure: Procedure, number: Number, texts: Texts) -> str:
    if number.verified:
        return texts["verified"]
    return texts["enforced_unverified" if procedure.enforce_unverified else "not_verified"]
