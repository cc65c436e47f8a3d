"""How the points of a survey stand: what is judged, against which target, and the verdict."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pfwd_device.errors import RecordingError
from pfwd_device.recording.survey_content import SurveyContent, SurveyDrop, SurveyPoint
from pfwd_survey.errors import OptionError, SurveyError
from pfwd_survey.exporting.rows import Results
from pfwd_survey.files.header import Declaration, PointSetup, setup_from
from pfwd_survey.files.traces import TracePoint
from pfwd_survey.inverting.drop_facts import point_drop
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.inverting.screening.drops import screen_point
from pfwd_survey.procedures import (
    PointDrop,
    PointProgress,
    PointValue,
    Procedure,
    Quantity,
    find_procedure,
    judge,
    parse_procedure,
    shipped_names,
)

PLAIN = Procedure(
    name="none", title="", source="", about="", quantity=Quantity.MODULUS, average="modulus"
)
"""Every measured drop is averaged, and the modulus of the inversion is judged."""


@dataclass(frozen=True, slots=True)
class Standing:
    """How one point stands."""

    procedure: str | None
    """Its name; None: nobody chose one."""
    progress: PointProgress
    modulus: PointValue | None
    """Mean modulus of the inversion over the drops that count, whatever the procedure judges."""


def standings(content: SurveyContent, inverted: Results | None = None) -> Iterator[Standing | None]:
    """How each point of a survey stands, in their order; None: its drops cannot be judged.

    The one place where an export asks for values and verdicts.

    Parameters
    ----------
    content : SurveyContent
    inverted : mapping, optional
        Results in place of the stored ones.
    """
    procedure = _procedure(content)
    for point in content.points:
        yield _standing(point, procedure, inverted)


def _standing(
    point: SurveyPoint, procedure: Procedure | None, inverted: Results | None
) -> Standing | None:
    later = _later(point)
    facts: list[PointDrop] = []
    setup: PointSetup | None = None
    try:
        read = [(drop, drop.read_traces()) for drop in point.drops]
        declared = {**(read[0][1].declared if read else {}), **later, "point": point.title}
        setup = setup_from({k: Declaration(v, "") for k, v in declared.items()}, point.title)
        traces = TracePoint(point.title, setup, tuple(record.drop for _, record in read))
        for (drop, record), screening in zip(read, screen_point(traces), strict=True):
            result = None if inverted is None else inverted.get((point.title, drop.drop))
            result = _result(drop) if inverted is None else result
            facts.append(point_drop(record.drop, setup, screening, result, _discarded(drop)))
    except (RecordingError, SurveyError, IndexError):
        return None
    target = None
    if procedure is None or procedure.quantity is not Quantity.DEFLECTION:
        target = point.target
    progress = judge(
        procedure or PLAIN,
        facts,
        plate_radius=setup.plate_radius,
        poisson_ratio=setup.poisson_ratio,
        target=None if target is None else float(target),
        moisture=setup.moisture,
        material=None if setup.material is None else str(setup.material),
    )
    used = [fact for fact in facts if fact.number in progress.used]
    mean = judge(PLAIN, used, plate_radius=setup.plate_radius).value
    return Standing(None if procedure is None else procedure.name, progress, mean)


def _procedure(content: SurveyContent) -> Procedure | None:
    for event in reversed(content.events):
        kept = event.get("details", event)
        text = kept.get("text") if event.get("event") == "procedure" else None
        if isinstance(text, str) and text:
            unverified = kept.get("enforce_unverified") is True
            try:
                return parse_procedure(text, content.path, enforce_unverified=unverified)
            except OptionError as err:
                raise SurveyError(f"{err}; the survey's procedure cannot be read") from err
    named = {point.declared.get("procedure") for point in content.points}
    known = [str(name) for name in named if name in shipped_names()]
    return find_procedure(known[0]) if len(known) == 1 else None


def _later(point: SurveyPoint) -> dict[str, Any]:
    said: dict[str, Any] = {}
    for edit in point.edits:
        if edit["what"] == "declared" and isinstance(edit.get("value"), dict):
            said |= edit["value"]
    return said


def _discarded(drop: SurveyDrop) -> str | None:
    if not drop.discarded:
        return None
    said = [edit.get("value") for edit in drop.edits if edit["what"] == "discard"]
    return str(said[-1]) if said and said[-1] else ""


def _result(drop: SurveyDrop) -> DropResult | None:
    stored = drop.read_last_result()
    return None if stored is None else DropResult.from_json(stored)
