"""No sentence of a report falls back to English: neither a text of the report nor a message."""

import re
import shutil
import tomllib
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

from inversion import PLATE_MODELS, notices
from inversion.effects import Effect
from inversion.effects.catalogue import OWN
from inversion.notices import Notice, codes, gaps_of, templates, terms, text_of, to_json
from pfwd.analysis.result_store import basis_of
from pfwd.analysis.results import DiagnosisResult, DropResult, EffectResult
from pfwd.export.rows import judged_values
from pfwd.files.editing import Edit, edit_survey
from pfwd.procedures import find_procedure, shipped_names
from pfwd.report.blocks import (
    Heading,
)
from pfwd.report.composing import compose
from pfwd.report.content import Report
from pfwd.report.fonts import Letters
from pfwd.report.gathering import ReportOptions, gather
from pfwd.report.slip_blocks import slip_blocks
from pfwd.report.texts import load_texts
from pfwd.session.position import FIX_NAMES
from pfwd_device import Channel
from pfwd_device.recording import DropRecord, SurveyWriter
from pfwd_plugins.quantities import QUANTITY_BY_ROLE
from tests.pfwd.report.surveys import DECLARED, LAYERS, half_sine_drop, result_of, texts_of
from tests.records import complete, known, read

CODES = ["de", "zh"]


@cache
def catalogue(name: str) -> dict[str, Any]:
    folder = resources.files("pfwd.report").joinpath("catalogues")
    return tomllib.loads(folder.joinpath(name).read_text(encoding="utf-8"))


def words_of(text: str) -> set[str]:
    without_checksums = re.sub(r"\b[0-9a-f]{32,}\b", "", text)
    return {word.lower() for word in re.findall(r"[A-Za-z]{3,}", without_checksums)}


@cache
def vocabulary() -> frozenset[str]:
    """Words of the English texts and messages."""
    tables = catalogue("messages/de.toml")
    english = [*catalogue("en.toml").values(), *templates().values(), *terms().values()]
    english += [word.replace("_", " ") for word in tables["words"]]
    english += [effect.advice for effect in OWN]
    return frozenset(words_of(re.sub(r"\{.*?\}", " ", " ".join(english))))


@cache
def translated_words(code: str) -> frozenset[str]:
    """Words that texts of a language have themselves, as units and names of documents."""
    tables = dict(catalogue(f"messages/{code}.toml"))
    values = [*catalogue(f"{code}.toml").values()]
    tables |= tables.pop("procedures")
    values += [text for part in tables.values() for text in part.values()]
    return frozenset(words_of(" ".join(values))) | {"mpa", "kpa", "kns", "sha"}


def english_words(text: str, code: str) -> set[str]:
    return (words_of(text) & vocabulary()) - translated_words(code)


@pytest.mark.parametrize("code", CODES)
def test_names_of_the_program_are_translated(code: str) -> None:
    texts = load_texts(code)
    names = {effect.name for effect in OWN} | {effect.result_name for effect in OWN} - {""}
    names |= {parameter.name for effect in OWN for parameter in effect.parameters}
    names |= {"half-space", "layer", "rig", "measured", "half-sine", *QUANTITY_BY_ROLE}
    names |= {*PLATE_MODELS, "sensor_on_plate", "sensor_on_ground", "declared", "edited", "nmea"}
    names |= {*FIX_NAMES.values(), "unknown"}
    untranslated = {name for name in names if texts.word(name) == name.replace("_", " ")}
    assert not untranslated
    advised = [EffectResult(**EFFECT, name=e.result_name or e.name, advice=e.advice) for e in OWN]
    assert [e.name for e in advised if texts.advice(e) == e.advice] == []


@pytest.mark.parametrize("code", CODES)
def test_every_number_of_a_procedure_has_a_name_and_a_source(code: str) -> None:
    texts, english = load_texts(code), load_texts("en")
    for name in shipped_names():
        procedure = find_procedure(name)
        assert texts.title(procedure) != procedure.title
        if procedure.about:
            about = texts.about(procedure)
            assert not english_words(about, code) - DOCUMENT_WORDS, about
        for key, number in procedure.numbers().items():
            assert texts.number_name(key) != english.number_name(key)
            source = texts.source(procedure, key, number)
            assert not english_words(source, code) - DOCUMENT_WORDS, source


DOCUMENT_WORDS = {"correlation", "report", "deflection", "method", "the", "special", "targets"}
"""English words in titles of documents."""


CHANNEL = {"offset": 0.0, "sensitivity": 28.0, "calibrated": "2026-01-02"}
GEOPHONE = {"natural_frequency": 4.5, "damping": 0.6, "due": "2027-01-02"}
IDENTITY = {
    "model": "PFWD-1",
    "serial_number": "17",
    "firmware": "1.2",
    "sampling_rate": 20000.0,
    "plate_radius": 0.15,
    "plate_mass": 15.0,
    "centre_sensor": "plate",
    "channels": [
        {**CHANNEL, "name": "F", "role": "load"},
        {**CHANNEL, **GEOPHONE, "name": "G1", "role": "geophone"},
    ],
}
MARK = Notice("triggered-by-operator")
EFFECT = {"value": 1.0, "sd": 0.1, "unit": "-"}
STATE = {"modulus_pa": 44e6, "modulus_interval_pa": [42e6, 47e6], "stress_pa": 2e5}
AFTER = {"contact_residual_rms_over_peak": 0.015, "modulus_100kpa_pa": 60e6}


def effect_of(number: int, effect: Effect) -> dict[str, Any]:
    """Return an effect of a diagnosis with all its parameters."""
    parameters = [{**EFFECT, "name": p.name, "unit": p.unit} for p in effect.parameters]
    return {
        **EFFECT,
        "name": effect.result_name or effect.name,
        "parameters": parameters,
        "advice": effect.advice,
        "residual_rms_over_peak_without": 0.02 + 0.01 * number,
        "alternatives": ["sensor_lag", "layer"],
    }


DIAGNOSIS = {
    "verdict": "unexplained",
    "before": {**STATE, "model": "half-space", "residual_rms_over_peak": 0.3},
    "after": {**STATE, **AFTER, "model": "layer", "residual_rms_over_peak": 0.02},
    "effects": [effect_of(number, effect) for number, effect in enumerate(OWN)],
    **to_json(
        [
            Notice("effect-on-bound", {"effect": "layer", "parameter": "thickness"}),
            Notice("effect-ambiguous", {"effect": "sensor_lag", "others": ("layer", "bedrock")}),
        ]
    ),
    "drops": [2, 3, 4],
    "left_out": [1],
    "plate_radius_m": 0.15,
    "poisson_ratio": 0.35,
}


@pytest.fixture(scope="module")
def full_report(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Report:
    """Return a report with something in every place."""
    folder = tmp_path_factory.mktemp("full") / "survey"
    shutil.copytree(made, folder)
    declared = {**DECLARED, "seating_drops": 1, "site": "km 2", "plate_load_modulus_pa": 8e7}
    position = {"latitude": 48.1, "longitude": 11.5, "source": "nmea", "fix": "differential"}
    with SurveyWriter.open(folder, publish=False) as writer:
        for name, load in (("C", 7000.0), ("D", 7050.0), ("E", 7100.0), ("F", 7200.0)):
            for number in (1, 2, 3, 4):
                drop = half_sine_drop(number, load + number)
                centre = drop.channels[0]
                wide = Channel(0.3, centre.quantity, 0.4 * centre.values)
                drop = replace(drop, channels=(centre, wide))
                metadata = {"position": position, "marks": [MARK.to_json()]}
                metadata |= {"time_utc": "2026-03-01T09:00:00Z", "identity": IDENTITY}
                record = DropRecord(name, drop, None, declared | {"zone": name}, metadata)
                result = result_of(number) | (LAYERS if name == "C" else {})
                writer.save_result(writer.save_drop(record), complete(DropResult, result))
    edit_survey(folder, [Edit("discard", "")], "B", 4)
    edit_survey(folder, [Edit("discard", "")], "D")
    report = gather(folder, ReportOptions(procedure="tp-bf-stb-b8.3", target=45e6, store=False))
    points = []
    for point in report.points:
        record = DIAGNOSIS | {"point": point.shown_name, "basis": basis_of(point.setup)}
        points.append(replace(point, whole=None, diagnosis=read(DiagnosisResult, record)))
    check = {"time_utc": "2026-03-01T08:59:00Z", "zero_n": 1.0, "span_ratio": 1.01, "faults": []}
    return replace(report, points=tuple(points), check=check)


@pytest.mark.parametrize("code", CODES)
@pytest.mark.parametrize("slip", [False, True])
def test_no_text_of_a_report_is_english(code: str, slip: bool, full_report: Report) -> None:
    texts, letters = load_texts(code), Letters()
    if slip:
        blocks = slip_blocks(full_report, texts, letters, ReportOptions(point="A", slip=True))
    else:
        blocks = compose(full_report, texts, letters)
        recompute = blocks.index(Heading(texts["recompute"]))
        blocks = blocks[: recompute + 2]  # then come command, settings and files as they are
    untranslated = "a warning of the search"  # of the stored results
    names = [untranslated, full_report.title, full_report.procedure.source]
    english = {}
    for text in texts_of(blocks):
        if text == full_report.survey_name:
            continue
        for name in names:
            text = text.replace(name, "")
        words = english_words(text, code) - DOCUMENT_WORDS - {"pfwd", "point", "time"}
        if words:
            english[text] = words
    assert not english
    text = " ".join(texts_of(blocks))
    expected = ["slip", "yes", "qr_code"]
    if not slip:
        title = f"{texts['procedure']}: {texts.title(full_report.procedure)}"
        assert Heading(title) in blocks
        expected = ["diagnosis", "device", "layers", "lot", "zones", "bowl", "effects", "discarded"]
    assert [key for key in expected if texts[key] not in text] == []


SENTENCES = ("verdict_reason", "value_not_supported", "use_reason", "modulus_not_supported")
"""Exported values that are sentences; their codes are in the progress of the point."""


def judgement_of(report: Report) -> dict[str, Any]:
    """Return what a report states of its points, judged anew, with the texts in German."""
    points = tuple(replace(point) for point in report.points)
    texts = compose(replace(report, points=points), load_texts("de"), Letters())
    diagnoses = [read(DiagnosisResult, known(point.diagnosis).to_stored()) for point in points]
    return {
        "progress": [point.progress for point in points],
        "exported": [
            {key: value for key, value in judged_values(point).items() if key not in SENTENCES}
            for point in points
        ],
        "stored": [codes(diagnosis.warnings or ()) for diagnosis in diagnoses],
        "uses": [diagnosis.use for diagnosis in diagnoses],
        "translated": list(texts_of(texts, pictures=False)),
    }


def test_results_do_not_depend_on_the_english_messages(
    full_report: Report, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = judgement_of(full_report)
    only_codes = {
        code: " ".join([code, *(f"{{{name}:{form}}}" for name, form in gaps_of(text).items())])
        for code, text in templates().items()
        if code != notices.OTHER
    } | {notices.OTHER: "{text}"}
    catalogue = notices._catalogue()._replace(templates=only_codes)
    monkeypatch.setattr(notices, "_catalogue", lambda: catalogue)
    assert text_of(Notice("no-target")) == "no-target"
    after = judgement_of(full_report)
    for key, value in before.items():
        assert after[key] == value, key
