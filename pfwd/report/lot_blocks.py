"""The part of a report on the points as a lot: statistics, zones, plate load tests."""

from collections import Counter
from collections.abc import Sequence
from functools import partial

from pfwd.digits import significant
from pfwd.judging import PointView
from pfwd.procedures import Quantity
from pfwd.report import formatting
from pfwd.report.blocks import Block, Heading, Pairs, Paragraph, Picture, Together
from pfwd.report.content import Report
from pfwd.report.drawing import draw_correlation, draw_lot
from pfwd.report.formatting import NO_VALUE, Column, mean, number
from pfwd.report.lot import Lot, line_through, lot_of
from pfwd.report.point_facts import verdict_of
from pfwd.report.texts import Texts
from pfwd.units import Fact
from pfwd_plugins.quantities import Unit

_HEIGHT, _CORRELATION_HEIGHT = 56.0, 48.0
"""mm."""


def lot_blocks(report: Report, texts: Texts) -> list[Block]:
    """Return the blocks on the points as a lot; none for fewer than three values."""
    valued = [p for p in report.points if not p.discarded and p.progress.value is not None]
    supported = [p for p in valued if p.progress.value and p.progress.value.not_supported is None]
    excluded = [point.shown_name for point in valued if point not in supported]
    unit, scale = report.procedure.quantity.display_unit
    lot = _lot(report, supported, scale)
    if lot is None:
        return []
    name = formatting.name_of(report.procedure.quantity, texts)
    targets = {point.progress.target for point in supported}
    target = targets.pop() if len(targets) == 1 else None
    draw = partial(
        draw_lot,
        lot=lot,
        unit=f"{name}, {unit}",
        target=None if target is None else target / scale,
        texts=texts,
    )
    together: tuple[Block, ...] = (
        Heading(f"{texts['lot']}: {name}"),
        Pairs(tuple(row for row in _rows(lot, supported, excluded, unit, texts) if row[1])),
        Picture(draw, _HEIGHT, texts["lot_note"], texts["lot"]),
    )
    return [
        Together(together),
        *_zones(report, supported, scale, unit, texts),
        *_correlation(report, supported, scale, unit, texts),
    ]


def _lot(report: Report, points: Sequence[PointView], scale: float) -> Lot | None:
    values = [p.progress.value.value / scale for p in points if p.progress.value is not None]
    return lot_of(values, small_is_good=report.procedure.quantity is Quantity.DEFLECTION)


def _rows(
    lot: Lot, points: Sequence[PointView], excluded: Sequence[str], unit: str, texts: Texts
) -> list[tuple[str, str]]:
    names = [point.shown_name for point in points]
    quantity = Unit(unit, 1.0)
    outliers = ", ".join(
        f"{names[i]} ({number(quantity, lot.values[i], texts)})" for i in lot.noticeable
    )
    low, high = lot.mean_interval
    ends = (max(0.0, low), high)
    return [
        (texts["mean"], formatting.show(Fact(quantity, lot.mean, ends), texts)),
        (
            texts["spread_of_points"],
            f"s = {_rough(lot.deviation, texts)} {unit}, "
            f"V = {formatting.percent(lot.variation, texts)}; "
            f"{_extremes(lot.values, texts)} {unit}, "
            f"n = {len(lot.values)}",
        ),
        (texts["characteristic"], _characteristic(lot, unit, texts)),
        (texts["outliers"], outliers or NO_VALUE),
        (texts["passed"], _passed(points, texts)),
        (
            texts["lot_excluded"],
            f"{len(excluded)} ({', '.join(excluded)})" if excluded else "",
        ),
    ]


def _characteristic(lot: Lot, unit: str, texts: Texts) -> str:
    if lot.characteristic <= 0:
        return texts["characteristic_none"]
    return f"{_rough(lot.characteristic, texts)} {unit}"


def _rough(value: float, texts: Texts) -> str:
    """Return an estimate from a few points, which supports two digits."""
    return texts.decimals(significant(value, 2))


def _extremes(values: Sequence[float], texts: Texts) -> str:
    lowest, highest = (texts.decimals(significant(end)) for end in (min(values), max(values)))
    return formatting.ends(lowest, highest)


def _passed(points: Sequence[PointView], texts: Texts) -> str:
    """Return the share of the points with a target that pass."""
    counts = Counter(verdict_of(point) for point in points)
    judged = len(points) - counts["none"]
    if not judged:
        return texts["none"]
    return f"{counts['pass']} / {judged} ({100 * counts['pass'] / judged:.0f} %)"


def _zones(
    report: Report, points: Sequence[PointView], scale: float, unit: str, texts: Texts
) -> list[Block]:
    zones: dict[str, list[PointView]] = {}
    for point in points:
        zone = point.setup.site if point.setup.zone is None else point.setup.zone
        zones.setdefault(NO_VALUE if zone is None else str(zone), []).append(point)
    if len(zones) < 2:
        return []
    lots = [_lot(report, some, scale) for some in zones.values()]
    values = [
        [p.progress.value.value / scale for p in some if p.progress.value is not None]
        for some in zones.values()
    ]
    deviations = [NO_VALUE if lot is None else _rough(lot.deviation, texts) for lot in lots]
    fractiles = [
        NO_VALUE if lot is None else _characteristic(lot, "", texts).strip() for lot in lots
    ]
    means = [mean(Unit(unit, 1.0), of_zone, texts) for of_zone in values]
    extremes = [_extremes(of_zone, texts) for of_zone in values]
    table = formatting.table(
        Column(texts["zone"], list(zones), right=False),
        Column("n", [str(len(of_zone)) for of_zone in values]),
        Column(f"{texts['mean']}, {unit}", means),
        Column(f"s, {unit}", deviations),
        Column(f"{texts['characteristic_short']}, {unit}", fractiles),
        Column(f"min – max, {unit}", extremes, right=False),
        Column(texts["passed"], [_passed(some, texts) for some in zones.values()], right=False),
    )
    return [Heading(texts["zones"], 3), table]


def _correlation(
    report: Report, points: Sequence[PointView], scale: float, unit: str, texts: Texts
) -> list[Block]:
    """Return the comparison with plate load tests at the same points; none without any."""
    pairs = [
        (point.progress.value.value / scale, static / 1e6)
        for point in points
        if point.progress.value is not None
        and (static := point.setup.plate_load_modulus) is not None
    ]
    if not pairs:
        return []
    blocks: list[Block] = [Heading(texts["plate_load"], 3)]
    line = line_through([x for x, _ in pairs], [y for _, y in pairs])
    if line is None:
        return [*blocks, Paragraph(texts.say("plate_load_few", count=len(pairs)), "note")]
    name = formatting.name_of(report.procedure.quantity, texts)
    names = (f"{name}, {unit}", f"{texts['plate_load_axis']}, MPa")
    draw = partial(draw_correlation, pairs=pairs, line=line, names=names, texts=texts)
    sign = "+" if line.slope >= 0 else "−"
    equation = (
        f"{texts['plate_load_axis']} = {significant(line.intercept)} MPa {sign} "
        f"{significant(abs(line.slope))} · {name}; R² = {line.r_squared:.2f}, "
        f"n = {line.pairs}"
    )
    caption = f"{texts.decimals(equation)}. {texts['plate_load_note']}"
    return [*blocks, Picture(draw, _CORRELATION_HEIGHT, caption, texts["plate_load"])]
