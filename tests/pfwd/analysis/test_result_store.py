"""Results that a survey keeps: what the same question is, what counts, what is left as it is."""

import dataclasses
import shutil
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
from tests.records import complete, known

QUICK = AnalysisOptions(method="posterior")
LIBRARY = SurrogateLibrary()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drops, each with the stored result of a question."""
    top = tmp_path_factory.mktemp("made")
    drops = tuple(half_sine_drop(n, 8000.0) for n in (1, 2))
    write_traces(top / "A.csv", TracePoint("", SETUP, drops, ()))
    list(import_files([str(top / "A.csv")], top / "survey"))
    assert stored(ask_and_keep(top / "survey")) == [False, False]
    return top / "survey"


@pytest.fixture
def survey(made: Path, tmp_path: Path) -> Path:
    """A copy that a test may change."""
    return shutil.copytree(made, tmp_path / "survey")


def analysed(folder: Path, options: AnalysisOptions = QUICK) -> FileOutcome:
    return analyse_file(str(folder), options, LIBRARY, use_stored=True)


def ask_and_keep(folder: Path, options: AnalysisOptions = QUICK) -> FileOutcome:
    outcome = analysed(folder, options)
    assert store_drop_results(str(folder), outcome.of_survey) is None
    return outcome


def stored(outcome: FileOutcome) -> list[bool]:
    return [bool(result.stored) for result in outcome.results]


def test_a_question_is_answered_from_the_survey(survey: Path) -> None:
    again = ask_and_keep(survey)
    assert stored(again) == [True, True]
    for drop, answer in zip(read_survey(survey).drops, again.results, strict=True):
        (result,) = drop.readable_results(DropResult.from_json)
        expected = dataclasses.replace(result, refit=None, file=str(survey), stored=True)
        assert answer == expected
        assert known(result.software).startswith("pfwd ")
        assert (result.settings, result.seed) == ("posterior", 0)


def test_a_changed_result_is_recomputed(survey: Path) -> None:
    moduli = [result.modulus_pa for result in analysed(survey).results]
    file = survey / "results" / "trial-000002-1.json"
    file.write_text(file.read_text().replace('"modulus_pa":', '"modulus_pa":9'))
    repeated = ask_and_keep(survey)
    assert stored(repeated) == [True, False]
    assert [result.modulus_pa for result in repeated.results] == moduli
    assert stored(analysed(survey)) == [True, True]


def test_results_are_recomputed_on_request_or_for_another_question(survey: Path) -> None:
    assert stored(analyse_file(str(survey), QUICK, LIBRARY)) == [False, False]
    assert stored(analysed(survey, dataclasses.replace(QUICK, elastic=True))) == [False, False]
    edit_survey(survey, [Edit("declared", {"plate_mass_kg": 31.0})])
    assert stored(analysed(survey)) == [False, False]


def test_a_discarded_drop_does_not_invalidate_stored_results(survey: Path) -> None:
    edit_survey(survey, [Edit("discard")], drop=1)
    (remaining,) = analysed(survey).results
    assert remaining.drop == 2
    assert remaining.stored


def test_a_trial_does_not_count(survey: Path) -> None:
    as_declared = ask_and_keep(survey, AnalysisOptions())
    ask_and_keep(survey, dataclasses.replace(QUICK, elastic=True))
    for drop, result in zip(read_survey(survey).drops, as_declared.results, strict=True):
        counting = known(result_that_counts(drop))
        assert (counting.modulus_pa, counting.settings) == (result.modulus_pa, "as declared")
        trials = [text["settings"] for text in drop.read_results() if text.get("refit")]
        assert trials == ["posterior", "elastic, posterior"]


def test_a_result_chosen_while_measuring_keeps_its_place(survey: Path) -> None:
    with SurveyWriter.open(survey, publish=False) as writer:
        writer.save_result(
            1, complete(DropResult, result_of(1, 5e7) | {"settings": "elastic, posterior"})
        )
    ask_and_keep(survey, AnalysisOptions())
    counting = [known(result_that_counts(drop)) for drop in read_survey(survey).drops]
    assert counting[0].modulus_pa == 5e7
    outcome = ask_and_keep(survey, dataclasses.replace(QUICK, elastic=True))
    first, _ = read_survey(survey).drops
    assert known(result_that_counts(first)).modulus_pa == outcome.results[0].modulus_pa != 5e7


def test_no_result_is_stored_in_a_survey_that_is_being_written(survey: Path) -> None:
    outcome = analyse_file(str(survey), QUICK, LIBRARY)
    with SurveyWriter.open(survey, publish=False):
        text = store_drop_results(str(survey), outcome.of_survey)
    assert "results are not stored" in known(text)
    assert [drop.result_count for drop in read_survey(survey).drops] == [1, 1]


def test_stored_results_are_reported(survey: Path) -> None:
    text = known(stored_results_text("S", analysed(survey).results))
    assert "2 of 2 results" in text
    reseeded = analysed(survey, dataclasses.replace(QUICK, seed=1))
    assert stored_results_text("S", reseeded.results) is None


def test_the_diagnosis_of_a_drop_is_separate_from_its_results(survey: Path) -> None:
    with SurveyWriter.open(survey, publish=False) as writer:
        writer.save_result(2, {"modulus_pa": 5e7})
        writer.save_result(2, {"verdict": "clean"}, "diagnosis")
        writer.save_result(2, {"verdict": "explained"}, "diagnosis")
    first, last = read_survey(survey).drops
    assert first.read_diagnosis(dict) is None
    assert last.read_diagnosis(dict) == {"verdict": "explained"}
    assert last.result_count == 2
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


STEPS = np.arange(32)


@pytest.mark.parametrize(
    "change",
    [
        {"time": STEPS * 2e-4},
        {"load": np.sin(STEPS * 1.0001e-4)},
        {"sensors": (Sensor(0.1, "velocity", np.cos(STEPS * 1e-4)),)},
        {"sensors": (Sensor(0.0, "displacement", np.cos(STEPS * 1e-4)),)},
        {"sensors": (Sensor(0.0, "velocity", np.cos(STEPS * 1.0001e-4)),)},
        {"instrument": Instrument(plate_radius=0.1500001)},
        {"poisson_ratio": 0.36},
        *({name: None} for name in ("density", "bedrock_depth", "model_floor")),
    ],
)
def test_every_part_of_a_record_belongs_to_the_question(change: dict[str, Any]) -> None:
    changed = dataclasses.replace(record(), **change)
    assert question_of([record()], Settings()) != question_of([changed], Settings())


def test_status_and_settings_belong_to_the_question() -> None:
    question = question_of([record()], Settings(), ["measured"])
    assert question == question_of([record()], Settings(), ["measured"])
    assert len(question) == 32
    assert question != question_of([record()], Settings(), ["seating"])
    assert question != question_of([record()], Settings(seed=1), ["measured"])
    assert question != question_of([record(), record()], Settings(), ["measured"])
