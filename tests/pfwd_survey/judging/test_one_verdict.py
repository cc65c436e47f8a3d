"""One truth per survey: whatever was measured and said, every way to the verdict finds the same."""

import csv
import json
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfwd_device.recording import DropRecord, SurveyWriter, read_survey
from pfwd_survey.exporting.export import export_survey
from pfwd_survey.files.header import declared_values
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.inverting.screening.drops import screen_next
from pfwd_survey.judging import JobRequest, JudgedPoint, job_of, judged_points
from pfwd_survey.measuring.events import DropAnalysed, DropSaved, Edited, HandedOn, JobKnown
from pfwd_survey.measuring.measure import replay
from pfwd_survey.measuring.setup_file import setup_of
from pfwd_survey.measuring.standing import CompletePoints, Standing
from pfwd_survey.measuring.survey_job import point_known
from pfwd_survey.procedures import find_procedure, plain_procedure
from pfwd_survey.reporting import gathering
from tests.pfwd_survey.reporting.surveys import SETUP, half_sine_drop, result_of
from tui.screen.session.screen_events import SessionBegan
from tui.screen.session.state import SessionState

PROCEDURES = (
    plain_procedure(1, 2),
    plain_procedure(0, 1),
    *map(find_procedure, ("mndot", "mchw-885", "tp-bf-stb-b8.3", "paper")),
)
DECLARED = declared_values(SETUP)

numbers = st.integers(1, 7)
targets = st.sampled_from((30e6, 44e6, 60e6, 4e-4, 6e-4))
drops = st.tuples(
    st.just("drop"),
    # A knock, a rebound beside the others, two heights.
    st.sampled_from((900.0, 1600.0, 6000.0, 8000.0, 8100.0, 9000.0)),
    st.sampled_from((None, 40e6, 45e6, 45.5e6)),
)
edits = st.one_of(
    st.tuples(st.sampled_from(("discard", "restore")), numbers, st.none()),
    st.tuples(st.sampled_from(("discard", "restore")), st.none(), st.none()),
    st.tuples(st.just("target"), st.none(), targets),
    st.tuples(st.just("name"), st.none(), st.sampled_from(("12+300", "left"))),
    st.tuples(st.just("job"), st.none(), st.builds(JobRequest, target=targets)),
    st.tuples(
        st.just("job"), st.none(), st.builds(JobRequest, procedure=st.sampled_from(PROCEDURES))
    ),
)
stories = st.lists(drops | edits, min_size=1, max_size=14).map(
    lambda story: [("drop", 8000.0, 45e6), *story]
)


class Told:
    """Writes a survey, and tells what a session would tell while it is written."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.standing = Standing()
        self.state = SessionState()
        self.state.take(SessionBegan(None, "1"))
        self._largest = 0.0

    def play(self, writer: SurveyWriter, story: list[Any]) -> None:
        self.tell(JobKnown(job_of(writer.contents())))
        for what, first, second in story:
            match what:
                case "drop":
                    self._drop(writer, first, second)
                case "job":
                    news = second.news(job_of(writer.contents()))
                    for event in news.events():
                        writer.note_event(*event)
                    self.tell(JobKnown(job_of(writer.contents())))
                case _:
                    self._edit(writer, what, first, second)

    def tell(self, event: Any) -> None:
        self.standing.take(event)
        self.state.take(event)

    def _drop(self, writer: SurveyWriter, peak: float, modulus: float | None) -> None:
        number = writer.next_number("1")
        drop = half_sine_drop(number, peak)
        record = writer.save_drop(DropRecord("1", drop, None, DECLARED, {}))
        setup = setup_of(DECLARED, "test")
        screening, self._largest = screen_next(drop, setup, self._largest)
        handed = HandedOn("1", number, record, "", drop, setup, screening)
        self.tell(DropSaved(handed, ()))
        if screening.status == "rejected" or modulus is None:
            return
        result = DropResult.from_json(result_of(number, modulus))
        writer.save_result(record, result.to_json())
        self.tell(DropAnalysed(handed, None, result, None, True, True))

    def _edit(self, writer: SurveyWriter, what: str, number: int | None, value: Any) -> None:
        if number is not None:
            if number > writer.drops_acknowledged:
                return
            writer.edit(what, value, number=number)
            self.tell(Edited(what, value, None, number))
        else:
            if not writer.points:
                return
            writer.edit(what, value, point="1")
            self.tell(Edited(what, value, "1", None))

    def begin_again(self) -> None:
        """Another program start: what the survey holds is told, as a session does."""
        self.standing, self.state, self._largest = Standing(), SessionState(), 0.0
        self.state.take(SessionBegan(None, "1"))
        for point in read_survey(self.folder).points:
            known = point_known(point)
            self.tell(known)
            self._largest = max(drop.pulse_peak for drop in known.measured.drops)


def shown(point: JudgedPoint) -> tuple[Any, ...]:
    progress = point.progress
    value = progress.value
    return (
        value and (value.quantity, value.value, value.interval, value.drops),
        progress.target,
        progress.verdict,
        progress.verdict_reason,
        progress.used,
        progress.complete,
    )


@settings(max_examples=max(10, settings.default.max_examples // 10))
@given(stories, st.integers(0, 14))
def test_live_resumed_and_read_it_is_one_verdict(story: list[Any], cut: int) -> None:
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "s"
        told = Told(folder)
        with SurveyWriter.open(folder, publish=False) as writer:
            told.play(writer, story[:cut])
        (*_, read) = [None, *judged_points(read_survey(folder))]
        if read is not None:
            assert shown(told.standing.judged("1")) == shown(read), "live"
            told.begin_again()
        with SurveyWriter.open(folder, publish=False) as writer:
            told.play(writer, story[cut:])
        (read,) = judged_points(read_survey(folder))
        assert shown(told.standing.judged("1")) == shown(read), "resumed"
        assert told.state.progress == read.progress, "on the screen"


@settings(max_examples=max(6, settings.default.max_examples // 20))
@given(stories)
def test_replayed_reported_and_exported_it_is_the_same(story: list[Any]) -> None:
    with tempfile.TemporaryDirectory() as place, pytest.MonkeyPatch.context() as patch:
        folder = Path(place) / "s"
        # Every drop has its result: a report inverts what has none, and keeps it with the survey.
        whole = [(what, a, b or 45e6) if what == "drop" else (what, a, b) for what, a, b in story]
        with SurveyWriter.open(folder, publish=False) as writer:
            Told(folder).play(writer, whole)
        survey = read_survey(folder)
        (read,) = judged_points(survey)
        patch.setattr(gathering, "curves_of", lambda *_: None)  # takes long, and judges nothing
        patch.setattr(gathering, "analyse_drop", _refuse)
        (reported,) = gathering.gather(folder).points
        assert reported.progress == read.progress, "reported"
        last, lines = Standing(), []
        complete = CompletePoints(lines.append, analysed=False)

        def listen(event: Any) -> None:
            last.take(event)
            complete.take(event)

        replay(folder, listen)
        assert shown(last.judged("1")) == shown(read), "replayed"
        if lines and lines[-1].progress.complete == read.progress.complete:
            said, expected = lines[-1].as_json(), read.as_json()
            assert (said["target"], said["verdict"]) == (expected["target"], expected["verdict"])
        _compare_exports(folder, Path(place), read)


def _refuse(*_: Any) -> Any:
    raise AssertionError("a stored result was there")


def _compare_exports(folder: Path, place: Path, read: JudgedPoint) -> None:
    value, verdict = read.progress.value, read.progress.verdict.value
    export_survey(folder, "table", place / "t.csv")
    with (place / "t.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    kinds = dict(read.progress.kinds)
    for row in rows:
        assert row["verdict"] == verdict
        assert row["value"] == ("" if value is None else repr(value.value))
        if row["status"] in ("seating", "measured") and kinds[int(row["drop"])] != "discarded":
            assert row["status"] in (kinds[int(row["drop"])], "measured", "seating")
    export_survey(folder, "jsonl", place / "t.jsonl")
    for line in (place / "t.jsonl").read_text(encoding="utf-8").splitlines():
        said = json.loads(line)
        assert (said["verdict"], said["target"]) == (verdict, read.progress.target)
    if any(row["discarded"] == "false" for row in rows):
        export_survey(folder, "pddx", place / "t.pddx")
        assert f"PointVerdict = {verdict}\n" in (place / "t.pddx").read_text(encoding="utf-8")
