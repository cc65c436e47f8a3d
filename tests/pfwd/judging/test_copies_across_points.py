"""Verdicts of points that hold a copy of a drop of another point."""

from collections.abc import Callable, Iterable
from pathlib import Path

from inversion.notices import text_of
from pfwd.files.editing import Edit, edit_survey
from pfwd.files.header import PointSetup
from pfwd.files.importing import import_files
from pfwd.files.traces import TracePoint, write_traces
from pfwd.judging import Job, PointView, point_views
from pfwd.procedures import Verdict, find_procedure
from pfwd.session.measure import replay
from pfwd_device import Drop
from pfwd_device.recording import read_survey

FAULT = "its record is a copy of that of drop 6 of point A"


def imported(survey: Path, point: str, drops: Iterable[Drop]) -> list[str]:
    """Import a point from a file of its own; return the remarks on its drops."""
    file = survey.with_name(f"{point}.csv")
    write_traces(file, TracePoint("", PointSetup(plate_radius=0.15, point=point), tuple(drops), ()))
    return [text for drop in import_files([str(file)], survey) for text in drop.remarks]


def judged(survey: Path) -> dict[str, PointView]:
    job = Job(procedure=find_procedure("mndot"), target=1e-2)
    return {point.name: point for point in point_views(read_survey(survey), job)}


def test_the_point_that_gets_a_copy_is_undecided(
    tmp_path: Path, make_drop: Callable[..., Drop]
) -> None:
    def drops(*peaks: float) -> list[Drop]:
        return [make_drop(number=n, peak=peak) for n, peak in enumerate(peaks, 1)]

    survey, mine = tmp_path / "s", (7080.0, 7081.0, 7082.0, 7083.0, 7084.0)
    assert not imported(survey, "A", drops(7070.0, 7071.0, 7072.0, 7073.0, 7074.0, 7075.0))
    # The survey is opened again: samples of earlier drops are compared, whatever their number.
    remarks = imported(survey, "B", drops(*mine[:4], 7075.0, mine[4]))
    assert remarks == [f"drop 5: {FAULT}; the point gets no verdict with it"]
    points = judged(survey)
    assert points["A"].progress.verdict is Verdict.PASS
    assert points["B"].progress.verdict is Verdict.UNDECIDED
    assert text_of(points["B"].progress.verdict_reason).endswith(f"drop 5: {FAULT}")
    replay(survey, lambda _: None, options=None, output=tmp_path / "again")
    assert judged(tmp_path / "again")["B"].progress == points["B"].progress
    edit_survey(survey, [Edit("discard")], "A", 6)
    assert not imported(survey, "C", drops(*(peak + 20 for peak in mine), 7075.01))
    (remark,) = imported(survey, "D", drops(7075.0))
    assert "copy of that of drop 5 of point B" in remark
