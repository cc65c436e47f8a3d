"""The part of a report on drops without a modulus of a history: basins of peaks, rigs."""

from pfwd.judging import DropView, PointView
from pfwd.peaks.basin import ASSUMED_POISSON_RATIO, Basin, basin_of
from pfwd.report import shown
from pfwd.report.blocks import Block, Heading, Paragraph, Table
from pfwd.report.texts import Texts


def peaks_blocks(point: PointView, texts: Texts) -> list[Block]:
    """Tables of a point; none where its drops have histories on the ground."""
    return [*_basins(point, texts), *_stiffness(point, texts)]


def basin_of_drop(drop: DropView) -> Basin | None:
    """Return the basin of a drop without traces; None: it has traces, or is on a rig."""
    setup = drop.setup
    if drop.has_traces or drop.peaks is None or setup.is_stiffness_test:
        return None
    ratio = ASSUMED_POISSON_RATIO if setup.poisson_ratio is None else setup.poisson_ratio
    return basin_of(drop.peaks, setup.plate_radius, ratio)


def _basins(point: PointView, texts: Texts) -> list[Block]:
    basins = [(drop, basin_of_drop(drop)) for drop in point.drops]
    found = [(drop, basin) for drop, basin in basins if basin is not None]
    if not found:
        return []
    distances = sorted({offset for _, basin in found for offset in basin.surface_moduli_pa})
    rows = [
        (
            str(drop.number),
            shown.scaled(basin.peak_modulus_pa, 1e-6, ""),
            *_indices(basin),
            *(shown.scaled(basin.surface_moduli_pa.get(offset), 1e-6, "") for offset in distances),
        )
        for drop, basin in found
    ]
    columns = (
        texts["drop"],
        f"{texts['peak_method']}, MPa",
        "SCI, µm",
        "BDI, µm",
        "BCI, µm",
        "AREA, mm",
        *(f"E\N{SUBSCRIPT ZERO}({offset:g} m), MPa" for offset in distances),
    )
    ratio = point.setup.poisson_ratio
    basis = f"a = {point.setup.plate_radius:g} m, ν = "
    basis += f"{ASSUMED_POISSON_RATIO if ratio is None else ratio:g}"
    out = sorted({offset for _, basin in found for offset in basin.rejected_offsets_m})
    blocks: list[Block] = [
        Heading(texts["basin"], 3),
        Table(columns, tuple(rows), tuple(range(len(columns)))),
        Paragraph(f"{basis}. {texts['basin_short']}", "note"),
    ]
    if out:
        places = ", ".join(f"{offset:g} m" for offset in out)
        blocks.append(Paragraph(texts.say("basin_left_out", places=places), "note"))
    return blocks


def _indices(basin: Basin) -> tuple[str, ...]:
    depths = (shown.scaled(one, 1e6, "") for one in (basin.sci_m, basin.bdi_m, basin.bci_m))
    return (*depths, shown.scaled(basin.area_m, 1e3, ""))


def _stiffness(point: PointView, texts: Texts) -> list[Block]:
    rows = [
        (
            str(drop.number),
            shown.scaled(drop.stiffness.peak_load_n, 1e-3, ""),
            shown.scaled(drop.stiffness.peak_displacement_m, 1e6, ""),
            shown.scaled(drop.stiffness.secant_n_per_m, 1e-6, ""),
            shown.scaled(drop.stiffness.dynamic_n_per_m, 1e-6, ""),
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
