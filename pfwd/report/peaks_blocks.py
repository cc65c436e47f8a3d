"""The parts of a report on drops without a modulus of a history: basins of peaks, rigs."""

from collections.abc import Collection, Hashable, Sequence
from functools import partial
from statistics import fmean

from pfwd.digits import significant
from pfwd.judging import DropView, PointView
from pfwd.peaks.basin import ASSUMED_POISSON_RATIO, Basin, basin_of
from pfwd.procedures import Verdict
from pfwd.report import formatting
from pfwd.report.blocks import Block, Heading, Mark, Pairs, Paragraph, Picture, Table
from pfwd.report.content import Report
from pfwd.report.drawing import draw_peaks_profile
from pfwd.report.fonts import Letters
from pfwd.report.point_facts import (
    chainage_column,
    remarks_of,
    time_cells,
    used_drops,
    verdict_of,
)
from pfwd.report.texts import Texts

_INDICES = ("SCI, µm", "BDI, µm", "BCI, µm", "AREA, mm")

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
    rows = []
    for point, time in zip(report.points, times, strict=True):
        on_rig = [
            d.stiffness for d in point.drops if d.stiffness is not None and d.discarded is None
        ]
        rows.append(
            (
                point.shown_name,
                time,
                str(len(on_rig)),
                _mean([item.peak_load_n for item in on_rig], 1e-3),
                _mean([item.peak_displacement_m for item in on_rig], 1e3),
                _mean([item.secant_n_per_m for item in on_rig], 1e-6),
                _mean([item.dynamic_n_per_m for item in on_rig], 1e-6),
            )
        )
    columns = (
        *(texts["point"], title, texts["drops"]),
        *(formatting.symbol_title("F", "kN"), formatting.symbol_title("s", "mm")),
        f"{texts['stiffness']}, {texts['secant_stiffness']}, MN/m",
        f"{texts['stiffness']}, {texts['dynamic_stiffness']}, MN/m",
    )
    return Table(columns, tuple(rows), tuple(range(2, len(columns))))


def peaks_table(report: Report, texts: Texts) -> Table:
    """Return every point in one line: mean load, deflection, moduli and indices of its peaks."""
    title, times = time_cells(report, texts)
    judged = any(point.progress.value is not None for point in report.points)
    has_verdict = any(verdict_of(point) != Verdict.NONE for point in report.points)
    along, chainages = chainage_column(report, texts)
    columns = [texts["point"], along, title, texts["drops"]]
    columns += [formatting.symbol_title("F", "kN"), formatting.symbol_title("s", "mm")]
    columns += [f"{texts['peak_method']}, MPa", *_INDICES]
    right = (1, *range(3, len(columns)))
    columns += [formatting.name_of(report.procedure.quantity, texts)] if judged else []
    columns += [texts["target"], texts["verdict"]] if has_verdict else []
    rows = []
    for point, chainage, time in zip(report.points, chainages, times, strict=True):
        drops = used_drops(point)
        basins = [basin for drop in drops if (basin := basin_of_drop(drop)) is not None]
        kind = verdict_of(point)
        cells: list[str | Mark] = [
            point.shown_name,
            chainage,
            time,
            str(len(drops)),
            _mean([drop.facts.peak_load for drop in drops], 1e-3),
            _mean([drop.facts.peak_deflection for drop in drops], 1e3),
            _mean([basin.peak_modulus_pa for basin in basins], 1e-6),
            _mean([basin.sci_m for basin in basins], 1e6),
            _mean([basin.bdi_m for basin in basins], 1e6),
            _mean([basin.bci_m for basin in basins], 1e6),
            _mean([basin.area_m for basin in basins], 1e3),
        ]
        cells += [formatting.value_of(point.progress.value, texts)] if judged else []
        if has_verdict:
            cells.append(formatting.target_of(point.progress.target, report.procedure.quantity))
            cells.append(Mark(kind, texts["discarded"] if point.discarded else texts[kind]))
        rows.append(tuple(cells))
    table = Table(tuple(columns), tuple(rows), right)
    return formatting.without_empty_columns(table, always=(title, texts["target"]))


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
    peaks = {drop.number: dict(drop.peaks.displacements) for drop in point.drops if drop.peaks}
    offsets = sorted({offset for of_drop in peaks.values() for offset in of_drop})
    rows = [
        (
            str(drop.number),
            texts[str(kinds.get(drop.number, facts.kind))],
            formatting.scaled(facts.peak_load, 1e-3, ""),
            *(
                formatting.scaled(peaks.get(drop.number, {}).get(offset), 1e6, "", 4)
                for offset in offsets
            ),
        )
        for drop, facts in zip(point.drops, point.facts, strict=True)
    ]
    columns = (
        texts["drop"],
        texts["kind"],
        formatting.symbol_title("F", "kN"),
        *(f"d({offset:g} m), µm" for offset in offsets),
    )
    return Table(columns, tuple(rows), (0, *range(2, len(columns))))


def _mean(values: Sequence[float | None], scale: float) -> str:
    recorded = [value * scale for value in values if value is not None]
    return significant(fmean(recorded)) if recorded else formatting.NO_VALUE


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
    distances = sorted({offset for _, basin in with_basin for offset in basin.surface_moduli_pa})
    rows = [
        (
            str(drop.number),
            formatting.scaled(basin.peak_modulus_pa, 1e-6, ""),
            *_indices(basin),
            *(
                formatting.scaled(basin.surface_moduli_pa.get(offset), 1e-6, "")
                for offset in distances
            ),
        )
        for drop, basin in with_basin
    ]
    columns = (
        texts["drop"],
        f"{texts['peak_method']}, MPa",
        *_INDICES,
        *(f"E\N{SUBSCRIPT ZERO}({offset:g} m), MPa" for offset in distances),
    )
    ratio = point.setup.poisson_ratio
    basis = f"a = {point.setup.plate_radius:g} m, ν = "
    basis += f"{ASSUMED_POISSON_RATIO if ratio is None else ratio:g}"
    out = sorted({offset for _, basin in with_basin for offset in basin.rejected_offsets_m})
    blocks: list[Block] = [
        *([Heading(texts["basin"], 3)] if with_heading else []),
        Table(columns, tuple(rows), tuple(range(len(columns)))),
        Paragraph(f"{basis}. {texts['basin_short']}" if with_heading else basis, "note"),
    ]
    if out:
        places = ", ".join(f"{offset:g} m" for offset in out)
        blocks.append(Paragraph(texts.say("basin_left_out", places=places), "note"))
    return blocks


def _indices(basin: Basin) -> tuple[str, ...]:
    depths = (
        formatting.scaled(value, 1e6, "") for value in (basin.sci_m, basin.bdi_m, basin.bci_m)
    )
    return (*depths, formatting.scaled(basin.area_m, 1e3, ""))


def _stiffness(point: PointView, texts: Texts) -> list[Block]:
    rows = [
        (
            str(drop.number),
            formatting.scaled(drop.stiffness.peak_load_n, 1e-3, ""),
            formatting.scaled(drop.stiffness.peak_displacement_m, 1e6, ""),
            formatting.scaled(drop.stiffness.secant_n_per_m, 1e-6, ""),
            formatting.scaled(drop.stiffness.dynamic_n_per_m, 1e-6, ""),
        )
        for drop in point.drops
        if drop.stiffness is not None
    ]
    if not rows:
        return []
    columns = (
        texts["drop"],
        f"{texts['load']}, kN",
        f"{texts['deflection']}, µm",
        f"{texts['secant_stiffness']}, MN/m",
        f"{texts['dynamic_stiffness']}, MN/m",
    )
    return [
        Heading(texts["stiffness"], 3),
        Table(columns, tuple(rows), tuple(range(len(columns)))),
        Paragraph(texts["stiffness_note"], "note"),
    ]
