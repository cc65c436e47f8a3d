"""Sentences of warnings that earlier versions stored have codes."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from inversion.notices import OTHER, from_sentence
from pfwd.analysis.results import DiagnosisResult, DropResult
from pfwd.files.reading import read_points, survey_content

DATA = Path(__file__).parents[2] / "data"


def sentences_in(value: Any) -> Iterator[str]:
    """All warnings of a JSON, at any depth."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from item if key == "warnings" else sentences_in(item)
    elif isinstance(value, list):
        for item in value:
            yield from sentences_in(item)


@pytest.mark.parametrize("name", ["least-squares", "mpga", "diagnosis"])
def test_stored_results_have_codes(name: str) -> None:
    stored = json.loads((DATA / "stored-results-v1" / f"{name}.json").read_text("utf-8"))
    kind = DiagnosisResult if name == "diagnosis" else DropResult
    for record in stored if isinstance(stored, list) else [stored]:
        result = kind.from_json(record)
        assert all(warning.code != OTHER for warning in result.warnings or ())


@pytest.mark.parametrize("name", ["survey-v1", "recording-v1", "exported-v1/survey.h5"])
def test_warnings_of_stored_surveys_have_codes(name: str) -> None:
    drops = survey_content(DATA / name).drops
    assert drops
    sentences = [text for drop in drops for text in sentences_in(drop.read_results())]
    assert [text for text in sentences if from_sentence(text).code == OTHER] == []


def test_numbers_that_are_written_otherwise_now_are_read() -> None:
    sentence = "the records leave the modulus open, between 1.0 and 10 MPa: none is told; another "
    warning = from_sentence(sentence + "declared depth, more sensors or a longer record may fix it")
    assert (warning.code, warning.values["low_pa"]) == ("modulus-left-open", 1e6)


def test_warnings_of_imported_files_have_codes(shared: Path) -> None:
    """The header of an imported point keeps sentences; they are read back as their codes."""
    warnings = [
        warning
        for file in sorted((shared / "originals").glob("*/*.*"))
        for point in read_points(file, overrides={"plate_radius_m": 0.15})
        for warning in point.warnings
    ]
    assert {"stored-traces", "peaks-imported"} <= {warning.code for warning in warnings}
    assert [warning for warning in warnings if warning.code == OTHER] == []


@pytest.mark.parametrize(
    ("sentence", "code"),
    [
        ("residual not explained: 7.5 times the noise is left", "noise-exceeded"),
        (
            "residual not explained: 1.31 times the noise is left by 3 effects at once, where "
            "several may leave 1.2",
            "noise-exceeded-by-several",
        ),
        (
            "geophone_response: 0.0234 is the damping of no instrument in use (0.05 to 1.05): it "
            "stands in for another cause",
            "parameter-unusual",
        ),
        (
            "geophone_response: natural frequency 5.1 Hz by this point alone, 4.5 Hz by all points "
            "of the device: it contradicts them",
            "device-contradicted",
        ),
    ],
)
def test_sentences_that_are_worded_otherwise_now_have_codes(sentence: str, code: str) -> None:
    warning = from_sentence(sentence)
    assert warning.code == code
    assert "expected" in warning
