"""The slip of a point: one page with its verdict, a signature and a QR code of its data."""

import hashlib
from collections.abc import Sequence
from functools import partial
from typing import Any

from pfwd.judging import DropView, PointView, value_of_drop
from pfwd.procedures import Quantity
from pfwd.report import formatting
from pfwd.report.blocks import Block, Heading, Pairs, Paragraph, Picture, Table
from pfwd.report.certificate_blocks import (
    certificate_rows,
    curve_blocks,
    logo_blocks,
    unsupported_note,
)
from pfwd.report.content import Report
from pfwd.report.drawing import blank_axes, draw_signature
from pfwd.report.fonts import Letters
from pfwd.report.formatting import Column, mean, number
from pfwd.report.gathering import ReportOptions
from pfwd.report.point_blocks import position_text
from pfwd.report.point_facts import (
    diagnosis_counts,
    drop_columns,
    equivalent_text,
    modulus_text,
    target_notes,
    time_of,
    used_drops,
    verdict_mark,
)
from pfwd.report.texts import Texts
from pfwd.units import Fact
from pfwd_plugins.quantities import Measurand

_CODE_HEIGHT = 38.0
"""Height of the QR code and of the lines to sign on beside it, mm."""


def slip_blocks(
    report: Report, texts: Texts, letters: Letters, options: ReportOptions
) -> list[Block]:
    """Return the blocks of the page.

    Parameters
    ----------
    report : Report
        Of one point, which has several parts if its plate was changed.
    texts : Texts
    letters : Letters
    options : ReportOptions
        Company, logo and signature.
    """
    point = report.points[0]
    heading = Heading(f"{texts['slip']}: {texts['point']} {point.shown_name}", level=1)
    facts = [row for row in certificate_rows(report, texts) if row[1]]
    facts = [row for row in facts if row[0] not in (texts["points"], texts["verdict"])]
    facts += _measured(point, report, texts)
    verdict = Table(
        (texts["verdict"], formatting.name_of(report.procedure.quantity, texts), texts["target"]),
        (
            (
                verdict_mark(point, texts),
                formatting.value_of(point.progress.value, texts),
                formatting.target_of(point.progress.target, report.procedure.quantity, texts),
            ),
        ),
    )
    blocks: list[Block] = [
        *logo_blocks(options.company, options.logo, texts),
        heading,
        Paragraph(options.company or report.title, "note"),
        Pairs(tuple(facts)),
        verdict,
        Paragraph(texts.message(point.progress.verdict_reason)),
        *target_notes(report, texts),
        *unsupported_note(report, texts),
        _drops(report, texts),
        *curve_blocks(report, texts, letters),
    ]
    checksum = checksum_of(report)
    payload = payload_of(report, checksum)
    draw = partial(
        draw_code_and_signature,
        payload=payload,
        signed=None if options.signed is None else letters.drawable(options.signed),
        labels=(texts["sign_place"], texts["sign_operator"]),
    )
    alternative = f"{texts['qr_code']}: {payload}"
    if options.signed is not None:
        alternative += f"; {texts['sign_operator']}: {options.signed}"
    return [
        *blocks,
        Picture(draw, _CODE_HEIGHT, texts["qr_code_note"], alternative),
        Pairs(
            (
                (texts["checksum"], checksum or formatting.NO_VALUE),
                (texts["survey"], report.survey_id),
            )
        ),
    ]


def _measured(point: PointView, report: Report, texts: Texts) -> list[tuple[str, str]]:
    """Return mean settlement, s/v, the fitted modulus that is not judged, and the coordinates."""
    depth = mean("settlement", (drop.facts.peak_deflection for drop in used_drops(point)), texts)
    rows = (
        ("s\N{COMBINING MACRON}", "" if depth == formatting.NO_VALUE else f"{depth} mm"),
        (texts["s_over_v"], formatting.show(Fact("duration", point.progress.s_over_v), texts)),
        *_not_judged(point, report.procedure.quantity, texts),
        (texts["coordinates"], position_text(point.place, texts)),
    )
    return [row for row in rows if row[1] not in ("", formatting.NO_VALUE)]


def _not_judged(point: PointView, judged: Quantity, texts: Texts) -> list[tuple[str, str]]:
    if judged is Quantity.MODULUS:
        return [(texts["equivalent_modulus"], equivalent_text(point, texts))]
    is_equivalent = judged is Quantity.EQUIVALENT_MODULUS
    return [(texts["modulus"], modulus_text(point, texts))] if is_equivalent else []


def _value_of_drop(point: PointView, drop: DropView, texts: Texts) -> str:
    """Return the value of a drop; one that the data do not support is missing."""
    value = value_of_drop(point.job, drop)
    if value is None or value.not_supported is not None or drop.facts.record_fault is not None:
        return formatting.NO_VALUE
    return number(value.quantity.dimension, value.value, texts)


def _drops(report: Report, texts: Texts) -> Table:
    drops = [(p, drop) for p in report.points for drop in p.drops]
    facts = [facts for point in report.points for facts in point.facts]
    kinds = [
        str(dict(p.progress.kinds).get(f.number, f.kind)) for p in report.points for f in p.facts
    ]
    quantity = report.procedure.quantity
    columns = [
        Column(texts["drop"], [str(drop.number) for _, drop in drops]),
        Column(texts["kind"], [texts[kind] for kind in kinds], right=False),
        Column(
            texts["used"],
            [texts["yes" if drop.number in p.progress.used else "no"] for p, drop in drops],
            right=False,
        ),
        *drop_columns(facts, texts),
        Column(
            formatting.symbol_title("v", "mm/s"),
            [number(Measurand.VELOCITY, drop.peak_velocity, texts) for drop in facts],
        ),
    ]
    # The diagnosis has one modulus for all drops.
    if not (quantity.is_fitted and any(map(diagnosis_counts, report.points))):
        title = f"{formatting.name_of(quantity, texts)}, {quantity.display_unit.name}"
        columns.append(Column(title, [_value_of_drop(p, drop, texts) for p, drop in drops]))
    return formatting.table(*columns)


def checksum_of(report: Report) -> str:
    """Return the SHA-256 of the list of the point's drop files with theirs; empty: no file.

    It is that of ``sha256sum drop-*.h5 | sha256sum`` on the files of the point.
    """
    lines = [
        f"{report.checksums[drop.record]}  drop-{drop.record:06d}.h5\n"
        for point in report.points
        for drop in point.drops
        if drop.record is not None and drop.record in report.checksums
    ]
    return hashlib.sha256("".join(lines).encode()).hexdigest() if lines else ""


def payload_of(report: Report, checksum: str) -> str:
    """Return the text of the QR code: point, time and checksum, a line each."""
    point = report.points[0]
    return f"point: {point.shown_name}\ntime: {time_of(point)}\nsha256: {checksum}"


def draw_code_and_signature(
    figure: Any, payload: str, signed: str | None, labels: Sequence[str]
) -> None:
    """Draw the QR code at the left, and lines to sign on at the right.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    payload : str
    signed : str or None
        Name on the last line, as its typed signature; None: the line is empty.
    labels : sequence of str
        What stands below the lines.
    """
    import segno

    width, height = figure.get_size_inches()
    code = figure.add_axes((0.0, 0.0, float(height / width), 1.0))
    rows = [bytes(row) for row in segno.make(payload, error="m").matrix]
    for down, row in enumerate(rows):
        dark = [(column, 1) for column, module in enumerate(row) if module]
        code.broken_barh(dark, (down, 1), color="black", linewidth=0, antialiased=False)
    quiet = 4  # modules of the quiet zone that ISO/IEC 18004 asks for
    code.set_xlim(-quiet, len(rows) + quiet)
    code.set_ylim(len(rows) + quiet, -quiet)
    code.set_axis_off()
    lines = blank_axes(figure, float(height / width) + 0.06)
    for place, label in zip((0.66, 0.2), labels, strict=True):
        draw_signature(lines, 0.0, place, 0.9, 0.1, label)
    if signed is not None:
        lines.text(0.01, 0.24, signed, fontsize=13, style="italic", parse_math=False)
