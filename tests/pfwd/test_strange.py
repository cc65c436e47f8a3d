"""What is odd in files and results: told, withheld, made harmless."""

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
    assert [one.error for one in import_files([str(DATA_FOLDER / "layer.csv")], folder)] == [
        None
    ] * 3
    return folder


def test_numbers_of_numpy_become_plain_ones() -> None:
    (result,) = pfwd.invert(pfwd.example("half-space"), method="posterior")
    interval = (np.float64(5e7), np.float64(7e7))
    plain = replace(
        result,
        modulus_pa=np.float64(6e7),
        modulus_sd_pa=math.nan,
        modulus_interval_pa=interval,
    )
    assert type(plain["modulus_pa"]) is float
    assert plain["modulus_sd_pa"] is None
    assert plain.to_dict()["modulus_interval_pa"] == [5e7, 7e7]
    assert all(type(end) is float for end in plain["modulus_interval_pa"])
    json.dumps(plain.to_dict(), allow_nan=False)


def test_a_stored_modulus_without_its_model_is_damaged(survey: Path) -> None:
    (result, *_) = pfwd.invert(pfwd.example("layer"), method="posterior")
    with SurveyWriter.open(survey) as writer:
        writer.save_result(1, complete(DropResult, {**result.to_json(), "model": None}))
        writer.save_result(2, complete(DropResult, result.to_json()))
        writer.save_result(3, complete(DropResult, {**result.to_json(), "plate_radius_m": 0.1}))
    opened = pfwd.open(survey)
    assert repr(opened) == "Survey(site: 1 point, 3 drops, 2 with results, 1 damage)"
    whole, of_other_plate = opened.results
    assert [one.in_force for one in opened.results] == [True, False]
    assert "plate_radius_m" in text_of(of_other_plate.warnings[0])
    (damage,) = opened.damage
    assert "model: expected a value beside the modulus; it does not count" in damage
    assert whole.modulus == result.modulus
    assert (whole.number, whole.point, whole.file) == (2, "layer", str(survey))


def test_discarded_drops_are_left_out_of_points_and_stay_in_the_table(survey: Path) -> None:
    results = pfwd.invert(pfwd.example("layer"), method="posterior")
    with SurveyWriter.open(survey) as writer:
        for result in results:
            writer.save_result(result.number, complete(DropResult, result.to_json()))
        writer.edit("discard", number=2)
    opened = pfwd.open(survey)
    assert [result.number for result in opened.results] == [1, 3]
    assert [drop.number for drop in opened.drops] == [1, 3]
    assert opened.to_dataframe()["discarded"].tolist() == [False, True, False]
    assert len(opened.to_dict()["drops"]) == 3


def test_text_of_a_file_is_harmless_where_it_is_shown(tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    point = read_traces(DATA_FOLDER / "layer.csv")
    named = pfwd.Point(replace(point, setup=replace(point.setup, point=HOSTILE)))
    found = pfwd.invert(named, method="posterior")
    for shown in (repr(named), repr(named[0]), str(found), repr(found), repr(found[0])):
        assert "\x1b" not in shown
    for table in (named._repr_html_(), found._repr_html_()):
        assert "<b>" not in table
    ax = Figure().subplots()
    found.plot(ax)
    found[0].plot(ax)
    ax.figure.savefig(tmp_path / "picture.png")  # "$" is no formula


def test_a_folder_that_is_no_survey_is_refused(tmp_path: Path) -> None:
    for refused in (pfwd.read, pfwd.invert, pfwd.diagnose):
        with pytest.raises(pfwd.SurveyError) as caught:
            refused(tmp_path)
        assert "\n" not in str(caught.value)


def test_a_layered_subgrade_that_is_not_known_is_shown_without_a_modulus(survey: Path) -> None:
    (result, *_) = pfwd.invert(pfwd.example("layer"), layers=2, method="posterior")
    said = "modulus of the subgrade not known: 1 to 800 MPa fit as well"
    record = {
        **result.to_dict(),
        "modulus_pa": None,
        "modulus_sd_pa": None,
        "modulus_interval_pa": [1e6, 8e8],
        "warnings": [said],
        "warning_codes": None,
    }
    with SurveyWriter.open(survey) as writer:
        writer.save_result(1, complete(DropResult, record))
    opened = pfwd.open(survey)
    (stored,) = opened.results
    assert stored.modulus is None
    assert stored.to_dict()["layers"] == json.loads(json.dumps(record["layers"]))
    assert stored.to_dict()["effective_modulus_pa"] == record["effective_modulus_pa"]
    assert said in str(stored)
    assert f"<td>{said}</td>" in stored._repr_html_()
    frame = opened.to_dataframe()
    assert frame["modulus_pa"][0] is None or math.isnan(frame["modulus_pa"][0])
    assert frame["modulus_interval_high_pa"][0] == 8e8
