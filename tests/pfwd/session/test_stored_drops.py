"""Drops of a survey with their setup, result in force, judgement and position."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pfwd.analysis.results import DropResult
from pfwd.errors import SurveyError
from pfwd.files.editing import Edit, edit_survey
from pfwd.judging.places import Place, place_in
from pfwd.judging.view import read_points
from pfwd.session.events import DropSaved, SurveyChanged
from pfwd.session.stored_drops import add_result, recorded_drop, stored_results
from pfwd_device.recording import SurveyWriter
from tests.pfwd.report.surveys import result_of
from tests.pfwd.scripted_feed import connected
from tests.pfwd.session.measured import drops, record
from tests.records import read

TWO_DROPS = drops(8000.0, 7000.0)


def test_a_point_has_its_last_result_in_force(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    record(folder, connected(), TWO_DROPS)
    complete_result = read(DropResult, result_of(1, 2e7))
    add_result(folder, 1, read(DropResult, result_of(1, 1e7)))
    add_result(folder, 1, complete_result)
    add_result(folder, 1, DropResult(modulus_pa=5e7))  # damaged
    add_result(folder, 1, replace(complete_result, modulus_pa=9e7, refit="half-space"))
    (point,) = read_points(folder)
    first, second = point.drops
    assert (first.number, first.record, len(first.source.results)) == (1, 1, 4)
    assert first.last_result == complete_result
    assert second.last_result is None
    assert [each.modulus_pa for each in stored_results(folder, 1)] == [9e7, 1e7, 2e7]


def test_a_recorded_drop_comes_with_its_setup_and_its_judgement(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    record(folder, connected(), TWO_DROPS)
    edit_survey(folder, [Edit("declared", {"poisson_ratio": 0.4})], "1")
    each = recorded_drop(folder, 2)
    assert (each.point, each.number, each.record) == ("1", 2, 2)
    assert each.setup.poisson_ratio == 0.4
    assert each.screening.status == "measured"
    assert each.view.own.peak_load == pytest.approx(7000, rel=0.01)
    assert each.view.own.peak_deflection is not None
    with pytest.raises(SurveyError, match="expected drop 9"):
        recorded_drop(folder, 9)


def test_the_position_of_a_point_is_the_receiver_s_unless_it_was_edited(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    positions: list[dict[str, Any]] = [
        {"source": "nmea", "fault": "the receiver has no fix"},
        {"source": "nmea", "latitude": 48.2, "longitude": 11.6},
    ]

    class Receiver:
        def record(self) -> dict[str, Any]:
            return positions.pop(0)

    log = record(folder, connected(), TWO_DROPS, position=Receiver())
    recorded = [event.saved.view.metadata["position"] for event in log.of(DropSaved)]
    assert list(map(place_in, recorded)) == [None, Place(48.2, 11.6)]
    assert log.of(DropSaved)[0].saved.view.metadata["time_local"][-6] in "+-"
    view = log.of(SurveyChanged)[-1].view
    assert view.points["1"].position == (48.2, 11.6)
    assert read_points(folder)[0].position == (48.2, 11.6)
    with SurveyWriter.open(folder) as writer:
        writer.edit("position", {"latitude": 1.0, "longitude": 2.0}, point="1")
    assert read_points(folder)[0].position == (1.0, 2.0)
