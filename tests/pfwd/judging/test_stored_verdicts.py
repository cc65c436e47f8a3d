"""Verdicts of 300 random surveys: as stored before all readers shared a model, and naively judged.

The stored verdicts change with the rules alone. Then `python -m
tests.pfwd.judging.test_stored_verdicts`, run in the checkout, writes them anew.
"""

import json
import math
import random
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import t as student

from inversion.notices import text_of
from pfwd.judging import Job, JobRequest, Station, job_of, point_views
from pfwd.procedures import PointProgress, Procedure, Quantity
from pfwd_device.recording import Survey, SurveyDrop, SurveyPoint, read_survey
from tests.pfwd.judging import stories
from tests.pfwd.judging.stories import Told

STORED = Path(__file__).parents[2] / "data" / "verdicts_of_stories.json"
N_STORIES, N_EVERYDAY = 300, 60


# Stories that depend on their number alone.


def story_of(number: int) -> list[Any]:
    """Return a story: drops, edits, settings and diagnoses in any order."""
    chance = random.Random(number)
    targets = (30e6, 44e6, 60e6, 4e-4, 6e-4)

    def target_or_none() -> float | None:
        return chance.choice((*targets, None))

    def job() -> Any:
        kind = chance.choice(("target", "stations", "procedure"))
        if kind == "target":
            return ("job", "", JobRequest(target=chance.choice(targets)))
        if kind == "procedure":
            return ("job", "", JobRequest(procedure=chance.choice(stories.PROCEDURES)))
        places = (Station("12+300", target=target_or_none()), Station("2", target=target_or_none()))
        return ("job", "", JobRequest(stations=places))

    def drop() -> Any:
        peaks = (900.0, 1600.0, 6000.0, 8000.0, 8100.0, 9000.0)
        moduli = (None, 40e6, 45e6, 45.5e6)
        return ("drop", chance.choice(stories.POINTS), chance.choice(peaks), chance.choice(moduli))

    def edit() -> Any:
        point, within = chance.choice(stories.POINTS), chance.randint(1, 9)
        return chance.choice(
            [
                (chance.choice(("discard", "restore")), within, None),
                (chance.choice(("discard", "restore", "target", "name")), point, None),
                ("target", point, chance.choice(targets)),
                ("name", *chance.choice((("1", "12+300"), ("1", "left"), ("2", "3")))),
                ("move", within, point),
                ("diagnosis", point, chance.choice((41e6, 46e6))),
                job(),
            ]
        )

    beginning = chance.choice(("one drop", "measured", "procedure", "diagnosed"))
    story: list[Any] = [("drop", "1", 8000.0, 45e6)]
    if beginning == "measured":
        story = stories.measured(chance.choice(targets))
    elif beginning == "procedure":
        procedure = chance.choice(stories.PROCEDURES)
        request = JobRequest(procedure=procedure, target=chance.choice(targets))
        height = 7070.0 if procedure.nominal_load is not None else 8000.0
        story = [("job", "", request)]
        story += [("drop", "1", height + 40.0 * (n % 2), 45e6 + 5e5 * (n % 2)) for n in range(7)]
        story.append(("target", "1", target_or_none()))
    elif beginning == "diagnosed":
        story = [*stories.measured(44e6), ("diagnosis", "1", 41e6)]
    story += [chance.choice((drop, edit))() for _ in range(chance.randint(0, 14))]
    return story


def outcome(progress: PointProgress) -> dict[str, Any]:
    """Return what is stored of a point."""
    value = progress.value
    return {
        "verdict": progress.verdict.value,
        "reason": text_of(progress.verdict_reason),
        "code": progress.verdict_reason_code and progress.verdict_reason_code.value,
        "target": progress.target,
        "quantity": value and value.quantity.value,
        "value": value and value.value,
        "interval": None if value is None or value.interval is None else list(value.interval),
        "used": list(progress.used),
    }


def played(number: int, folder: Path) -> Survey:
    """Measure the survey of a story."""
    told = Told(folder)
    told.play(story_of(number))
    return read_survey(folder)


def outcomes(survey: Survey) -> dict[str, Any]:
    """Return the outcome of each point that has drops."""
    judged = zip(survey.points, point_views(survey), strict=True)
    return {point.name: outcome(each.progress) for point, each in judged if point.drops}


# A judge that knows nothing of the program's: it reads the raw drops and the edits.


@dataclass
class RawDrop:
    """Peaks and edits of one drop."""

    number: int
    load: float
    deflection: float
    result: Mapping[str, Any] | None
    discarded: bool = False
    moved: bool = False
    rejected: bool = False
    seating: bool = False


def raw_drop(drop: SurveyDrop) -> RawDrop:
    """Read the traces of a drop, without noise and offset, and what was done with it."""
    record = drop.read().drop
    raw = RawDrop(
        drop.drop,
        float(np.max(record.load)),
        float(np.max(record.channels[0].values)),
        next(drop.readable_results(dict), None),
    )
    for edit in drop.edits:
        if edit["what"] == "discard":
            raw.discarded, raw.moved = True, isinstance(edit.get("value"), dict)
        elif edit["what"] == "restore":
            raw.discarded = raw.moved = False
    return raw


def sort_raw(drops: Sequence[RawDrop], procedure: Procedure) -> list[RawDrop]:
    """Mark rejected and seating drops; return those that are averaged."""
    large = [drop.load for drop in drops if drop.load >= 1000.0 and not drop.moved]
    for drop in drops:
        small = drop.load < 1000.0 or drop.load < 0.2 * max(large, default=0.0)
        drop.rejected = drop.moved or small
    loading = [drop for drop in drops if not drop.rejected]
    for place, drop in enumerate(loading):
        seats = procedure.seating_drops
        # The header of these surveys declares one seating drop.
        drop.seating = drop.number <= 1 and not drop.discarded if seats is None else place < seats
    usable = [drop for drop in loading if not drop.seating and not drop.discarded]
    return usable[: procedure.measured_drops]


def target_of(point: SurveyPoint, job: Job, quantity: Quantity) -> float | None:
    """Return the first target of the judged quantity: of point, station, survey."""
    own: float | None = None
    for edit in point.edits:
        if edit["what"] == "target":
            own = edit.get("value")
    stations = {station.name: station.target for station in job.stations}
    known = (own, stations.get(point.title), job.target)
    is_deflection = quantity is Quantity.DEFLECTION
    fitting = [t for t in known if t is not None and (t < 1.0) == is_deflection]
    return fitting[0] if fitting else None


def naive_interval(values: Sequence[float]) -> tuple[float, float] | None:
    """Return Student's 95 % interval of a mean."""
    if len(values) < 3:
        return None
    half = student.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / math.sqrt(len(values))
    return float(np.mean(values) - half), float(np.mean(values) + half)


def naive_value(
    used: Sequence[RawDrop], procedure: Procedure, diagnosis: Mapping[str, Any] | None
) -> tuple[float | None, Any, int]:
    """Return value, interval and number of drops of the judged quantity."""
    radius = 0.15
    if procedure.quantity.is_fitted:
        if diagnosis is not None:
            after = diagnosis["after"]
            return after["modulus_pa"], after["modulus_interval_pa"], 0
        fitted = [drop.result for drop in used if drop.result is not None]
        if not fitted:
            return None, None, 0
        logarithms = np.log([result["modulus_pa"] for result in fitted])
        if len(fitted) == 1:
            return fitted[0]["modulus_pa"], fitted[0]["modulus_interval_pa"], 1
        n = len(fitted)
        half = student.ppf(0.975, n - 1) * np.std(logarithms, ddof=1) / math.sqrt(n)
        ends = np.log([result["modulus_interval_pa"] for result in fitted])
        below, above = np.mean(np.abs(ends - logarithms[:, None]), axis=0)
        middle = float(np.mean(logarithms))
        low, high = middle - math.hypot(below, half), middle + math.hypot(above, half)
        return math.exp(middle), (math.exp(low), math.exp(high)), n
    if not used:
        return None, None, 0
    deflections = np.array([drop.deflection for drop in used])
    loads = np.array([drop.load for drop in used])
    if procedure.quantity is Quantity.DEFLECTION:
        return float(np.mean(deflections)), naive_interval(deflections.tolist()), len(used)
    assert procedure.factor is not None
    factor = procedure.factor.value
    if procedure.quantity is Quantity.E_VD:
        # 0.1 MPa under any plate, whatever the load was.
        moduli = factor * radius * 1e5 / deflections
        of_means = factor * radius * 1e5 / np.mean(deflections)
    else:
        moduli = factor * (1 - 0.35**2) * loads / (math.pi * radius * deflections)
        of_means = factor * (1 - 0.35**2) * np.mean(loads) / (math.pi * radius * deflections.mean())
    value = float(np.mean(moduli)) if procedure.average == "modulus" else float(of_means)
    interval = naive_interval(moduli.tolist())
    if interval is not None:
        shift = value - float(np.mean(moduli))
        interval = interval[0] + shift, interval[1] + shift
    return value, interval, len(used)


def diagnosis_in_force(point: SurveyPoint, drops: Sequence[RawDrop]) -> Mapping[str, Any] | None:
    """Return the last diagnosis of a point if the same drops count as when it was made."""
    counted = [drop.number for drop in drops if not drop.rejected and not drop.discarded]
    for drop in reversed(point.drops):
        found = drop.read_diagnosis(dict)
        if found is not None:
            return found if counted and set(found["drops"]) == set(counted) else None
    return None


def naive_outcome(point: SurveyPoint, job: Job) -> dict[str, Any]:
    """Judge a point from its raw drops and edits."""
    procedure = job.procedure_in_force
    drops = [raw_drop(drop) for drop in point.drops]
    used = sort_raw(drops, procedure)
    diagnosis = diagnosis_in_force(point, drops)
    value, interval, n_with_value = naive_value(used, procedure, diagnosis)
    target = target_of(point, job, procedure.quantity)
    wanted = procedure.measured_drops
    copies = len({(drop.load, drop.deflection) for drop in used}) < len(used)
    nominal = procedure.nominal_load
    wrong_load = nominal is not None and any(
        abs(drop.load - nominal.value) > 0.1 * nominal.value for drop in used
    )
    lacking = wanted is not None and diagnosis is None and n_with_value < len(used)
    if procedure.quantity is Quantity.MODULUS and diagnosis is not None:
        without = [drop for drop in used if drop.result is None]
        lacking = wanted is not None and 0 < len(without) < len(used)
    verdict = "undecided"
    if target is None or point.discarded:
        verdict = "none"
    elif not (wrong_load or len(used) < (wanted or 1) or lacking or copies or interval is None):
        low, high = interval
        smaller_is_better = procedure.quantity is Quantity.DEFLECTION
        if high <= target if smaller_is_better else low >= target:
            verdict = "pass"
        elif low > target if smaller_is_better else high < target:
            verdict = "fail"
    return {
        "verdict": verdict,
        "value": value,
        "interval": interval and list(interval),
        "used": [drop.number for drop in used],
    }


# The tests.


def checked(number: int) -> Iterator[str]:
    """Yield what differs in a story: from the stored verdicts, or from the naive judge."""
    stored = json.loads(STORED.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as place:
        survey = played(number, Path(place) / "s")
        found, job = outcomes(survey), job_of(survey)
        expected = stored["stories"][number]
        if set(found) != set(expected):
            yield f"points {sorted(found)}, stored {sorted(expected)}"
        for point in survey.points:
            if point.drops:
                # Student's quantiles of the program are rounded to four digits.
                for name, other, accuracy in (
                    ("stored", expected[point.name], 1e-9),
                    ("naive", naive_outcome(point, job), 2e-4),
                ):
                    for key, value in other.items():
                        if not is_same(found[point.name][key], value, accuracy):
                            got = found[point.name][key]
                            yield f"{point.name}, {key}: {got!r}, {name} {value!r}"


def is_same(one: Any, other: Any, accuracy: float) -> bool:
    """Return whether two values agree; numbers differ between platforms by their last digits."""
    if isinstance(one, float | list) and isinstance(other, float | list):
        return bool(one == pytest.approx(other, rel=accuracy))
    return bool(one == other)


@pytest.mark.parametrize("part", range(6))
def test_everyday_stories_have_their_verdicts(part: int) -> None:
    numbers = range(part, N_EVERYDAY, 6)
    assert {number: list(checked(number)) for number in numbers} == {n: [] for n in numbers}


@pytest.mark.slow
def test_all_stories_have_their_verdicts() -> None:
    differing = {number: list(checked(number)) for number in range(N_STORIES)}
    assert {number: texts for number, texts in differing.items() if texts} == {}


def test_the_stories_come_to_every_verdict_and_reason() -> None:
    stored = json.loads(STORED.read_text(encoding="utf-8"))["stories"]
    points = [point for story in stored for point in story.values()]
    assert {point["verdict"] for point in points} == {"pass", "fail", "undecided", "none"}
    codes = {point["code"] for point in points}
    assert codes >= {"decided", "interval", "precondition", "drops-missing", "value-missing"}
    decided = [point for point in points if point["code"] == "decided"]
    assert len(decided) > 100
    quantities = {"modulus", "equivalent-modulus", "deflection", "E_vd", "E_LWD"}
    assert {point["quantity"] for point in decided} == quantities


def store() -> None:
    """Write the verdicts of this revision."""
    found = []
    with tempfile.TemporaryDirectory() as place:
        for number in range(N_STORIES):
            found.append(outcomes(played(number, Path(place) / str(number))))
    lines = ",\n".join(json.dumps(each) for each in found)
    text = f'{{"stories": [\n{lines}\n]}}\n'
    STORED.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    store()
