"""Random surveys: drops, edits and settings in any order, and the events of their session."""

import random
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.scale import UnsyncedStorage
from pfwd.analysis.result_store import basis_of
from pfwd.analysis.results import DropResult
from pfwd.analysis.screening.drops import compare
from pfwd.files.editing import MOVED_TO, move_with
from pfwd.files.header import declared_values
from pfwd.judging import (
    JobRequest,
    PointView,
    Station,
    drop_from_traces,
    job_of,
    point_view,
)
from pfwd.procedures import Kind, find_procedure, plain_procedure
from pfwd.session.events import (
    DropAnalysed,
    DropSaved,
    Edited,
    JobReported,
    PointDiagnosed,
    SavedDrop,
)
from pfwd.session.live_view import CompletePoints, apply_event
from pfwd.session.setup_file import setup_of
from pfwd.session.stored_drops import point_event, read_point_event
from pfwd_device.recording import DropRecord, SurveyWriter, read_survey
from tests.pfwd.report import surveys
from tests.pfwd.report.surveys import SETUP, half_sine_drop, result_of
from tests.records import known, read
from tui.screen.session.screen_events import SessionStarted
from tui.screen.session.state import SessionState

POINTS = ("1", "2")
"""Names of points, as their drops have them."""
PROCEDURES = (
    plain_procedure(1, 2),
    plain_procedure(0, 1),
    *map(find_procedure, ("mndot", "mchw-885", "tp-bf-stb-b8.3", "paper")),
)

DECLARED = declared_values(SETUP)

PLACE = {"position": {"latitude": 48.1, "longitude": 11.5}}
"""Position of each drop; a point without position is not on the map."""


def measured(target: float | None, count: int = 7) -> list[Any]:
    """Return a point with this number of good drops, and its target."""
    heights = (8000.0, 8100.0)
    moduli = (45e6, 45.5e6)
    fallen = [("drop", "1", heights[n % 2], moduli[n % 2]) for n in range(count)]
    return [*fallen, ("target", "1", target)]


def story_of(number: int) -> list[Any]:
    """Return a story: drops, edits, settings and diagnoses in any order."""
    chance = random.Random(number)
    targets = (30e6, 44e6, 60e6, 4e-4, 6e-4)

    def any_target() -> float | None:
        return chance.choice((*targets, None))

    def job() -> Any:
        kind = chance.choice(("target", "stations", "procedure"))
        if kind == "target":
            return ("job", "", JobRequest(target=chance.choice(targets)))
        if kind == "procedure":
            return ("job", "", JobRequest(procedure=chance.choice(PROCEDURES)))
        places = (Station("12+300", target=any_target()), Station("2", target=any_target()))
        return ("job", "", JobRequest(stations=places))

    def drop() -> Any:
        peaks = (900.0, 1600.0, 6000.0, 8000.0, 8100.0, 9000.0)
        moduli = (None, 40e6, 45e6, 45.5e6)
        return ("drop", chance.choice(POINTS), chance.choice(peaks), chance.choice(moduli))

    def edit() -> Any:
        point, within = chance.choice(POINTS), chance.randint(1, 9)
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
        story = measured(chance.choice(targets))
    elif beginning == "procedure":
        procedure = chance.choice(PROCEDURES)
        request = JobRequest(procedure=procedure, target=chance.choice(targets))
        height = 7070.0 if procedure.nominal_load is not None else 8000.0
        story = [("job", "", request)]
        story += [("drop", "1", height + 40.0 * (n % 2), 45e6 + 5e5 * (n % 2)) for n in range(7)]
        story.append(("target", "1", any_target()))
    elif beginning == "diagnosed":
        story = [*measured(44e6), ("diagnosis", "1", 41e6)]
    story += [chance.choice((drop, edit))() for _ in range(chance.randint(0, 14))]
    return story


def writing(folder: Path) -> SurveyWriter:
    """A writer of the survey."""
    return SurveyWriter.open(folder, publish=False, storage=UnsyncedStorage())


class PlayedSession:
    """Writes a survey, and sends the events of a session that measures it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._begin()

    def _begin(self) -> None:
        self.state = SessionState()
        self.state.take(SessionStarted(None, "1"))
        self._lines: list[PointView] = []
        self._complete = CompletePoints(self._lines.append)
        self._largest = dict.fromkeys(POINTS, 0.0)

    def play(self, story: Iterable[Any]) -> None:
        """Play a session from its start to its end."""
        with writing(self.folder) as writer:
            self.send(JobReported(job_of(writer.contents())))
            for kind, *about in story:
                match kind:
                    case "drop":
                        self._drop(writer, *about)
                    case "job":
                        news = about[1].news(job_of(writer.contents()))
                        for event in news.events():
                            writer.note_event(*event)
                        self.send(JobReported(job_of(writer.contents())))
                    case "move":
                        self._move(writer, *about)
                    case "diagnosis":
                        self._diagnose(writer, *about)
                    case _:
                        self._edit(writer, kind, *about)
        self._complete.rest()

    def send(self, event: Any) -> None:
        """Send an event to all receivers."""
        self.state.take(event)
        if (change := apply_event(self.state.view, event)) is not None:
            self.state.take(change)
            self._complete.take(change)

    @property
    def last_lines(self) -> dict[str, dict[str, Any]]:
        """Last line of the headless log for each point, by the name that its drops have."""
        return {point.name: point.as_json() for point in self._lines}

    def _drop(self, writer: SurveyWriter, point: str, peak: float, modulus: float | None) -> None:
        number = writer.next_number(point)
        drop = half_sine_drop(number, peak)
        record = writer.save_drop(DropRecord(point, drop, None, DECLARED, PLACE))
        setup = setup_of(DECLARED, "test")
        view = drop_from_traces(drop, setup, record=record)
        assert view.screening is not None
        largest = self._largest[point] = max(view.own_pulse_peak, self._largest[point])
        screening = compare(view.screening, view.own_pulse_peak, largest)
        stored = SavedDrop(point, replace(view, screening=screening), drop)
        self.send(DropSaved(stored))
        if screening.status == "rejected":
            return None
        if modulus is None:
            return self.send(DropAnalysed(stored, None, DropResult(), None, True, True))
        result = read(DropResult, result_of(number, modulus))
        writer.save_result(record, result.to_stored())
        return self.send(DropAnalysed(stored, None, result, None, True, True))

    def _edit(self, writer: SurveyWriter, kind: str, where: int | str, value: Any) -> None:
        if isinstance(where, int):
            if where <= writer.drops_acknowledged:
                writer.edit(kind, value, number=where)
                self.send(Edited(kind, value, None, where))
        elif where in _names(writer) and (value is not None or kind in ("discard", "restore")):
            writer.edit(kind, value, point=where)
            self.send(Edited(kind, value, where, None))

    def _move(self, writer: SurveyWriter, number: int, to: str) -> None:
        drop = next((d for d in writer.contents().drops if d.number == number), None)
        if drop is None or drop.discarded or drop.point == to:
            return
        within = move_with(writer, drop, to)
        value = {MOVED_TO: {"point": to, "drop": within}}
        self.send(Edited("discard", value, None, number))
        self.send(known(read_point_event(writer, to)))

    def _diagnose(self, writer: SurveyWriter, name: str, modulus: float) -> None:
        point = next((p for p in writer.contents().points if p.name == name and p.drops), None)
        if point is None:
            return
        measured = point_view(point, job_of(writer.contents()))
        excluded = (Kind.DISCARDED, Kind.REJECTED)
        used = [d.facts.number for d in measured.drops if d.facts.kind not in excluded]
        basis = basis_of(measured.drops[-1].setup)
        diagnosis = surveys.diagnosis(used, basis, modulus, (modulus - 1e6, 44.5e6))
        writer.save_result(point.drops[-1].number, diagnosis.to_stored(), "diagnosis")
        self.send(PointDiagnosed(name, diagnosis))

    def restart(self) -> None:
        """Start the program again: a session sends the content of the survey."""
        self._begin()
        for point in read_survey(self.folder).points:
            event = point_event(point)
            self.send(event)
            peaks = [drop.pulse_peak for drop in event.point.drops]
            self._largest[point.name] = max(peaks, default=0.0)


def _names(writer: SurveyWriter) -> set[str]:
    return {point.name for point in writer.contents().points}


def with_results(story: list[Any]) -> list[Any]:
    """Return the story with a result of every drop; a report inverts drops without one."""
    return [
        (kind, *about[:-1], about[-1] or 45e6) if kind == "drop" else (kind, *about)
        for kind, *about in story
    ]
