"""The parts of a report on drops without a modulus of a history: basins of peaks, rigs."""

from collections.abc import Callable, Collection, Hashable, Iterable, Sequence
from functools import partial

from pfwd.judging import DropView, PointView
from pfwd.peaks.basin import ASSUMED_POISSON_RATIO, Basin, basin_of
from pfwd.peaks.stiffness import Stiffness
from pfwd.procedures import Verdict
from pfwd.report import formatting
from pfwd.report.blocks import Block, Heading, Pairs, Paragraph, Picture, Table
from pfwd.report.content import Report
from pfwd.report.drawing import draw_peaks_profile
from pfwd.report.fonts import Letters
from pfwd.report.formatting import Column, declared, mean, number
from pfwd.report.point_facts import (
    chainage_column,
    remarks_of,
    time_cells,
    used_drops,
    verdict_columns,
    verdict_of,
)
from pfwd.report.texts import Texts
from pfwd.units import QuantityName, unit_of_effect
from pfwd_plugins.quantities import Unit

STIFFNESS = unit_of_effect("N/m")

_PROFILE_HEIGHT = 82.0
"""mm."""


def peaks_blocks(point: PointView, texts: Texts) -> list[Block]:
    """Return the tables of peaks and stiffness of a point; empty if its drops have traces."""
    return [*_basins(point, texts), *_stiffness(point, texts)]


def has_only_peaks(report: Report) -> bool:
    """Return whether no drop of the report has a time history, and none was made on a rig."""
    drops = [drop for point in report.points for drop in point.drops]
    return all(not drop.has_traces and not drop.setup.is_stiffness_test for drop in drops)


def has_only_stiffness(report: Report) -> bool:
    """Return whether all drops of the report were made on a rig of springs."""
    drops = [drop for point in report.points for drop in point.drops]
    return bool(drops) and all(drop.setup.is_stiffness_test for drop in drops)


def stiffness_table(report: Report, texts: Texts) -> Table:
    """Return the mean stiffness of the drops of each point on a rig, a line a point."""
    title, times = time_cells(report, texts)
    on_rig = [
        [d.stiffness for d in point.drops if d.stiffness is not None and d.discarded is None]
        for point in report.points
    ]
    return formatting.table(
        Column(texts["point"], [point.shown_name for point in report.points], right=False),
        Column(title, times, right=False, always=True),
        Column(texts["drops"], [str(len(of_point)) for of_point in on_rig]),
        *_stiffness_columns(on_rig, texts),
    )


def _stiffness_columns(drops: Sequence[Sequence[Stiffness]], texts: Texts) -> Iterable[Column]:
    """Yield the columns of stiffness: a line for the mean of each group of drops."""
    kinds: tuple[tuple[str, QuantityName | Unit, Callable[[Stiffness], float | None]], ...] = (
        (formatting.symbol_title("F", "kN"), "load", lambda drop: drop.peak_load_n),
        (formatting.symbol_title("s", "mm"), "settlement", lambda drop: drop.peak_displacement_m),
        (
            f"{texts['stiffness']}, {texts['secant_stiffness']}, MN/m",
            STIFFNESS,
            lambda drop: drop.secant_n_per_m,
        ),
        (
            f"{texts['stiffness']}, {texts['dynamic_stiffness']}, MN/m",
            STIFFNESS,
            lambda drop: drop.dynamic_n_per_m,
        ),
    )
    for title, quantity, value in kinds:
        yield Column(title, [mean(quantity, map(value, group), texts) for group in drops])


def peaks_table(report: Report, texts: Texts) -> Table:
    """Return every point in one line: mean load, deflection, moduli and indices of its peaks."""
    title, times = time_cells(report, texts)
    points = report.points
    along, chainages = chainage_column(report, texts)
    drops = [used_drops(point) for point in points]
    basins = [[b for drop in used if (b := basin_of_drop(drop)) is not None] for used in drops]
    loads = [mean("load", (drop.facts.peak_load for drop in used), texts) for used in drops]
    depths = [
        mean("deflection", (drop.facts.peak_deflection for drop in used), texts) for used in drops
    ]
    columns = [
        Column(texts["point"], [point.shown_name for point in points], right=False),
        Column(along, chainages),
        Column(title, times, right=False, always=True),
        Column(texts["drops"], [str(len(used)) for used in drops]),
        Column(formatting.symbol_title("F", "kN"), loads),
        Column(formatting.symbol_title("s", "µm"), depths),  # as the indices beside it
        *_basin_columns(basins, texts),
    ]
    if any(point.progress.value is not None for point in points):
        values = [formatting.value_of(point.progress.value, texts) for point in points]
        name = formatting.name_of(report.procedure.quantity, texts)
        columns.append(Column(name, values, right=False))
    if any(verdict_of(point) != Verdict.NONE for point in points):
        columns += verdict_columns(report, texts)
    return formatting.table(*columns)


def _basin_columns(basins: Sequence[Sequence[Basin]], texts: Texts) -> Iterable[Column]:
    """Yield the columns of modulus and indices: a line for the mean of each group of basins."""
    kinds: tuple[tuple[str, QuantityName, Callable[[Basin], float | None]], ...] = (
        (f"{texts['peak_method']}, MPa", "modulus", lambda basin: basin.peak_modulus_pa),
        ("SCI, µm", "deflection", lambda basin: basin.sci_m),
        ("BDI, µm", "deflection", lambda basin: basin.bdi_m),
        ("BCI, µm", "deflection", lambda basin: basin.bci_m),
        ("AREA, mm", "length", lambda basin: basin.area_m),
    )
    for title, quantity, value in kinds:
        yield Column(title, [mean(quantity, map(value, group), texts) for group in basins])


def peaks_profile(report: Report, texts: Texts, letters: Letters) -> list[Block]:
    """Return the picture of deflections and peak moduli along the points; none of one point."""
    points = [point for point in report.points if not point.discarded and used_drops(point)]
    if len(points) < 2:
        return []
    basins = [[basin_of_drop(drop) for drop in used_drops(point)] for point in points]
    moduli = [
        [basin.peak_modulus_pa for basin in of_point if basin is not None] for of_point in basins
    ]
    draw = partial(
        draw_peaks_profile,
        report=report,
        points=points,
        moduli=[[value for value in values if value is not None] for values in moduli],
        texts=texts,
        letters=letters,
    )
    return [Picture(draw, _PROFILE_HEIGHT, texts["peaks_profile_note"], texts["peaks_profile"])]


def peaks_point_blocks(
    point: PointView,
    rows: Sequence[tuple[str, str]],
    texts: Texts,
    common: Collection[Hashable],
) -> list[Block]:
    """Return the part on one point of a report of peaks.

    Parameters
    ----------
    point : PointView
    rows : sequence of (label, value)
        Facts of the point.
    texts : Texts
    common : collection
        Keys of messages that hold for all points.
    """
    return [
        Heading(f"{texts['point']} {point.shown_name}"),
        Pairs(tuple(rows)),
        _peaks_of_sensors(point, texts),
        *_basins(point, texts, with_heading=False),
        *remarks_of(point, texts, common),
    ]


def _peaks_of_sensors(point: PointView, texts: Texts) -> Table:
    """Return the peaks of a point as recorded, a line a drop."""
    kinds = dict(point.progress.kinds)
    peaks = [dict(drop.peaks.displacements) if drop.peaks else {} for drop in point.drops]
    return formatting.table(
        Column(texts["drop"], [str(drop.number) for drop in point.drops]),
        Column(
            texts["kind"],
            [texts[str(kinds.get(facts.number, facts.kind))] for facts in point.facts],
            right=False,
        ),
        Column(
            formatting.symbol_title("F", "kN"),
            [number("load", facts.peak_load, texts) for facts in point.facts],
        ),
        *(
            Column(
                f"d({declared(offset, texts, 'm')}), µm",
                [number("deflection", of_drop.get(offset), texts) for of_drop in peaks],
            )
            for offset in sorted({offset for of_drop in peaks for offset in of_drop})
        ),
    )


def basin_of_drop(drop: DropView) -> Basin | None:
    """Return the basin of a drop without traces; None: it has traces, or is on a rig."""
    setup = drop.setup
    if drop.has_traces or drop.peaks is None or setup.is_stiffness_test:
        return None
    ratio = ASSUMED_POISSON_RATIO if setup.poisson_ratio is None else setup.poisson_ratio
    return basin_of(drop.peaks, setup.plate_radius, ratio)


def _basins(point: PointView, texts: Texts, *, with_heading: bool = True) -> list[Block]:
    basins = [(drop, basin_of_drop(drop)) for drop in point.drops]
    with_basin = [(drop, basin) for drop, basin in basins if basin is not None]
    if not with_basin:
        return []
    moduli = [basin.surface_moduli_pa for _, basin in with_basin]
    table = formatting.table(
        Column(texts["drop"], [str(drop.number) for drop, _ in with_basin]),
        *_basin_columns([[basin] for _, basin in with_basin], texts),
        *(
            Column(
                f"E\N{SUBSCRIPT ZERO}({declared(offset, texts, 'm')}), MPa",
                [number("modulus", of_drop.get(offset), texts) for of_drop in moduli],
            )
            for offset in sorted({offset for of_drop in moduli for offset in of_drop})
        ),
    )
    ratio = point.setup.poisson_ratio
    basis = f"a = {declared(point.setup.plate_radius, texts, 'm')}, ν = "
    basis += declared(ASSUMED_POISSON_RATIO if ratio is None else ratio, texts)
    out = sorted({offset for _, basin in with_basin for offset in basin.rejected_offsets_m})
    blocks: list[Block] = [
        *([Heading(texts["basin"], 3)] if with_heading else []),
        table,
        Paragraph(f"{basis}. {texts['basin_short']}" if with_heading else basis, "note"),
    ]
    if out:
        places = ", ".join(declared(offset, texts, "m") for offset in out)
        blocks.append(Paragraph(texts.say("basin_left_out", places=places), "note"))
    return blocks


def _stiffness(point: PointView, texts: Texts) -> list[Block]:
    on_rig = [(drop, drop.stiffness) for drop in point.drops if drop.stiffness is not None]
    if not on_rig:
        return []
    table = formatting.table(
        Column(texts["drop"], [str(drop.number) for drop, _ in on_rig]),
        *_stiffness_columns([[stiffness] for _, stiffness in on_rig], texts),
    )
    return [Heading(texts["stiffness"], 3), table, Paragraph(texts["stiffness_note"], "note")]
