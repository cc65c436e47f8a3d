"""Odd texts and numbers in files and results."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pfwd
from inversion.notices import text_of
from pfwd.analysis.results import DropResult
from pfwd.files.importing import import_files
from pfwd.files.traces import read_traces
from pfwd.scripting.surveys import DATA_FOLDER
from pfwd_device.recording import SurveyWriter
from tests.records import complete

HOSTILE = "\x1b[31m<b>$x_1$"


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    folder = tmp_path / "site"
    assert [item.error for item in import_files([str(DATA_FOLDER / "layer.csv")], folder)] == [
        None
    ] * 3
    return folder


def test_numbers_of_numpy_become_plain_numbers(layer_results: pfwd.Results) -> None:
    interval = (np.float64(5e7), np.float64(7e7))
    plain = replace(
        layer_results[0],
        modulus_pa=np.float64(6e7),
        modulus_sd_pa=math.nan,
        modulus_interval_pa=interval,
    )
    assert type(plain["modulus_pa"]) is float
    assert plain["modulus_sd_pa"] is None
    assert plain.to_dict()["modulus_interval_pa"] == [5e7, 7e7]
    assert all(type(end) is float for end in plain["modulus_interval_pa"])
    json.dumps(plain.to_dict(), allow_nan=False)


def test_a_stored_modulus_without_its_model_is_damaged(
    survey: Path, layer_results: pfwd.Results
) -> None:
    result = layer_results[0]
    with SurveyWriter.open(survey) as writer:
        writer.save_result(1, complete(DropResult, {**result.to_json(), "model": None}))
        writer.save_result(2, complete(DropResult, result.to_json()))
        writer.save_result(3, complete(DropResult, {**result.to_json(), "plate_radius_m": 0.1}))
    opened = pfwd.open(survey)
    assert repr(opened) == "Survey(site: 1 point, 3 drops, 2 with results, 1 damage)"
    valid, stale = opened.results
    assert [item.in_force for item in opened.results] == [True, False]
    assert "plate_radius_m" in text_of(stale.warnings[0])
    (damage,) = opened.damage
    assert "model: expected a value beside the modulus; it does not count" in damage
    assert valid.modulus == result.modulus
    assert (valid.number, valid.point, valid.file) == (2, "layer", str(survey))


def test_discarded_drops_are_in_the_table_only(survey: Path, layer_results: pfwd.Results) -> None:
    with SurveyWriter.open(survey) as writer:
        for result in layer_results:
            writer.save_result(result.number, complete(DropResult, result.to_json()))
        writer.edit("discard", number=2)
    opened = pfwd.open(survey)
    assert [result.number for result in opened.results] == [1, 3]
    assert [drop.number for drop in opened.drops] == [1, 3]
    assert opened.to_dataframe()["discarded"].tolist() == [False, True, False]
    assert len(opened.to_dict()["drops"]) == 3


def test_text_of_a_file_is_printed_harmlessly(tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    point = read_traces(DATA_FOLDER / "layer.csv")
    named = pfwd.Point(replace(point, setup=replace(point.setup, point=HOSTILE)))
    results = pfwd.invert(named, method="posterior")
    for text in (repr(named), repr(named[0]), str(results), repr(results), repr(results[0])):
        assert "\x1b" not in text
    for table in (named._repr_html_(), results._repr_html_()):
        assert "<b>" not in table
    ax = Figure().subplots()
    results.plot(ax)
    results[0].plot(ax)
    ax.figure.savefig(tmp_path / "picture.png")  # "$" is no formula


def test_a_folder_that_is_no_survey_is_refused(tmp_path: Path) -> None:
    for refused in (pfwd.read, pfwd.invert, pfwd.diagnose):
        with pytest.raises(pfwd.SurveyError) as caught:
            refused(tmp_path)
        assert "\n" not in str(caught.value)


def test_an_unknown_subgrade_has_no_modulus(survey: Path) -> None:
    (result, *_) = pfwd.invert(pfwd.example("layer"), layers=2, method="posterior")
    warning = "modulus of the subgrade not known: 1 to 800 MPa fit as well"
    record = {
        **result.to_dict(),
        "modulus_pa": None,
        "modulus_sd_pa": None,
        "modulus_interval_pa": [1e6, 8e8],
        "warnings": [warning],
        "warning_codes": None,
    }
    with SurveyWriter.open(survey) as writer:
        writer.save_result(1, complete(DropResult, record))
    opened = pfwd.open(survey)
    (stored,) = opened.results
    assert stored.modulus is None
    assert stored.to_dict()["layers"] == json.loads(json.dumps(record["layers"]))
    assert stored.to_dict()["effective_modulus_pa"] == record["effective_modulus_pa"]
    assert warning in str(stored)
    assert f"<td>{warning}</td>" in stored._repr_html_()
    frame = opened.to_dataframe()
    assert frame["modulus_pa"][0] is None or math.isnan(frame["modulus_pa"][0])
    assert frame["modulus_interval_high_pa"][0] == 8e8
