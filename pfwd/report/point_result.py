"""The result of a point: modulus, model, depth and permitted use, all from one stored result."""

from collections.abc import Iterator, Mapping

from pfwd.analysis.results import DiagnosisResult, DropResult
from pfwd.facts import facts_of_drop, facts_of_state
from pfwd.judging import PointView
from pfwd.report import formatting
from pfwd.report.ground_blocks import effective_of
from pfwd.report.point_facts import (
    diagnosis_counts,
    diagnosis_of,
    drops_text,
    equivalent_text,
    modulus_text,
    used_drops,
)
from pfwd.report.texts import Texts
from pfwd.units import SI, Fact

_USE_KEYS = {"design": "use_design", "with-care": "use_with_care", "do-not-use": "do_not_use"}


def result_rows(point: PointView, texts: Texts) -> list[tuple[str, str]]:
    """Return the rows on the modulus of a point: value, basis, effective modulus and use.

    All numbers are those of the diagnosis if its modulus counts, else those of the fits.
    """
    if point.progress.modulus is None:
        return [(texts["use"], _use(point, texts))]
    if diagnosis_counts(point):
        diagnosis = diagnosis_of(point)
        basis = "" if diagnosis is None else _basis_of_diagnosis(diagnosis, point, texts)
        effective = ""
    else:
        fits = _averaged_fits(point)
        basis = _basis_of_fits(fits, point, texts)
        effective = _effective(fits, texts)
    return [
        (texts["modulus"], modulus_text(point, texts)),
        (texts["equivalent_modulus"], equivalent_text(point, texts)),
        (texts["basis"], basis),
        (texts["effective"], effective),
        (texts["use"], _use(point, texts)),
    ]


def _basis_of_diagnosis(diagnosis: DiagnosisResult, point: PointView, texts: Texts) -> str:
    """Return the drops, the ground and the plate of a diagnosis."""
    after = diagnosis.after
    assert after is not None  # its modulus counts
    model = formatting.on_rock(
        texts.word(str(after.model)), _bedrock_depth(diagnosis, texts), texts
    )
    parts = [
        model,
        formatting.plate_text(
            diagnosis.plate or "rigid-rough",
            diagnosis.plate_radius_m,
            diagnosis.poisson_ratio,
            texts,
        ),
        *_ground(facts_of_state(after), texts),
    ]
    order = [str(drop.number) for drop in point.drops]
    drops = drops_text([str(number) for number in diagnosis.drops], order, texts)
    text = ", ".join(filter(None, parts))
    return f"{texts.say('from_diagnosis', drops=drops)}: {text}"


def _bedrock_depth(diagnosis: DiagnosisResult, texts: Texts) -> str:
    """Return the depth of the rock in the model of a diagnosis; empty: no rock, or not stored."""
    for effect in diagnosis.effects:
        if effect.name == "bedrock":
            return formatting.show(Fact("depth", effect.value, deviation=effect.sd), texts)
    depth = None if diagnosis.after is None else diagnosis.after.bedrock_depth_m
    return "" if depth is None else formatting.show(Fact("depth", depth), texts)


def _averaged_fits(point: PointView) -> list[tuple[int, DropResult]]:
    """Return numbers and results of the averaged drops with a modulus, if none of all drops."""
    for drops in (used_drops(point), point.drops):
        fits = [
            (drop.number, drop.result)
            for drop in drops
            if drop.result is not None and drop.result.modulus_pa is not None
        ]
        if fits:
            return fits
    return []


def _basis_of_fits(fits: list[tuple[int, DropResult]], point: PointView, texts: Texts) -> str:
    """Return the drops, the model and the plate of fits; of one fit all that was fitted."""
    if not fits:
        return ""
    order = [str(drop.number) for drop in point.drops]
    drops = drops_text([str(number) for number, _ in fits], order, texts)
    result = fits[0][1]
    if len(fits) > 1:
        declared = result.bedrock_depth_sd_m is None  # a fitted depth differs from drop to drop
        text = formatting.basis_of(result, texts, with_depth=declared)
        return f"{texts.say('from_fits', drops=drops)}: {text}"
    parts = [formatting.basis_of(result, texts), *_ground(facts_of_drop(result), texts)]
    return f"{texts.say('from_fit', drops=drops)}: {', '.join(parts)}"


def _ground(facts: Mapping[str, Fact], texts: Texts) -> Iterator[str]:
    """Yield viscosity and density with their symbols, where a fit has them."""
    for symbol, key in (("η", "viscosity"), ("ρ", "density")):
        if facts[key].value is not None:
            yield f"{symbol} {formatting.show(facts[key], texts)}"


def _effective(fits: list[tuple[int, DropResult]], texts: Texts) -> str:
    """Return the effective modulus of the first layered fit; empty: the ground has no layers."""
    layered = [fit for _, fit in fits if len(fit.layers or ()) > 1]
    text = effective_of(layered[0], texts) if layered else formatting.NO_VALUE
    return "" if text == formatting.NO_VALUE else text


def _use(point: PointView, texts: Texts) -> str:
    """Return what the modulus of a point may be used for, and why; empty: nothing limits it."""
    modulus, diagnosis = point.progress.modulus, diagnosis_of(point)
    if modulus is not None and modulus.not_supported is not None:
        return f"{texts['do_not_use']}: {texts.message(modulus.not_supported)}"
    if diagnosis is None:
        return ""
    reason = texts.message(diagnosis.use_reason)
    if not diagnosis_counts(point):
        key = "use_none" if modulus is None else "use_fits"
        return texts.say(key, reason=reason)
    use = f"{texts[_USE_KEYS[diagnosis.use]]}: {reason}"
    if diagnosis.use != "do-not-use":
        secant = _secant(diagnosis, texts)
        return f"{use}; {secant}" if secant else use
    equivalent = texts[_USE_KEYS[diagnosis.equivalent_use or diagnosis.use]]
    return f"{texts['equivalent_modulus']}: {equivalent}; {texts['modulus']}: {use}"


def _secant(diagnosis: DiagnosisResult, texts: Texts) -> str:
    """Return the stress that a diagnosed modulus belongs to, and that at 100 kPa; empty: linear."""
    facts = facts_of_state(diagnosis.after)
    if facts["stress"].value is None or facts["at 100 kPa"].value is None:
        return ""
    stress = formatting.show(facts["stress"], texts)
    modulus, _ = SI.value_and_ends(facts["at 100 kPa"])
    return texts.say("secant", stress=stress, modulus=f"{texts.decimals(modulus)} MPa")
