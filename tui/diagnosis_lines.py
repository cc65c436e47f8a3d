"""Text of diagnoses: what a modulus may be used for, the effects, and what to do in the field.

`diagnosis_lines` describes one point. `survey_lines` is a table of several points with one line for
each, followed by advice. "Before" is the fit of the base model alone, "after" the fit with effects.
"""

import itertools
import math
import os
import textwrap
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple, TypeGuard, TypeVar

from pfwd.analysis.options import PLATE_WORDS
from pfwd.analysis.results import (
    DiagnosisResult,
    EffectResult,
    FittedState,
    HeldOut,
    HeldOutPart,
)
from pfwd.digits import MISSING, declared, rounded, significant
from pfwd.export.json_text import json_text
from pfwd.facts import UNEXPLAINED, EffectFacts, facts_of_effect, facts_of_state
from pfwd.message_groups import as_ranges, group_messages, text_of
from pfwd.units import SI, Fact, Units, modulus_text, percent
from tui.format import MODEL_WORDS, word
from tui.output import clean, spelled

_T = TypeVar("_T", bound=Hashable)

WIDTH, SCREEN_LINES = 120, 40
"""Characters and lines of a common terminal. The table of a survey fits the width; the warnings are
shown below it if both fit the height."""

MAX_EFFECTS_IN_TABLE = 2
"""Largest number of effects of a point in the table; the strongest ones are shown."""

MIN_COLUMN = 10
"""Smallest width of a wrapped column of the table, characters."""

_GAP = "  "
"""Blanks between two columns."""

_VERDICTS = {
    "clean": "CLEAN: the base model explains the records",
    "explained": "EXPLAINED: with the effects below the model explains the records",
    "unexplained": f"{UNEXPLAINED}: part of the residual remains, whatever the effects",
}
_NO_DROP = "NOTHING TO DIAGNOSE: no drop of the point can be used, see the warnings"
USES = {"design": "design value", "with-care": "use with care", "do-not-use": "do not use"}
_USE_WORDS = {
    "design": "with a design value",
    "with-care": "to use with care",
    "equivalent": "with the equivalent modulus alone",
    "fit": "with the fit without effects",
    "do-not-use": "not to use",
}
_ACTIONS = {
    "design": "use it",
    "with-care": "design with the lower end",
    "do-not-use": "measure again",
}

_EVIDENCE_WORDS = ((5.0, "very strong"), (3.0, "strong"), (1.0, "positive"))
"""Smallest log Bayes factor for each word (Kass and Raftery 1995, section 3.2)."""

_PARAMETER_WORDS = {
    "kick": "additional velocity at liftoff",
    "tension_share": "resistance in tension over that in compression",
    "unrecovered": "permanent fraction of the deflection",
    "sigma_ref": "reference stress",
    "rest_stress": "stress at rest",
    "cap": "limit",
}
"""Names of parameters whose JSON key is not understandable."""


def diagnosis_lines(
    result: DiagnosisResult, *, warnings: bool = True, device_advice: bool = True
) -> list[str]:
    """Return the diagnosis of a point as lines of text, in engineering units.

    Parameters
    ----------
    result : DiagnosisResult
    warnings : bool
        True: warnings are included; for several points `diagnosis_warnings` joins them.
    device_advice : bool
        True: advice on device effects is included; for several points `device_lines` joins it.
    """
    before, after = (facts_of_state(state) for state in (result.before, result.after))
    parameters = [facts_of_effect(effect) for effect in result.effects]
    drops = ", ".join(map(str, result.drops)) or "none"
    device = "" if result.device is None else f", device {clean(result.device)}"
    point = "" if result.point is None else f", point {clean(result.point)}"
    verdict = _VERDICTS[result.verdict]
    lines = [
        f"{clean(result.file)}{point}{device}, drops {drops}",
        f"  {_NO_DROP if result.drops == () else verdict}",
    ]
    if result.before is not None and result.after is not None:
        lines += [
            f"  {word(PLATE_WORDS, result.plate)}, radius {declared(result.plate_radius_m, 'm')}; "
            f"Poisson's ratio {declared(result.poisson_ratio)}",
            f"  before  {_state(result.before, before)}",
            f"  after   {_state(result.after, after)}",
        ]
        if result.effects:
            lines += _change(before["modulus"], after["modulus"])
        elif result.verdict == "unexplained" and before["modulus"] != after["modulus"]:
            lines.append("  no effect is accepted: after is the base model within usual soils")
        sentence = use_sentence(result, after)
        lines += [f"  {sentence}"] if sentence else []
        if result.equivalent_use is not None:
            value, use = SI.show(after["equivalent"]), USES[result.equivalent_use]
            lines.append(f"  Equivalent modulus {value}: {use}.")
    for effect, facts in zip(result.effects, parameters, strict=True):
        lines += _effect(effect, facts, advice=device_advice or effect.scope != "device")
    lines += _held_out(result.held_out)
    lines += [f"  {clean(text)}" for text in result.rejected]
    return [*lines, *diagnosis_warnings([result])] if warnings else lines


def use_sentence(result: DiagnosisResult, facts: Mapping[str, Fact]) -> str:
    """Return a sentence that states what the modulus of a point may be used for.

    It is empty if the drops fell on a rig, which has no modulus.

    Parameters
    ----------
    result : DiagnosisResult
    facts : mapping of str to Fact
        Facts of the state with all effects.
    """
    if facts["modulus"].interval is None:
        return ""
    if result.use == "do-not-use":
        objection = f"{text_of(result.use_reason)}; {text_of(result.remedy)}"
        if not result.modulus:
            return f"Do not use: {objection}."
        text = modulus_text(result.modulus, result.modulus_interval)
        return f"Use the fit without effects: {text}. Do not use the modulus after: {objection}."
    heading = "Design value" if result.use == "design" else "Use with care:"
    text = f"{heading} {SI.show(facts['modulus'])}"
    if facts["stress"].value is not None:
        text += f", secant modulus at {SI.show(facts['stress'])}"
        if facts["at 100 kPa"].value is not None:
            text += f" ({SI.value_and_ends(facts['at 100 kPa'])[0]} MPa at 100 kPa)"
    reason = f": {text_of(result.use_reason)}" if result.use == "with-care" else ""
    return f"{text}{reason}."


def survey_lines(results: Sequence[DiagnosisResult], width: int = WIDTH) -> list[str]:
    """Return a table of several points, one line for each, and the advice below it.

    Parameters
    ----------
    results : sequence of DiagnosisResult
        With the modulus to use at each point.
    width : int
        Largest number of characters of a line.
    """
    uses = [_USE_WORDS[_use_of(result)] for result in results]
    counted = [f"{uses.count(use)} {use}" for use in _USE_WORDS.values() if use in uses]
    lines = [f"{len(results)} points: {', '.join(counted)}", ""]
    names = _names(results)
    points = list(zip(names, results, strict=True))
    diagnosed = [(name, result) for name, result in points if result.drops != ()]
    if diagnosed:
        rows = [point_cells(*point) for point in diagnosed]
        modes = {result.held_out.mode for result in results if result.held_out is not None}
        mode = modes.pop() if len(modes) == 1 else None
        columns = [*_COLUMNS, _PREDICTED.get(mode or "", "held out"), "found", "what to do"]
        # A column without any value is left out.
        filled = [place for place in range(len(columns)) if any(row[place] for row in rows)]
        table = [[row[place] for place in filled] for row in (columns, *rows)]
        lines += [*table_lines(table, width), ""]
    unusable = [
        (name, f"{text_of(result.use_reason)}; {text_of(result.remedy)}")
        for name, result in diagnosed
        if result.use == "do-not-use"
        and result.modulus is None
        and result.after is not None
        and result.after.modulus_interval_pa is not None
    ]
    equivalent = [(name, USES[r.equivalent_use]) for name, r in diagnosed if r.equivalent_use]
    # Points whose modulus must not be used have an advice already.
    advice = [
        (name, (_words(effect.name), effect.advice))
        for name, result in points
        for effect in result.effects
        if effect.advice and effect.scope != "device" and result.use != "do-not-use"
    ]
    notes = [
        *_conditions([result for _, result in diagnosed]),
        *undiagnosed_lines(results),
        *(f"Do not use the modulus of {at}: {text}." for text, at in _joined(unusable, names)),
        *(f"Equivalent modulus of {at}: {use}" for use, at in _joined(equivalent, names)),
        *(clean(f"{effect}, {at}: {text}") for (effect, text), at in _joined(advice, names)),
        *device_lines(results),
    ]
    return [*lines, *(part for note in notes for part in wrapped(note, width))]


def _conditions(results: Sequence[DiagnosisResult]) -> list[str]:
    """Return the assumptions under which the moduli of a table are valid; empty: rigs only."""
    used = [result for result in results if result.plate_radius_m is not None]
    plates = dict.fromkeys(
        f"{word(PLATE_WORDS, result.plate)}, radius {declared(result.plate_radius_m, 'm')}"
        for result in used
    )
    ratios = dict.fromkeys(declared(result.poisson_ratio) for result in used)
    if not used:
        return []
    return [
        "E: secant modulus of the ground at the peak stress of the largest drop, of the layer "
        "above rock where rock was found, with the effects of the device taken out; equivalent: "
        "modulus of the half-space that deflects as much under the plate; "
        f"{' or '.join(plates)}, Poisson's ratio {' or '.join(ratios)}. "
        "Unexplained: what the model lacks, over the peak, an allowance of 0.3 % for its error "
        "included."
    ]


_COLUMNS = ("point", "E, MPa (95 %)", "at stress, kPa", "equivalent, MPa", "use", "unexplained")


class PointCells(NamedTuple):
    """Cells of a point in a table of diagnoses."""

    point: str
    modulus: str
    """Modulus in force with its interval, MPa."""
    stress: str
    """Stress at which a diagnosed modulus is valid, kPa; empty for a fitted modulus."""
    equivalent: str
    """Equivalent modulus with its interval, MPa; empty where no diagnosed modulus is in force."""
    use: str
    """What the modulus may be used for."""
    unexplained: str
    """What the diagnosis leaves unexplained over the peak, allowance included."""
    prediction_error: str
    """Error of the prediction of held-out parts; empty: nothing was held out."""
    effects: str
    """Strongest effects of the ground at the point; device effects are left out."""
    action: str
    """What to do with the modulus, or at the point."""


def _use_of(result: DiagnosisResult) -> str:
    """Return the use of the modulus in force at a point, a key of `_USE_WORDS`."""
    if result.modulus_source == "fitted":
        return "fit"
    return "equivalent" if result.in_force and result.modulus is None else result.use


def point_cells(name: str, result: DiagnosisResult, units: Units = SI) -> PointCells:
    """Return the cells of a point in a table of diagnoses.

    Parameters
    ----------
    name : str
        Name of the point in the table.
    result : DiagnosisResult
        With the modulus to use at the point.
    units : Units, optional
    """
    facts = facts_of_state(result.after)
    use, action, stress = USES[result.use], _ACTIONS[result.use], ""
    if result.modulus_source == "fitted":
        use, action = "fit without effects", ""
    elif result.in_force and result.modulus is None:
        key = result.equivalent_use or result.use
        use, action = f"equivalent: {USES[key]}", _ACTIONS[key]
    elif result.in_force and facts["stress"].value is not None:
        stress = units.show(facts["stress"], with_unit=False)
    elif result.after is not None and result.after.model == "rig":
        use, action = "no ground", ""
    effects = [_short_effect(e) for e in result.effects if not _is_shared(e)]
    more = ["..."] if len(effects) > MAX_EFFECTS_IN_TABLE else []
    modulus = Fact("modulus", result.modulus, result.modulus_interval)
    return PointCells(
        name,
        "none" if modulus.value is None else units.show(modulus, with_unit=False),
        stress,
        units.show(facts["equivalent"], with_unit=False) if result.in_force else "",
        use,
        percent(result.explained_to),
        _prediction_cell(result.held_out),
        ", ".join([*effects[:MAX_EFFECTS_IN_TABLE], *more]) or "no effect",
        action,
    )


def table_lines(table: Sequence[Sequence[str]], width: int) -> list[str]:
    """Return the lines of a table whose last two columns are wrapped.

    The width is divided between the two so that the table has the fewest lines.

    Parameters
    ----------
    table : sequence of rows of cells, the heading first
    width : int
        Largest number of characters of a line.
    """
    rows = [[spelled(cell) for cell in row] for row in table]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    room = max(width - sum(widths[:-2]) - len(_GAP) * (len(widths) - 1), 2 * MIN_COLUMN)
    if sum(widths[-2:]) > room:
        shares = range(MIN_COLUMN, room - MIN_COLUMN + 1)
        first = min(shares, key=lambda share: len(_wrapped_rows(rows, share, room - share)))
        return _wrapped_rows(rows, first, room - first)
    return _wrapped_rows(rows, *widths[-2:])


def _wrapped_rows(rows: Sequence[Sequence[str]], *last_widths: int) -> list[str]:
    """Return the lines of a table whose last columns are wrapped to the given widths."""
    fixed = len(last_widths)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)][:-fixed]
    lines = []
    for row in rows:
        wrapped_cells = [
            textwrap.wrap(cell, width)
            for cell, width in zip(row[-fixed:], last_widths, strict=True)
        ]
        cells = [*([cell] for cell in row[:-fixed]), *wrapped_cells]
        for parts in itertools.zip_longest(*cells, fillvalue=""):
            texts = map(str.ljust, parts, (*widths, *last_widths))
            lines.append(_GAP.join(texts).rstrip())
    return lines


def wrapped(text: str, width: int) -> list[str]:
    """Return a text as lines of at most `width` characters; all but the first are indented."""
    return textwrap.wrap(text, width, subsequent_indent="  ", break_on_hyphens=False)


def _short_effect(effect: EffectResult) -> str:
    """Return the name of an effect, with its depth if its value is one."""
    name = _words(effect.name)
    if effect.unit == "m" and _is_finite(effect.value) and _is_finite(effect.sd):
        # Three digits are enough in a table.
        return f"{name} {rounded(effect.value, max(effect.sd, 5e-3 * effect.value))} m"
    return name


def _is_shared(effect: EffectResult) -> bool:
    """Return whether an effect is a device effect with one value for all points of the device."""
    return effect.scope == "device" and not _is_finite(effect.evidence)


def device_lines(results: Sequence[DiagnosisResult]) -> list[str]:
    """Return the effects of devices with their advice, each once with its points."""
    names = _names(results)
    effects: list[tuple[str, tuple[str, str]]] = []
    for name, result in zip(names, results, strict=True):
        for effect in result.effects:
            if effect.scope == "device" and (_is_shared(effect) or result.use != "do-not-use"):
                values = _parameters(facts_of_effect(effect))
                numbers = f" ({'; '.join(values)})" if _is_shared(effect) and values else ""
                advice = f": {effect.advice}" if effect.advice else ""
                effects.append((name, (f"{_words(effect.name)}{numbers}", advice)))
    joined = _joined(effects, names)
    return [clean(f"device: {text}, {points}{advice}") for (text, advice), points in joined]


def _joined(texts: Iterable[tuple[str, _T]], names: Sequence[str]) -> Iterator[tuple[_T, str]]:
    """Yield each different text with the points that have it, consecutive ones as ranges.

    Parameters
    ----------
    texts : iterable of (name of the point, text)
    names : sequence of str
        Names of all points in their order.
    """
    points: dict[_T, dict[str, None]] = {}
    for name, text in texts:
        points.setdefault(text, {})[name] = None
    order = list(dict.fromkeys(names))
    for text, chosen in points.items():
        yield text, "all points" if len(chosen) == len(order) else as_ranges(chosen, order)


def undiagnosed_lines(results: Sequence[DiagnosisResult]) -> list[str]:
    """Return a line with the points that have no usable drop; empty: all have one."""
    names = _names(results)
    empty = [name for name, result in zip(names, results, strict=True) if result.drops == ()]
    return [
        f"NOTHING TO DIAGNOSE at {points} ({len(empty)}): no drop can be used, see the warnings"
        for _, points in _joined(((name, "") for name in empty), names)
    ]


def _names(results: Sequence[DiagnosisResult]) -> list[str]:
    """Return the names of the points, with the file name if there are several files."""
    several = len({result.file for result in results}) > 1
    names = []
    for result in results:
        parts = [os.path.basename(str(result.file))] if several or result.point is None else []
        names.append(clean(" ".join([*parts, *filter(None, [result.point])])))
    return names


def diagnosis_warnings(results: Sequence[DiagnosisResult]) -> list[str]:
    """Return the warnings of diagnoses as lines, each once with its points."""
    names = _names(results)
    order = list(dict.fromkeys(names))
    warnings = [
        (name, text)
        for name, result in zip(names, results, strict=True)
        for text in result.warnings
    ]
    lines = []
    for group in group_messages(warnings):
        where = f", {as_ranges(group.places, order)}" if len(results) > 1 else ""
        where = ", all points" if len(group.places) == len(order) > 2 else where
        lines.append(f"  warning{where}: {clean(group.text)}")
    return lines


def diagnosis_sentence(result: DiagnosisResult, units: Units = SI) -> str:
    """Return the diagnosis of a point in one sentence, or why there is none.

    The sentence has the verdict, the effects, the modulus before and after with its use, and the
    part that is unexplained.
    """
    if result.after is None and not result.effects:
        reason = text_of(next(iter(result.warnings), None))
        return f"not made: {reason or 'no reason was given'}"
    before, after = (facts_of_state(state)["modulus"] for state in (result.before, result.after))
    effects = ", ".join(_words(effect.name) for effect in result.effects)
    moduli = units.show(after)
    if effects and before.value is not None:
        moduli = f"{units.value_and_ends(before)[0]} → {moduli}"
    return (
        f"{clean(result.verdict).upper()}{effects and f', found {effects}'}: E {moduli}, "
        f"{USES[result.use]}; {percent(result.explained_to)} of the peak unexplained, allowance "
        f"included{f'; {text_of(result.remedy)}' if result.use == 'do-not-use' else ''}"
    )


def _prediction_cell(held: HeldOut | None) -> str:
    if held is None:
        return ""
    if held.after is None and held.side_difference is not None:
        return f"sides differ {percent(held.side_difference)}"
    return f"{percent(held.after)} off"


_PREDICTED = {"next": "next drop", "drop": "each drop", "sensor": "each sensor"}


def _held_out(held: HeldOut | None) -> list[str]:
    """Return the prediction errors of held-out parts as lines, and the numbers that were fitted to
    them.
    """
    if held is None:
        return []
    subject = f"{_PREDICTED.get(held.mode, 'held-out part')} predicted"
    if not held.is_prediction and held.mode != "next":
        subject = (
            "device of the other points" if held.mode == "point" else "ground of the other drops"
        )
        subject += ", everything else fitted"
    reference = "no preceding record to scale"
    if held.scaled_record is not None:
        reference = (
            f"preceding record scaled by the peak loads {percent(held.scaled_record)} "
            f"({percent(held.contact_scaled_record)})"
        )
    elif held.mode == "sensor":
        reference = "no two sensors at one distance to compare the sides of the plate"
        if held.side_difference is not None:
            reference = f"sides of the plate differ by {percent(held.side_difference)}"
        if held.after is None:
            return [f"  {subject}, but not judged: {reference} of the peak"]
    lines = [
        f"  {subject}: off by {percent(held.after)} of the peak (contact "
        f"{percent(held.contact_after)}), base model {percent(held.before)} "
        f"({percent(held.contact_before)}), {reference}"
    ]
    parts = held.by
    if len(parts) == 1:
        lines += _peak_error(parts[0].peak_error, held)
    elif parts:
        lines.append(f"    {', '.join(map(_part_error, parts))}")
    names = ", ".join(_words(name) for name in held.fitted)
    lines.append(f"    fitted to the held-out data: {names or 'nothing'}")
    return lines


def _part_error(part: HeldOutPart) -> str:
    text = f"{clean(part.name)} {percent(part.after)}"
    if part.interpolated is None:
        return text
    return f"{text} (between its neighbours {percent(part.interpolated)})"


def _peak_error(error: float | None, held: HeldOut) -> list[str]:
    """Return the error of a predicted peak beside those at other points as a line; empty: none."""
    others = f"{held.peak_error_points} other points"
    if _is_finite(held.largest_peak_error):
        expected = f"largest error at {others} {100 * held.largest_peak_error:.1f} %"
    elif held.peak_error_interval is not None:
        low, high = (f"{100 * end:+.1f}" for end in held.peak_error_interval)
        expected = f"95 % interval by {others} {low} to {high} %"
    else:
        return []
    return [f"    recorded peak {100 * (error or 0.0):+.1f} % from the predicted one; {expected}"]


def _state(state: FittedState, facts: Mapping[str, Fact]) -> str:
    modulus = SI.show(facts["modulus"])
    text = "no ground" if modulus == MISSING else f"E {modulus}"
    if state.equivalent_modulus_interval_pa is not None:
        text += f", equivalent {SI.show(facts['equivalent'])}"
    return (
        f"{text}, {word(MODEL_WORDS, state.model)}; residual "
        f"{percent(state.residual_rms_over_peak)} of the peak (contact "
        f"{percent(state.contact_residual_rms_over_peak)}), "
        f"{significant(state.residual_over_noise)} times noise and model error"
    )


def _change(before: Fact, after: Fact) -> list[str]:
    """Return a line with the change of the modulus; empty: a modulus is missing or undetermined."""
    if not before.value or not after.value:
        return []
    values = (SI.text("modulus", fact.value) for fact in (before, after))
    return [
        f"  the modulus changes from {' to '.join(values)} MPa, by "
        f"{100 * (after.value / before.value - 1):+z.0f} %"
    ]


def _effect(effect: EffectResult, facts: EffectFacts, *, advice: bool) -> list[str]:
    """Return an effect with its parameters as lines; its advice is the last one, if requested."""
    evidence = effect.evidence
    shared = "declared" if effect.scope == "point" else "shared by the device's points"
    strength = _evidence_text(evidence) if _is_finite(evidence) else shared
    if _is_finite(effect.probability) and _is_finite(evidence):
        strength += f", probability {100 * effect.probability:.0f} %"
    numbers = _parameters(facts)
    text = f": {'; '.join(numbers)}" if numbers else ""
    # An effect that was detected without a fit has no scope and no strength.
    text += "" if effect.scope is None and not _is_finite(evidence) else f" [{strength}]"
    lines = [f"  {_words(effect.name)}{text}"]
    if effect.alternatives:
        lines.append(f"    it could also be {' or '.join(map(_words, effect.alternatives))}")
    if effect.advice and advice:
        lines.append(f"    {clean(effect.advice)}")
    return lines


def _evidence_text(evidence: float) -> str:
    """Return the strength of the evidence for an effect, such as "strong evidence"."""
    words = (text for limit, text in _EVIDENCE_WORDS if evidence >= limit)
    return f"{next(words, 'weak')} evidence"


def _words(name: str | None) -> str:
    return clean(name).replace("_", " ")


def _parameters(facts: EffectFacts) -> list[str]:
    """Return the parameters of an effect with their standard deviations as texts."""
    return [
        f"{_PARAMETER_WORDS.get(name) or _words(name)}"
        f"{'' if drop is None else f' (drop {drop})'} {SI.show(fact)}"
        for name, drop, fact in facts
    ]


def _is_finite(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value)


def printed_diagnosis(
    result: DiagnosisResult, *, as_json: bool, device_advice: bool = True
) -> list[str]:
    """Return the lines that ``pfwd diagnose`` prints for a point: one JSON object, or text.

    Parameters
    ----------
    result : DiagnosisResult
        With the modulus to use at the point.
    as_json : bool
    device_advice : bool
        True: the text includes the advice on device effects.
    """
    if not as_json:
        return diagnosis_lines(result, warnings=False, device_advice=device_advice)
    from pfwd.procedures.point import in_force_as_dict

    return [json_text(result.to_json() | in_force_as_dict(result.supported_modulus))]
