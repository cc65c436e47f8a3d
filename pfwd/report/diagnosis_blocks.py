"""The part of a point's report on the diagnosis of its residual."""

import math
from functools import partial

from pfwd.analysis.results import DiagnosisResult, EffectResult, FittedState
from pfwd.digits import read_in
from pfwd.judging import PointView
from pfwd.message_groups import group_messages
from pfwd.report import shown
from pfwd.report.blocks import Block, Heading, Listing, Paragraph, Picture, Table
from pfwd.report.diagnosis_drawing import draw_ladder, ladder_height, ladder_of
from pfwd.report.point_facts import diagnosis_of
from pfwd.report.texts import Texts

_MIN_STRESS_DIFFERENCE = 0.02
"""Relative difference of the moduli at two stresses from which both are reported."""

_VERDICTS = ("clean", "explained", "unexplained")


def diagnosis_blocks(point: PointView, texts: Texts) -> list[Block]:
    """Return the verdict, the fit before and after, the residual without each effect, the effects.

    Parameters
    ----------
    point : PointView
        Without a diagnosis there is nothing to show.
    texts : Texts
    """
    diagnosis = diagnosis_of(point)
    if diagnosis is None:
        return []
    verdict = str(diagnosis.verdict)
    blocks: list[Block] = [
        Heading(texts["diagnosis"], 3),
        Paragraph(texts[f"verdict_{verdict}"] if verdict in _VERDICTS else verdict),
    ]
    blocks += _states(diagnosis, texts)
    steps = ladder_of(diagnosis, texts)
    if len(steps) > 2:
        picture = Picture(
            partial(draw_ladder, diagnosis=diagnosis, texts=texts),
            ladder_height(steps),
            texts["ladder_note"],
            f"{texts['diagnosis']}: {texts['point']} {point.shown_name}",
        )
        blocks.append(picture)
    effects = [_effect(effect, texts) for effect in diagnosis.effects or ()]
    if effects:
        blocks += [Heading(texts["effects"], 3), Listing(tuple(effects))]
    warnings = diagnosis.warnings or ()
    if warnings:
        groups = group_messages(("", warning) for warning in warnings)
        blocks.append(Listing(tuple(map(texts.grouped, groups)), "warning"))
    return blocks


def _states(diagnosis: DiagnosisResult, texts: Texts) -> list[Block]:
    rows = [
        (
            texts[when],
            _modulus(state, texts),
            texts.word(str(state.model)),
            shown.percent(state.contact_residual_rms_over_peak),
            shown.percent(state.residual_rms_over_peak),
        )
        for when, state in (("before", diagnosis.before), ("after", diagnosis.after))
        if state is not None
    ]
    if not rows:
        return []
    columns = (
        "",
        f"{texts['modulus']} (95 %)",
        texts["model"],
        texts["contact_phase"],
        texts["residual"],
    )
    blocks: list[Block] = [Table(columns, tuple(rows), (1, 3, 4))]
    plate = texts.word("rigid-rough")
    basis = f"{plate} {diagnosis.plate_radius_m or 0.0:g} m, ν {diagnosis.poisson_ratio or 0.0:g}"
    blocks.append(Paragraph(f"{texts['basis']}: {basis}", "note"))
    if verdict_of_use := _use(diagnosis, texts):
        blocks.append(Paragraph(verdict_of_use))
    return blocks


_USE_KEYS = {"design": "use_design", "with-care": "use_with_care", "do-not-use": "do_not_use"}


def _use(diagnosis: DiagnosisResult, texts: Texts) -> str:
    """Return the use of the modulus after, and the stress that it belongs to."""
    after = diagnosis.after
    if after is None or after.modulus_pa is None:
        return ""
    text = f"{texts[_USE_KEYS[diagnosis.use]]}: {texts.message(diagnosis.use_reason)}."
    if after.stress_pa is None or not math.isfinite(after.stress_pa):
        return text
    modulus_100kpa = after.modulus_100kpa_pa
    if (
        modulus_100kpa is None
        or abs(modulus_100kpa / after.modulus_pa - 1.0) < _MIN_STRESS_DIFFERENCE
    ):
        return text
    stress = f"{after.stress_pa / 1e3:.0f} kPa"
    at_100 = f"{shown.digits(modulus_100kpa / 1e6, 2)} MPa"
    return f"{text} {texts.say('secant', stress=stress, modulus=at_100)}"


def _modulus(state: FittedState, texts: Texts) -> str:
    if state.modulus_pa is None:
        return shown.NOTHING
    ends = state.modulus_interval_pa
    interval = None if ends is None else [end / 1e6 for end in ends]
    return shown.with_interval(state.modulus_pa / 1e6, interval, "MPa", texts)


def _effect(effect: EffectResult, texts: Texts) -> str:
    scale, unit = read_in(effect.unit or "")
    value = shown.with_deviation(effect.value, effect.sd, scale, unit).strip()
    text = f"{texts.word(str(effect.name))}: {value}"
    alternatives = ", ".join(map(texts.word, effect.alternatives or ()))
    return f"{text} ({texts['effect_or']} {alternatives})" if alternatives else text
