"""The first page: the test report that a procedure asks for, with lines to sign on."""

import math
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from pfwd.errors import OptionError, refusal
from pfwd.judging import PointView
from pfwd.matplotlib_start import start_matplotlib
from pfwd.message_groups import group_messages
from pfwd.procedures import PointDrop, Procedure, Quantity, Verdict
from pfwd.procedures.point import UNSUPPORTED_MARK
from pfwd.procedures.preconditions import presumed_load
from pfwd.report import formatting
from pfwd.report.blocks import (
    SIGNS,
    Block,
    Heading,
    Pairs,
    Paragraph,
    Picture,
    Table,
    Together,
)
from pfwd.report.content import Report
from pfwd.report.drawing import (
    curves_height,
    draw_curves,
    draw_logo,
    draw_signatures,
    with_deflection,
)
from pfwd.report.fonts import Letters
from pfwd.report.formatting import Column, declared, mean, number
from pfwd.report.peaks_blocks import (
    has_only_peaks,
    has_only_stiffness,
    peaks_table,
    stiffness_table,
)
from pfwd.report.point_facts import (
    chainage_column,
    clock_and_zone,
    equivalent_text,
    is_response_declared,
    modulus_text,
    names_text,
    points_text,
    shown_drops,
    target_notes,
    time_cells,
    verdict_columns,
    verdict_of,
)
from pfwd.report.texts import Texts
from pfwd.units import SI, QuantityName
from pfwd_plugins.quantities import Measurand

MAX_ROWS = 16
"""Number of points up to which their table is on the first page; else it follows later."""

MAX_POINTS_WITH_CURVES = 12
"""Number of points up to which the deflection curves are on the first page, too."""

MAX_CURVES_IN_PICTURE = 30
"""Number of points in one picture of deflection curves; such a picture is half a page high."""

_LOGO_HEIGHT, _SIGNATURES_HEIGHT = 16.0, 20.0
"""mm."""


def certificate_blocks(
    report: Report,
    texts: Texts,
    letters: Letters,
    company: str | None = None,
    logo: str | os.PathLike[str] | None = None,
) -> list[Block]:
    """Return the blocks of the first page: facts, points, verdicts, curves, lines to sign on.

    Parameters
    ----------
    report : Report
    texts : Texts
    letters : Letters
    company : str, optional
        Heading of the page.
    logo : path of a picture, optional
    """
    blocks: list[Block] = [*logo_blocks(company, logo, texts), Heading(report.title, level=1)]
    only_peaks, only_stiffness = has_only_peaks(report), has_only_stiffness(report)
    head = texts["report_of_peaks" if only_peaks else "report"]
    head = texts["report_of_stiffness"] if only_stiffness else head
    if report.chosen:
        head = f"{texts['certificate']}: {texts.title(report.procedure)}"
    blocks.append(Paragraph(f"{company} · {head}" if company else head, "note"))
    blocks.append(Pairs(tuple(row for row in certificate_rows(report, texts) if row[1])))
    if len(report.points) <= MAX_ROWS:
        blocks += points_blocks(report, texts)
    blocks += verdict_reasons(report, texts)
    if len(report.points) <= MAX_POINTS_WITH_CURVES:
        blocks += curve_blocks(report, texts, letters)
    labels = [texts[name] for name in ("sign_place", "sign_operator", "sign_checked")]
    signatures = Picture(
        partial(draw_signatures, labels=labels), _SIGNATURES_HEIGHT, "", texts["signatures"]
    )
    return [*blocks, Together((signatures,))]


def logo_blocks(
    company: str | None, logo: str | os.PathLike[str] | None, texts: Texts
) -> list[Block]:
    """Return the block with the picture of the logo; an empty list without a logo."""
    if logo is None:
        return []
    draw = partial(draw_logo, image=read_logo(logo))
    return [Picture(draw, _LOGO_HEIGHT, "", company or texts["company"])]


def curve_blocks(report: Report, texts: Texts, letters: Letters) -> list[Block]:
    """Return the deflection curves of all points, in one picture or several."""
    drawn = [p for p in report.points if not p.discarded and with_deflection(p)]
    blocks: list[Block] = []
    for first in range(0, len(drawn), MAX_CURVES_IN_PICTURE):
        part = drawn[first : first + MAX_CURVES_IN_PICTURE]
        draw = partial(draw_curves, points=part, texts=texts, letters=letters)
        note = texts["curves_note"]
        note += texts["response_removed"] if is_response_declared(report) else ""
        blocks.append(Picture(draw, curves_height(part), note, texts["curves"]))
    return blocks


def read_logo(path: str | os.PathLike[str]) -> Any:
    """Return the pixels of a picture file as an array.

    Raises
    ------
    OptionError
        If the file is not a picture.
    """
    start_matplotlib()
    from matplotlib.image import imread

    try:
        return imread(os.fspath(path))
    except (OSError, ValueError, SyntaxError) as err:  # raised by readers of pictures
        problem = getattr(err, "strerror", None) or "something else"
        raise OptionError(refusal(f"--logo {path}", "a picture (.png, .jpg)", problem)) from err


def certificate_rows(report: Report, texts: Texts) -> tuple[tuple[str, str], ...]:
    """Return the facts of the head of the page with their labels; what is unknown is empty."""
    points = [point for point in report.points if not point.discarded]
    counts = Counter(verdict_of(point) for point in points)
    radii = sorted({p.setup.plate_radius for p in points if p.setup.plate_radius})
    verdicts = texts.say("verdicts", **{kind: counts[kind] for kind in Verdict})
    if counts[Verdict.NONE] == len(points):
        verdicts = texts["none"]
    drops = sum(len(p.drops) for p in points)
    key = "points_and_drop" if drops == 1 else "points_and_drops"
    counted = texts.say(key, points=len(points), drops=drops)
    return (
        (texts["place"], names_text(point.setup.site for point in points)),
        (texts["period"], _period(report, texts)),
        (texts["operator"], names_text(point.setup.operator for point in points)),
        (texts["instrument"], _device(report, points)),
        (texts["calibrated"], _calibration(report.instruments, texts)),
        (texts["plate_diameter"], ", ".join(declared(2e3 * r, texts, "mm") for r in radii)),
        (texts["judged_by"], judged_by(report, texts)),
        (texts["formula"], _formula(report.procedure, texts)),
        (texts["drops_asked"], _required_drops(report, texts)),
        (texts["load"], _loads(points, report.procedure, texts)),
        (texts["conditions"], _conditions(points, texts)),
        (texts["points"], counted),
        (texts["verdict"], verdicts),
    )


def _period(report: Report, texts: Texts) -> str:
    """Return the first and the last time of the points, with the time zone; empty: unknown."""
    times = sorted(time for p in report.points if (time := clock_and_zone(p, texts))[0])
    if not times:
        return ""
    (first, first_zone), (last, last_zone) = times[0], times[-1]
    if first == last:
        return f"{first} {first_zone}"
    if first_zone == last_zone:
        return f"{first} – {last} {last_zone}"
    return f"{first} {first_zone} – {last} {last_zone}"


def _formula(procedure: Procedure, texts: Texts) -> str:
    """Return the formula of the judged quantity; empty: there is none."""
    factor, nominal = procedure.factor, procedure.nominal_pressure
    if factor is None or procedure.quantity not in (Quantity.E_VD, Quantity.E_LWD):
        return ""
    name, mean = procedure.quantity.value, "s\N{COMBINING MACRON}"
    if procedure.quantity is Quantity.E_VD:
        pressure = "" if nominal is None else f", σ = {declared(nominal.value / 1e6, texts, 'MPa')}"
        return f"{name} = {declared(factor.value, texts)} r σ / {mean}{pressure}"
    ratio = procedure.poisson_ratio
    ratio_text = "" if ratio is None else f", ν = {declared(ratio.value, texts)}"
    factor_text = texts.decimals(f"{factor.value:.3g}")  # π/2 and 2 of a plate have many digits
    return f"{name} = {factor_text} (1 - ν²) r σ / {mean}, σ = F / (π r²){ratio_text}"


def _required_drops(report: Report, texts: Texts) -> str:
    """Return the number of drops of each kind that the procedure requires; empty: none."""
    if not report.chosen or report.procedure.measured_drops is None:
        return ""
    required = (
        (report.procedure.seating_drops, "seating"),
        (report.procedure.measured_drops, "measured"),
    )
    return " + ".join(f"{count} ({texts[kind]})" for count, kind in required if count)


def _loads(points: Sequence[PointView], procedure: Procedure, texts: Texts) -> str:
    """Return peak loads and mean stresses below the plate: measured, then presumed."""
    loads = [
        (load, load / (math.pi * radius**2))
        for point in points
        for drop in shown_drops(point)
        if (load := drop.facts.peak_load) is not None and (radius := point.setup.plate_radius)
    ]
    parts = []
    if loads:
        forces, pressures = zip(*loads, strict=True)
        measured = f"{_range('load', forces, texts)}, σ = {_range('pressure', pressures, texts)}"
        parts.append(f"{texts['load_measured']}: {measured}")
    plate = next((point.setup.plate_radius for point in points if point.setup.plate_radius), 0.0)
    presumed = presumed_load(procedure, (), plate) if plate else None
    if presumed is not None:
        ours = f", {texts['our_tolerance']}" if presumed.tolerance_is_ours else ""
        parts.append(
            f"{texts['load_presumed']}: {_range('load', (presumed.load,), texts)}, σ = "
            f"{_range('pressure', (presumed.pressure,), texts)} "
            f"(± {declared(100 * presumed.tolerance, texts, '%')}{ours})"
        )
    return "; ".join(parts)


def _range(quantity: QuantityName, values: Sequence[float], texts: Texts) -> str:
    lowest, highest = (number(quantity, value, texts) for value in (min(values), max(values)))
    return f"{formatting.ends(lowest, highest)} {SI.unit(quantity)}"


def _conditions(points: Sequence[PointView], texts: Texts) -> str:
    """Return material, moisture and temperature, where they are declared."""
    conditions = []
    materials = names_text(point.setup.material for point in points)
    if materials:
        conditions.append(f"{texts['material']}: {materials}")
    for key, unit in (("moisture", "%"), ("temperature", "°C")):
        values = [v for point in points if (v := getattr(point.setup, key)) is not None]
        if values:
            span = formatting.ends(declared(min(values), texts), declared(max(values), texts))
            conditions.append(f"{texts[key]}: {span} {unit}")
    return "; ".join(conditions)


def _device(report: Report, points: Sequence[PointView]) -> str:
    named = [
        f"{identity.get('model', '')} {identity.get('serial_number', '')}".strip()
        for identity in report.instruments
    ]
    return ", ".join(filter(None, named)) or names_text(point.setup.device for point in points)


def _calibration(instruments: Sequence[Mapping[str, Any]], texts: Texts) -> str:
    """Return the dates of calibration of the channels, each pair once."""
    dates = dict.fromkeys(
        (str(channel["calibrated"]), str(channel.get("due") or ""))
        for identity in instruments
        for channel in identity.get("channels") or ()
        if channel.get("calibrated")
    )
    return "; ".join(
        f"{when}, {texts['due'].lower()} {due}" if due else when for when, due in dates
    )


def judged_by(report: Report, texts: Texts) -> str:
    """Return the procedure and the quantity that it judges."""
    if has_only_stiffness(report):
        return texts["stiffness_basis"]
    if not report.chosen:
        only_peaks = has_only_peaks(report)
        return (
            texts["peaks_basis"]
            if only_peaks
            else (f"{texts['equivalent_full']}; {texts['no_procedure']}")
        )
    name = report.procedure.quantity
    in_full = {Quantity.MODULUS: "modulus_full", Quantity.EQUIVALENT_MODULUS: "equivalent_full"}
    quantity = texts[in_full[name]] if name in in_full else formatting.name_of(name, texts)
    text = f"{report.procedure.name} ({texts.title(report.procedure)}): {quantity}"
    if report.survey_procedure is None:
        return text
    return f"{text}; {texts.say('own_procedure', name=report.survey_procedure)}"


def points_blocks(report: Report, texts: Texts) -> list[Block]:
    """Return the table of the points with the notes on its values."""
    notes = [*unsupported_note(report, texts), *_existing_note(report, texts)]
    return [points_table(report, texts), *notes, *target_notes(report, texts)]


def points_table(report: Report, texts: Texts) -> Table:
    """Return the table of the points: settlements, s/v or load, judged value, target, verdict.

    A report of peaks alone has their indices in place of the modulus, one of a rig the stiffness.
    """
    if has_only_stiffness(report):
        return stiffness_table(report, texts)
    if has_only_peaks(report):
        return peaks_table(report, texts)
    quantity = report.procedure.quantity
    # The documents of the procedures ask for s and v of the light drop weight tester, and for peak
    # loads of devices with a load cell. A mean settlement that is judged has its own column.
    speeds = not report.chosen or quantity is Quantity.E_VD
    mean_shown = quantity is not Quantity.DEFLECTION
    title, times = time_cells(report, texts)
    along, chainages = chainage_column(report, texts)
    loads = not speeds or bool(_existing_note(report, texts))
    points = report.points
    facts = [[drop.facts for drop in shown_drops(point)] for point in points]
    depths = [[s for f in of_point if (s := f.peak_deflection) is not None] for of_point in facts]
    columns = [
        Column(texts["point"], [point.shown_name for point in points], right=False),
        Column(along, chainages),
        Column(title, times, right=False, always=True),
        Column(formatting.symbol_title("s", "mm"), [_depths(d, texts) for d in depths], False),
        Column(
            formatting.symbol_title("s\N{COMBINING MACRON}", "mm"),
            [
                mean("settlement", of_point if mean_shown and p.progress.used else (), texts)
                for p, of_point in zip(points, depths, strict=True)
            ],
        ),
    ]
    if speeds:
        speed = [mean(Measurand.VELOCITY, (f.peak_velocity for f in fs), texts) for fs in facts]
        ratio = [number("duration", point.progress.s_over_v, texts) for point in points]
        columns.append(Column(formatting.symbol_title("v", "mm/s"), speed))
        columns.append(Column(formatting.symbol_title("s/v", "ms"), ratio))
    if loads:
        force = [mean("load", (f.peak_load for f in of_point), texts) for of_point in facts]
        columns.append(Column(formatting.symbol_title("F", "kN"), force))
    if quantity is not Quantity.MODULUS:
        values = [formatting.value_of(point.progress.value, texts) for point in points]
        columns.append(Column(formatting.name_of(quantity, texts), values, right=False))
    moduli = [
        modulus_text(p, texts) if p.progress.used or p.progress.modulus else _moduli_of(fs, texts)
        for p, fs in zip(points, facts, strict=True)
    ]
    columns.append(Column(texts["modulus"], moduli, right=False))
    if quantity is Quantity.MODULUS:
        equivalent = [equivalent_text(point, texts) for point in points]
        columns.append(Column(texts["equivalent_modulus"], equivalent, right=False))
    return formatting.table(*columns, *verdict_columns(report, texts))


def _depths(depths: Sequence[float], texts: Texts) -> str:
    """Return the first deflections, mm."""
    listed = " / ".join(number("settlement", s, texts) for s in depths[:MAX_LISTED_DEPTHS])
    return f"{listed} …" if len(depths) > MAX_LISTED_DEPTHS else listed


def _moduli_of(drops: Sequence[PointDrop], texts: Texts) -> str:
    """Return the moduli of drops that are not averaged; what the data do not support is missing."""
    supported = [
        number("modulus", drop.modulus, texts)
        for drop in drops
        if drop.modulus is not None and drop.fit_fault is None and drop.record_fault is None
    ]
    listed = " / ".join(supported[:MAX_LISTED_DEPTHS])
    return f"{listed} MPa" if supported else formatting.NO_VALUE


def _existing_note(report: Report, texts: Texts) -> list[Block]:
    """Return the note on points with drops of which none is averaged; empty without any."""
    some = any(shown_drops(point) and not point.progress.used for point in report.points)
    return [Paragraph(texts["existing_drops"], "note")] if some else []


def verdict_reasons(report: Report, texts: Texts) -> list[Block]:
    """Return each verdict with its reason and the points that it holds for.

    Points without a target have no verdict, and discarded ones none that counts.
    """
    order = [str(number) for number in range(len(report.points))]
    names = {number: p.shown_name for number, p in zip(order, report.points, strict=True)}
    items = []
    for kind in Verdict:
        reasons = [
            (number, point.progress.verdict_reason)
            for number, point in zip(order, report.points, strict=True)
            if kind is not Verdict.NONE and verdict_of(point) == kind.value
        ]
        for group in group_messages(reasons):
            places = f" ({points_text(group.places, order, names, texts)})" if order[1:] else ""
            text = f"{texts.message(group.message)}{places}"
            items.append((f"{SIGNS[kind]} {texts[kind]}", text))
    return [Pairs(tuple(items))] if items else []


def unsupported_note(report: Report, texts: Texts) -> list[Block]:
    """Return the note that explains the mark of unsupported numbers; empty without any.

    A reason that is that of the verdict too is not repeated.
    """
    reasons: dict[str, list[str]] = {}
    any_marked = False
    for point in report.points:
        value, modulus = point.progress.value, point.progress.modulus
        marked = [item.not_supported for item in (value, modulus) if item is not None]
        for reason in dict.fromkeys(filter(None, marked)):
            any_marked = True
            stated = point.progress.verdict_reason
            if point.discarded or reason not in (stated, *stated.values.values()):
                reasons.setdefault(texts.message(reason), []).append(point.shown_name)
    if not any_marked:
        return []
    listed = "; ".join(f"{', '.join(names)}: {reason}" for reason, names in reasons.items())
    text = f"{UNSUPPORTED_MARK} {texts['not_supported']}"
    return [Paragraph(f"{text}: {listed}" if listed else f"{text}.", "note")]


MAX_LISTED_DEPTHS = 3
"""Number of settlements in the row of a point; procedures require three."""
