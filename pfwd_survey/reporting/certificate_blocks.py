"""The first page: what a test report after a procedure has to say, and where it is signed."""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from pfwd_survey.errors import OptionError, refusal
from pfwd_survey.matplotlib_start import start_matplotlib
from pfwd_survey.procedures import Quantity, Verdict
from pfwd_survey.reporting import shown
from pfwd_survey.reporting.blocks import (
    Block,
    Heading,
    Mark,
    Pairs,
    Paragraph,
    Picture,
    Table,
    Together,
)
from pfwd_survey.reporting.content import Report, ReportPoint
from pfwd_survey.reporting.drawing import (
    curve_rows,
    draw_curves,
    draw_logo,
    draw_signatures,
    with_curves,
)
from pfwd_survey.reporting.fonts import Letters
from pfwd_survey.reporting.point_facts import modulus_text, time_of, used_drops, verdict_of
from pfwd_survey.reporting.texts import Texts

MOST_ROWS = 16
"""Points whose table fits on the first page; more have it on the pages behind."""

_LOGO_HEIGHT, _SIGNATURES_HEIGHT = 16.0, 20.0
"""mm."""

_ONE_POINT, _ROW_OF_CURVES, _BELOW_CURVES = 62.0, 33.0, 6.0
"""mm; of the picture of the curves."""


def certificate_blocks(
    report: Report,
    texts: Texts,
    letters: Letters,
    company: str | None = None,
    logo: str | os.PathLike[str] | None = None,
) -> list[Block]:
    """Who measured what, where, when, with which device, what came out, and lines to sign on.

    Parameters
    ----------
    report : Report
    texts : Texts
    letters : Letters
    company : str, optional
        Heading of the page.
    logo : path of a picture, optional
    """
    kept = [point for point in report.points if not point.discarded]
    blocks: list[Block] = []
    if logo is not None:
        draw = partial(draw_logo, image=read_logo(logo))
        blocks.append(Picture(draw, _LOGO_HEIGHT, "", company or texts["company"]))
    blocks.append(Heading(report.title, level=1))
    said = report.procedure.title if report.chosen else texts["report"]
    head = f"{texts['certificate']}: {texts.title(said)}" if report.chosen else texts["report"]
    blocks.append(Paragraph(f"{company} · {head}" if company else head, "note"))
    blocks.append(Pairs(tuple(row for row in _rows(report, kept, texts) if row[1])))
    if len(report.points) <= MOST_ROWS:
        blocks.append(points_table(report, texts))
    drawn = [point for point in kept if with_curves(point)]
    if drawn:
        rows = curve_rows(drawn)
        height = _ONE_POINT if len(drawn) == 1 else rows * _ROW_OF_CURVES + _BELOW_CURVES
        draw = partial(draw_curves, points=drawn, texts=texts, letters=letters)
        blocks.append(Picture(draw, height, texts["curves_note"], texts["curves"]))
    labels = [texts[name] for name in ("sign_place", "sign_operator", "sign_checked")]
    signatures = Picture(
        partial(draw_signatures, labels=labels), _SIGNATURES_HEIGHT, "", texts["signatures"]
    )
    return [*blocks, Together((signatures,))]


def read_logo(path: str | os.PathLike[str]) -> Any:
    """A picture as an array.

    Raises
    ------
    OptionError
        If it is none.
    """
    start_matplotlib()
    from matplotlib.image import imread

    try:
        return imread(os.fspath(path))
    except (OSError, ValueError, SyntaxError) as err:  # what readers of pictures say
        came = getattr(err, "strerror", None) or "something else"
        raise OptionError(refusal(f"--logo {path}", "a picture (.png, .jpg)", came)) from err


def _rows(report: Report, kept: Sequence[ReportPoint], texts: Texts) -> tuple[tuple[str, str], ...]:
    counts = Counter(verdict_of(point) for point in kept)
    times = sorted(filter(None, map(time_of, report.points)))
    measured = " – ".join(dict.fromkeys((times[0], times[-1]))) if times else ""
    radii = sorted({f"{p.setup.plate_radius * 2e3:g} mm" for p in kept if p.setup.plate_radius})
    verdicts = texts.say("verdicts", **{kind: counts[kind] for kind in Verdict})
    points = f"{len(kept)} ({sum(len(p.drops) for p in kept)} {texts['drops']})"
    return (
        (texts["place"], _each(point.setup.site for point in kept)),
        (texts["period"], measured),
        (texts["operator"], _each(point.setup.operator for point in kept)),
        (texts["instrument"], _device(report, kept)),
        (texts["calibrated"], _calibration(report.instruments, texts)),
        (texts["plate_diameter"], ", ".join(radii)),
        (texts["judged_by"], judged_by(report, texts)),
        (texts["points"], points),
        (texts["verdict"], verdicts),
    )


def _each(values: Any) -> str:
    return ", ".join(sorted({str(value) for value in values if value is not None}))


def _device(report: Report, kept: Sequence[ReportPoint]) -> str:
    named = [
        f"{identity.get('model', '')} {identity.get('serial_number', '')}".strip()
        for identity in report.instruments
    ]
    return ", ".join(filter(None, named)) or _each(point.setup.device for point in kept)


def _calibration(instruments: Sequence[Mapping[str, Any]], texts: Texts) -> str:
    """The dates of the channels, each pair once."""
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
    """The procedure and what it judges."""
    if not report.chosen:
        return f"{texts['modulus_full']}; {texts['no_procedure']}"
    name = report.procedure.quantity
    what = texts["modulus_full"] if name is Quantity.MODULUS else shown.name_of(name, texts)
    text = f"{report.procedure.name} ({texts.title(report.procedure.title)}): {what}"
    if report.own_procedure is None:
        return text
    return f"{text}; {texts.say('own_procedure', name=report.own_procedure)}"


def points_table(report: Report, texts: Texts) -> Table:
    """Every point in one line: settlements, s/v, what is judged, modulus, target, verdict."""
    judged = report.procedure.quantity is not Quantity.MODULUS
    columns = [
        texts["point"],
        texts["time"],
        "s, mm",
        "s\N{COMBINING MACRON}, mm",
        "v, mm/s",
        "s/v, ms",
    ]
    columns += [f"{shown.name_of(report.procedure.quantity, texts)}"] if judged else []
    columns += [texts["modulus"], texts["target"], texts["verdict"]]
    rows = []
    for point in report.points:
        progress = point.progress
        used = used_drops(point)
        settled = [drop.facts.peak_deflection for drop in used]
        depths = [value * 1e3 for value in settled if value is not None]
        speeds = [v * 1e3 for drop in used if (v := drop.facts.peak_velocity) is not None]
        kind = verdict_of(point)
        cells: list[str | Mark] = [
            point.name,
            time_of(point)[:16],
            " / ".join(f"{value:.3f}" for value in depths[:MOST_DEPTHS])
            + (" …" if len(depths) > MOST_DEPTHS else ""),
            f"{sum(depths) / len(depths):.3f}" if depths else shown.NOTHING,
            shown.digits(sum(speeds) / len(speeds)) if speeds else shown.NOTHING,
            shown.scaled(progress.s_over_v, 1e3, ""),
        ]
        cells += [shown.value_of(progress.value, texts)] if judged else []
        cells += [
            modulus_text(point, report.procedure.quantity, texts),
            shown.target_of(progress.target, report.procedure.quantity),
            Mark(kind, texts["discarded"] if point.discarded else texts[kind]),
        ]
        rows.append(tuple(cells))
    return Table(tuple(columns), tuple(rows), (3, 4, 5))


MOST_DEPTHS = 3
"""Settlements of a point that its line has; procedures ask for three."""
