"""Two processes make the same rows as one, whatever becomes of the second."""

import pickle
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pfwd import spawning
from pfwd.export import parts
from pfwd.export.export import ExportSummary, export_survey
from pfwd.export.parts import (
    MIN_LEDGER_BYTES,
    Part,
    SecondProcess,
    parts_of,
    row_texts,
    second_process,
)
from pfwd.export.rows import Order
from pfwd.export.tables import jsonl_texts, table_texts
from pfwd.files.folders import has_ledger_of
from pfwd.judging import job_of
from pfwd_device.recording import Survey, read_survey

TIMEOUT = 60.0  # s; a process takes half a second to start on an idle machine


@pytest.fixture(scope="module")
def second() -> Iterator[SecondProcess]:
    process = SecondProcess()
    yield process
    process.close()


@pytest.fixture(autouse=True)
def _a_point_is_a_part(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "MIN_DROPS_IN_PART", 1)


class Told:
    """A second process that has done what it was asked for, or else failed."""

    def __init__(self, *made: Part | Exception) -> None:
        self.made = made
        self.sizes: list[int] = []

    def make(
        self, _survey: object, _job: object, _texts: object, points: Sequence[Any]
    ) -> list[Future[Part]]:
        self.sizes = list(map(len, points))
        futures: list[Future[Part]] = []
        for said in self.made:
            futures.append(future := Future())
            if isinstance(said, Exception):
                future.set_exception(said)
            else:
                future.set_result(said)
        return futures


def asked(second: SecondProcess, content: Survey, texts: Any) -> list[Future[Part]]:
    points = parts_of(content.points)
    made = second.make(content.survey_id, job_of(content), texts, points)
    futures = [future for future in made if future is not None]
    assert len(futures) == len(points) == 2
    return futures


def lines_of(order: Order, texts: Any = table_texts) -> list[str]:
    """The texts of the rows of each point."""
    (*lines,) = row_texts(order, texts)
    return ["".join(lines[:3]), "".join(lines[3:])]


@pytest.mark.parametrize("texts", [table_texts, jsonl_texts])
def test_the_second_process_makes_what_the_first_would(
    survey: Path, second: SecondProcess, texts: Any
) -> None:
    content = read_survey(survey)
    made = [future.result(TIMEOUT) for future in asked(second, content, texts)]
    order = Order(content)
    assert [part.text for part in made] == lines_of(order, texts)
    assert sum(part.results for part in made) == order.results == 2


def test_a_changed_result_is_left_to_the_first_process_which_reports_it(
    survey: Path, second: SecondProcess
) -> None:
    file = survey / "results" / "drop-000002-2.json"
    file.write_text(file.read_text().replace('"modulus_pa":4', '"modulus_pa":9'))
    content = read_survey(survey)
    futures = asked(second, content, table_texts)
    assert "drop-000002-2.json is damaged" in str(futures[0].exception(TIMEOUT))
    order = Order(content, row_maker=second)
    assert "damaged: " in "".join(row_texts(order, table_texts))
    assert order.results == 1
    assert [text.split(":")[0] for text in content.damage] == [f"results/{file.name} is damaged"]


def test_a_drop_that_is_not_whole_in_the_journal_is_left_to_the_first_process(
    survey: Path, second: SecondProcess
) -> None:
    content = read_survey(survey)
    expected = list(row_texts(Order(content), table_texts))
    place = content.points[0].drops[0].place
    assert place is not None
    with (survey / "journal" / "0001.pfwdj").open("r+b") as stream:
        stream.seek(place.entry.offset + 60)
        stream.write(b"\0\0\0\0")
    futures = asked(second, content, table_texts)
    assert "journal" in str(futures[0].exception(TIMEOUT))
    order = Order(content, row_maker=second)
    assert list(row_texts(order, table_texts)) == expected  # from the drop's own file
    assert order.results == 2


def test_a_drop_that_the_journal_has_lost_is_left_to_the_first_process(
    survey: Path, second: SecondProcess
) -> None:
    place = read_survey(survey).points[0].drops[0].place
    assert place is not None
    with (survey / "journal" / "0001.pfwdj").open("r+b") as stream:
        stream.seek(place.entry.offset + 60)
        stream.write(b"\0\0\0\0")
    content = read_survey(survey)
    assert content.points[0].drops[0].place is None
    assert "not in the journal" in str(asked(second, content, table_texts)[0].exception(TIMEOUT))
    order, alone = Order(content, row_maker=second), Order(content)
    assert list(row_texts(order, table_texts)) == list(row_texts(alone, table_texts))


def test_what_the_second_process_has_made_is_taken_in_its_place(survey: Path) -> None:
    content = read_survey(survey)
    (*first, last) = row_texts(Order(content), table_texts)
    told = Told(Part("a\n", 7), BrokenProcessPool("killed"))
    order = Order(content, row_maker=told)  # type: ignore[arg-type]
    assert list(row_texts(order, table_texts)) == ["a\n", last]
    assert order.results == 7 + 0
    told = Told(ValueError("?"), Part("c\n", 5))
    order = Order(content, row_maker=told)  # type: ignore[arg-type]
    assert list(row_texts(order, table_texts)) == [*first, "c\n"]
    assert order.results == 2 + 5


def test_a_process_that_has_ended_is_asked_for_nothing(survey: Path) -> None:
    content = read_survey(survey)
    second = SecondProcess()
    try:
        second._pool.kill()
        order = Order(content, row_maker=second)
        assert list(row_texts(order, table_texts)) == list(row_texts(Order(content), table_texts))
    finally:
        second.close()


def test_a_part_has_250_drops_or_those_of_one_point(
    survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    point = read_survey(survey).points[0]
    counts = (100, 149, 0, 1, 400, 0, 100, 0)
    points = [replace(point, drops=point.drops[:1] * count) for count in counts]
    parts_ = parts_of(points)
    assert [sum(len(point.drops) for point in part) for part in parts_] == [250, 400, 100]
    assert [len(part) for part in parts_] == [3, 1, 1]
    assert parts_of(()) == []


def test_stations_and_a_diagnosis_go_with_the_points(
    survey: Path, second: SecondProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a verdict rests on besides the drops."""
    from pfwd.judging import JobRequest, Station

    content = read_survey(survey)
    stations = (Station("A 1", target=50e6), Station(content.points[1].title, target=30e6))
    job = job_of(content).with_request(JobRequest(stations=stations))
    (*made,) = second.make(content.survey_id, job, table_texts, parts_of(content.points))
    order = Order(content)
    vars(order)["job"] = job
    assert [part.result(TIMEOUT).text for part in made if part] == lines_of(order)
    assert "30000000.0" in lines_of(order)[1]
    said = {"verdict": "clean", "drops": [1]}
    monkeypatch.setattr(type(content), "read_diagnosis", lambda *_: said)
    job, (sent, other) = pickle.loads(pickle.dumps(parts._RemotePoints(content.points, job)))
    assert [drop.read_diagnosis() for drop in sent.drops] == [said] * 3
    assert [len(sent.drops), len(other.drops)] == [3, 1]
    assert job.stations == stations[1:]


@pytest.mark.parametrize(("size", "large"), [(599_999, False), (600_000, True)])
def test_a_survey_of_2000_drops_is_large(tmp_path: Path, size: int, large: bool) -> None:
    (tmp_path / "acknowledged.txt").write_bytes(b"\0" * size)
    assert has_ledger_of(tmp_path, MIN_LEDGER_BYTES) is large


@pytest.mark.parametrize(
    ("jobs", "cores", "large"), [(1, 2, True), (2, 1, True), (2, 2, False), (2, 2, None)]
)
def test_one_process_does_alone_what_two_would_not_do_sooner(
    survey: Path, monkeypatch: pytest.MonkeyPatch, jobs: int, cores: int, large: bool | None
) -> None:
    monkeypatch.setattr(parts, "processors", lambda: cores)
    if large:
        monkeypatch.setattr(parts, "MIN_LEDGER_BYTES", 1)
    monkeypatch.setattr(spawning, "WorkerPool", None)  # would be called
    name = str(survey) if large is not None else str(survey / "missing")
    with second_process(name, jobs) as second:
        assert second is None


def test_a_system_that_starts_no_process_is_no_obstacle(
    survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(process: object) -> None:
        raise OSError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(parts, "processors", lambda: 2)
    monkeypatch.setattr(parts, "MIN_LEDGER_BYTES", 1)
    monkeypatch.setattr(spawning.ShieldedProcess, "start", refused)
    content = read_survey(survey)
    with second_process(str(survey), 2) as second:
        futures = asked(second, content, table_texts)
        assert "unavailable" in str(futures[0].exception(TIMEOUT))
        order = Order(content, row_maker=second)
        assert list(row_texts(order, table_texts)) == list(row_texts(Order(content), table_texts))


@pytest.mark.parametrize("form", ["table", "jsonl"])
def test_an_export_by_two_processes_is_that_by_one(
    survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    def export(name: str, jobs: int) -> tuple[bytes, ExportSummary]:
        told = export_survey(survey, form, tmp_path / name, jobs=jobs)
        return (tmp_path / name).read_bytes(), told

    monkeypatch.setattr(parts, "processors", lambda: 2)
    monkeypatch.setattr(parts, "MIN_LEDGER_BYTES", 1)
    made: list[Part] = []

    def waited_for(request: Future[Part] | None) -> Part | None:
        if request is None:
            return None
        made.append(request.result(TIMEOUT))  # these few drops would all be made here before
        return made[-1]

    monkeypatch.setattr(parts, "helper_result", waited_for)
    alone, told_alone = export("alone", 1)
    assert made == []
    both, told_both = export("both", 2)
    assert len(made) == told_both.points
    assert both == alone
    assert (told_both.results, told_both.notes) == (told_alone.results, told_alone.notes)
    assert told_alone.results == 2
