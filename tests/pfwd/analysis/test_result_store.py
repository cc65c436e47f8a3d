"""Results that a survey keeps: what the same question is, what counts, what is left as it is."""

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inversion import Record, Settings, SurrogateLibrary
from inversion.forward.model import Instrument
from inversion.measured.record import Sensor
from pfwd.analysis.analyse import analyse_file
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.result_store import (
    question_of,
    result_that_counts,
    store_drop_results,
    stored_results_text,
)
from pfwd.analysis.results import DropResult, FileOutcome
from pfwd.files.editing import Edit, edit_survey
from pfwd.files.importing import import_files
from pfwd.files.traces import TracePoint, write_traces
from pfwd_device.recording import SurveyWriter, read_survey
from tests.pfwd.report.surveys import SETUP, half_sine_drop, result_of
from tests.records import complete

QUICK = AnalysisOptions(method="posterior")
LIBRARY = SurrogateLibrary()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drops without results."""
    top = tmp_path_factory.mktemp("made")
    drops = tuple(half_sine_drop(n, 8000.0) for n in (1, 2))
    write_traces(top / "A.csv", TracePoint("", SETUP, drops, ()))
    list(import_files([str(top / "A.csv")], top / "survey"))
    return top / "survey"


@pytest.fixture
def survey(made: Path, tmp_path: Path) -> Path:
    """A copy that a test may change."""
    return shutil.copytree(made, tmp_path / "survey")


def asked(folder: Path, options: AnalysisOptions = QUICK) -> FileOutcome:
    return analyse_file(str(folder), options, LIBRARY, use_stored=True)


def ask_and_keep(folder: Path, options: AnalysisOptions = QUICK) -> FileOutcome:
    found = asked(folder, options)
    assert store_drop_results(str(folder), found.of_survey) is None
    return found


def stored(found: FileOutcome) -> list[bool]:
    return [bool(result.stored) for result in found.results]


def test_the_same_question_is_answered_from_the_survey(survey: Path) -> None:
    first = ask_and_keep(survey)
    second = asked(survey)
    assert stored(first) == [False, False]
    assert stored(second) == [True, True]
    for old, new in zip(first.results, second.results, strict=True):
        assert dataclasses.replace(new, stored=None) == dataclasses.replace(old, refit=None)


def test_nothing_is_kept_twice(survey: Path) -> None:
    ask_and_keep(survey)
    ask_and_keep(survey)
    assert [drop.result_count for drop in read_survey(survey).drops] == [1, 1]


def test_a_changed_result_is_computed_again_once(survey: Path) -> None:
    first = ask_and_keep(survey)
    file = survey / "results" / "trial-000002-1.json"
    file.write_text(file.read_text().replace('"modulus_pa":', '"modulus_pa":9'))
    again = ask_and_keep(survey)
    assert stored(again) == [True, False]
    assert again.results[1].modulus_pa == first.results[1].modulus_pa
    assert stored(asked(survey)) == [True, True]


def test_results_are_computed_anew_when_they_are_asked_for(survey: Path) -> None:
    ask_and_keep(survey)
    assert stored(analyse_file(str(survey), QUICK, LIBRARY)) == [False, False]


def test_other_settings_are_another_question(survey: Path) -> None:
    ask_and_keep(survey)
    other = dataclasses.replace(QUICK, elastic=True)
    assert stored(asked(survey, other)) == [False, False]


def test_another_declaration_is_another_question(survey: Path) -> None:
    ask_and_keep(survey)
    edit_survey(survey, [Edit("declared", {"plate_mass_kg": 31.0})])
    assert stored(asked(survey)) == [False, False]


def test_a_discarded_drop_does_not_spoil_the_answers_of_the_others(survey: Path) -> None:
    ask_and_keep(survey)
    edit_survey(survey, [Edit("discard")], drop=1)
    (left,) = asked(survey).results
    assert left.drop == 2
    assert left.stored


def test_a_trial_does_not_count(survey: Path) -> None:
    usual = ask_and_keep(survey, AnalysisOptions())
    ask_and_keep(survey, dataclasses.replace(QUICK, elastic=True))
    for drop, result in zip(read_survey(survey).drops, usual.results, strict=True):
        counting = result_that_counts(drop)
        assert counting is not None
        assert counting.modulus_pa == result.modulus_pa
        assert counting.settings == "as declared"
        (trial,) = [said for said in drop.read_results() if said.get("refit")]
        assert trial["refit"] == trial["settings"] == "elastic, posterior"


def test_a_result_chosen_while_measuring_keeps_its_place(survey: Path) -> None:
    with SurveyWriter.open(survey, publish=False) as writer:
        writer.save_result(
            1, complete(DropResult, result_of(1, 5e7) | {"settings": "elastic, posterior"})
        )
    ask_and_keep(survey, AnalysisOptions())
    counting = result_that_counts(read_survey(survey).drops[0])
    assert counting is not None
    assert counting.modulus_pa == 5e7
    assert result_that_counts(read_survey(survey).drops[1]) is not None
    found = ask_and_keep(survey, dataclasses.replace(QUICK, elastic=True))
    counting = result_that_counts(read_survey(survey).drops[0])
    assert counting is not None
    assert counting.modulus_pa == found.results[0].modulus_pa != 5e7


def test_results_say_what_made_them(survey: Path) -> None:
    ask_and_keep(survey)
    for drop in read_survey(survey).drops:
        (said,) = drop.read_results()
        assert str(said["software"]).startswith("pfwd ")
        assert said["settings"] == "posterior"
        assert said["seed"] == 0


def test_a_survey_that_is_written_elsewhere_is_left_alone(survey: Path) -> None:
    found = asked(survey)
    with SurveyWriter.open(survey, publish=False):
        said = store_drop_results(str(survey), found.of_survey)
    assert said is not None
    assert "results are not stored" in said
    assert [drop.result_count for drop in read_survey(survey).drops] == [0, 0]


def test_what_was_kept_is_said(survey: Path) -> None:
    ask_and_keep(survey)
    said = stored_results_text("S", asked(survey).results)
    assert said is not None
    assert said.startswith("S: 2 of 2 results were stored before (pfwd ")
    assert (
        stored_results_text("S", asked(survey, dataclasses.replace(QUICK, seed=1)).results) is None
    )


def test_the_diagnosis_of_a_drop_is_none_of_its_results(survey: Path) -> None:
    with SurveyWriter.open(survey, publish=False) as writer:
        writer.save_result(2, {"modulus_pa": 5e7})
        writer.save_result(2, {"verdict": "clean"}, "diagnosis")
        writer.save_result(2, {"verdict": "explained"}, "diagnosis")
    first, last = read_survey(survey).drops
    assert first.read_diagnosis(dict) is None
    assert last.read_diagnosis(dict) == {"verdict": "explained"}
    assert last.result_count == 1
    assert next(last.readable_results(dict)) == {"modulus_pa": 5e7}


def record() -> Record:
    time = np.arange(32) * 1e-4
    return Record(
        time=time,
        load=np.sin(time),
        sensors=(Sensor(0.0, "velocity", np.cos(time)),),
        instrument=Instrument(plate_radius=0.15),
        density=1800.0,
        bedrock_depth=2.0,
        model_floor=1e-6,
    )


def _moved(**changes: Any) -> Callable[[Record], Record]:
    return lambda found: dataclasses.replace(found, **changes)


@pytest.mark.parametrize(
    "change",
    [
        _moved(time=np.arange(32) * 2e-4),
        _moved(load=np.sin(np.arange(32) * 1.0001e-4)),
        _moved(sensors=(Sensor(0.1, "velocity", np.cos(np.arange(32) * 1e-4)),)),
        _moved(sensors=(Sensor(0.0, "displacement", np.cos(np.arange(32) * 1e-4)),)),
        _moved(sensors=(Sensor(0.0, "velocity", np.cos(np.arange(32) * 1.0001e-4)),)),
        _moved(instrument=Instrument(plate_radius=0.1500001)),
        _moved(poisson_ratio=0.36),
        _moved(density=None),
        _moved(bedrock_depth=None),
        _moved(model_floor=None),
    ],
)
def test_every_part_of_a_record_belongs_to_the_question(
    change: Callable[[Record], Record],
) -> None:
    here = record()
    assert question_of([here], Settings()) != question_of([change(here)], Settings())


def test_what_was_said_and_the_settings_belong_to_the_question() -> None:
    here = question_of([record()], Settings(), ["measured"])
    assert here == question_of([record()], Settings(), ["measured"])
    assert len(here) == 32
    assert here != question_of([record()], Settings(), ["seating"])
    assert here != question_of([record()], Settings(seed=1), ["measured"])
    assert here != question_of([record(), record()], Settings(), ["measured"])
