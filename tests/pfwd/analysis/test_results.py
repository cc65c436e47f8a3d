"""Results as classes and as JSON: the order of the keys, what strangers wrote."""

import dataclasses
import json
import math
import re
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inversion import SurrogateLibrary
from inversion.notices import Notice, text_notice
from inversion.records import is_number, stored_fields
from pfwd.analysis.analyse import analyse_drop
from pfwd.analysis.diagnosed_drop import DiagnosedDrop
from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import (
    DiagnosisResult,
    DropAnalysis,
    DropDiagnosis,
    DropResult,
    EffectParameter,
    EffectResult,
    FittedState,
    HalfSinePulse,
    HeldOut,
    HeldOutPart,
    LayerResult,
    MeasuredFacts,
    StoredRecord,
    StructureResult,
)
from pfwd.analysis.screening.drops import Screening
from pfwd.errors import SurveyError
from pfwd.files.header import PointSetup
from pfwd_device import Channel, Drop

COMMANDS = (Path(__file__).resolve().parents[3] / "docs" / "command-line.md").read_text("utf-8")
IN_FORCE = [
    "modulus_in_force_pa",
    "modulus_in_force_interval_pa",
    "modulus_source",
    "modulus_depth_m",
    "equivalent_modulus_pa",
    "equivalent_modulus_interval_pa",
]
"""Keys that the command adds to a diagnosis."""

numbers = st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(10**12), 10**12)
texts = st.text(max_size=5)
warnings = texts.map(text_notice) | st.builds(
    lambda low, high: Notice("depth-not-unique", {"depth_low_m": low, "depth_high_m": high}),
    numbers,
    numbers,
)


def maybe(strategy: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.none() | strategy


def records(kind: type[StoredRecord], **special: Any) -> st.SearchStrategy[Any]:
    """Records of a kind with anything that its fields may hold."""
    by_hint: dict[Any, st.SearchStrategy[Any]] = {
        float | None: numbers,
        int | None: st.integers(-(10**12), 10**12),
        str | None: texts,
        str | int | float | None: texts | numbers,
        bool | None: st.booleans(),
        tuple[float, float] | None: st.tuples(numbers, numbers),
        tuple[float, float | None] | None: st.tuples(numbers, maybe(numbers)),
        tuple[str, ...] | None: st.lists(texts, max_size=3).map(tuple),
        Notice | None: warnings,
        tuple[Notice, ...] | None: st.lists(warnings, max_size=3).map(tuple),
        tuple[int, ...] | None: st.lists(st.integers(0, 99), max_size=3).map(tuple),
        tuple[LayerResult, ...] | None: st.lists(
            st.builds(LayerResult, modulus_pa=numbers, thickness_m=st.none() | numbers), max_size=3
        ).map(tuple),
        tuple[StructureResult, ...] | None: st.lists(
            st.builds(StructureResult, name=texts, probability=numbers), max_size=2
        ).map(tuple),
        tuple[tuple[float, float], ...] | None: st.lists(
            st.tuples(numbers, numbers), max_size=2
        ).map(tuple),
        tuple[DiagnosedDrop, ...] | None: st.lists(
            st.builds(DiagnosedDrop, drop=st.integers(1, 9), start_s=numbers), max_size=2
        ).map(tuple),
        tuple[HeldOutPart, ...] | None: st.lists(
            st.builds(HeldOutPart, name=texts, before=numbers, after=numbers), max_size=3
        ).map(tuple),
    }

    hints = get_type_hints(kind)
    names = [field.name for field in stored_fields(kind)]
    fields = {
        name: special[name] if name in special else maybe(by_hint[hints[name]]) for name in names
    }
    unknown = texts.filter(lambda key: key not in names)
    more = st.dictionaries(unknown, maybe(numbers | texts | st.lists(texts)), max_size=2)
    return st.builds(kind, **fields, more=more)


pulses = maybe(records(HalfSinePulse))
effects = records(
    EffectResult,
    parameters=maybe(st.lists(records(EffectParameter), max_size=2).map(tuple)),
)
some_effects = maybe(st.lists(effects, max_size=2).map(tuple))
drops = records(
    DropResult,
    status=maybe(st.sampled_from(["measured", "seating", "rejected"])),
    half_sine=pulses,
    half_sine_equal_area=pulses,
    diagnosis=maybe(
        records(DropDiagnosis, effects=some_effects, after=maybe(records(FittedState)))
    ),
    facts=maybe(records(MeasuredFacts)),
)
diagnoses = records(
    DiagnosisResult,
    before=maybe(records(FittedState)),
    after=maybe(records(FittedState)),
    held_out=maybe(records(HeldOut)),
    effects=some_effects,
)


@given(drops | diagnoses)
def test_a_record_comes_back_from_its_json(record: StoredRecord) -> None:
    said = json.loads(json.dumps(record.to_json()))
    assert type(record).from_json(said) == record


JSON = st.recursive(
    st.none() | st.booleans() | numbers | texts | st.just(10**400),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=6,
)
NESTED = ("half_sine", "half_sine_equal_area", "diagnosis", "facts")
KEYS = [field.name for field in stored_fields(DropResult)]


@given(st.dictionaries(st.sampled_from(KEYS) | texts, JSON, max_size=8))
def test_nothing_that_a_stranger_wrote_is_lost_or_ends_the_program(said: dict[str, Any]) -> None:
    found = DropResult.from_json(said)
    again = found.to_json()
    for key, value in said.items():
        if isinstance(value, dict) and key in NESTED:
            assert {**again[key], **value} == again[key]
        elif key in ("layers", "structures") and isinstance(value, list):
            # A record has all of its keys when it is written again.
            for written, layer in zip(again[key], value, strict=True):
                assert (written | layer if isinstance(layer, dict) else layer) == written
        elif value is not None or key not in DropResult.OPTIONAL_KEYS:
            assert again[key] == value
    for name, value in dataclasses.asdict(found).items():
        if name.endswith(("_pa", "_m", "_s")) and not name.startswith(
            ("modulus_interval", "bed", "drift")
        ):
            assert value is None or is_number(value)


@pytest.mark.parametrize(
    ("heading", "kind"),
    [
        ("### Keys of an inversion", DropResult),
        ("Each of `structures` has", StructureResult),
        ("Each of `layers` has", LayerResult),
        ("### Keys of a diagnosis", DiagnosisResult),
        ("Each of `before` and `after` has", FittedState),
        ("Each of `effects` has", EffectResult),
        ("`held_out` has", HeldOut),
    ],
)
def test_the_keys_are_those_of_the_document(heading: str, kind: type[StoredRecord]) -> None:
    table = COMMANDS.partition(heading)[2].partition("|---")[2].partition("\n\n")[0]
    rows = [line.split("|")[1] for line in table.splitlines()[1:]]
    documented = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    added = IN_FORCE if kind is DiagnosisResult else []
    written = list(kind().to_json())
    # Fits are stored with a diagnosis and not printed.
    stored = {field.name for field in stored_fields(kind)} - {"fits"}
    assert {*documented} == {*stored, *written, *added}
    if kind is not DiagnosisResult:  # its use stands in the document beside its verdict
        assert [name for name in documented if name in written] == written


def test_a_parameter_of_an_effect_has_four_keys() -> None:
    assert list(EffectParameter().to_json()) == ["name", "value", "sd", "unit"]


@pytest.mark.parametrize("said", [None, 3, "text", [1, 2], True])
def test_what_is_no_record_is_refused_in_one_line(said: object) -> None:
    with pytest.raises(SurveyError, match=r"x\.json: expected a record with its keys, got "):
        DropResult.from_json(said, "x.json")


def test_values_of_another_type_are_kept_and_not_used() -> None:
    said = {"modulus_pa": "a lot", "converged": 1, "drop": 2.5, "status": "fell", "seed": True}
    found = DropResult.from_json(said)
    assert (found.modulus_pa, found.converged, found.drop, found.status) == (None,) * 4
    assert found.unreadable == set(said)
    assert {key: found.to_json()[key] for key in said} == said


def pulse_of(peak: float, offset: float = 0.0) -> Drop:
    time = np.arange(-50, 400) / 1e4
    inside = (time > 0) & (time < 0.018)
    load = offset + np.where(inside, peak * np.sin(np.pi * time / 0.018), 0.0)
    return Drop(3, time, load, (Channel(0.0, "displacement", 1e-8 * load),))


def test_the_peak_load_is_that_of_the_record_less_its_offset() -> None:
    analysis = DropAnalysis(pulse_of(8000.0, offset=70.0), Screening("measured"), None)
    found = drop_result("x.csv", analysis)
    assert found.peak_load_n == pytest.approx(8000.0, rel=1e-3)
    rejected = DropAnalysis(pulse_of(100.0), Screening("rejected", "no pulse"), None)
    assert drop_result("x.csv", rejected).peak_load_n == pytest.approx(100.0, rel=1e-3)


def test_there_is_no_peak_load_where_the_pulse_is_missing() -> None:
    drop = pulse_of(8000.0)
    missing = (drop.time > 5e-3) & (drop.time < 9e-3)
    drop = dataclasses.replace(drop, load=np.where(missing, np.nan, drop.load))
    analysis = DropAnalysis(drop, Screening("rejected", "damaged record"), None)
    assert drop_result("x.csv", analysis).peak_load_n is None


def test_the_method_that_ran_is_told() -> None:
    setup = PointSetup(plate_radius=0.15, plate_mass=0.0, poisson_ratio=0.35)
    drop = pulse_of(8000.0)
    library = SurrogateLibrary()
    told = {
        name: analyse_drop(drop, setup, Screening("measured"), options, library)
        for name, options in (
            ("published", AnalysisOptions(published=True)),
            ("posterior", AnalysisOptions(method="posterior", model="half-space")),
        )
    }
    for name, analysis in told.items():
        assert analysis.fault is None
        said = json.loads(json.dumps(drop_result("x", analysis).to_json()))
        assert said["method"] == name
        assert DropResult.from_json(said).method == name


def test_a_clipped_record_is_never_explained() -> None:
    setup = PointSetup(plate_radius=0.15, plate_mass=0.0, poisson_ratio=0.35)
    options, library = AnalysisOptions(model="half-space"), SurrogateLibrary()
    found = analyse_drop(pulse_of(8000.0), setup, Screening("seating"), options, library)
    assert found.result is not None
    found = dataclasses.replace(found, result=dataclasses.replace(found.result, explained=True))
    assert drop_result("x", found).explained is True
    clipped = dataclasses.replace(found, screening=Screening("seating", clipped=True))
    assert drop_result("x", clipped).explained is False


def test_values_are_those_of_the_json() -> None:
    """Read for some keys alone, as a table does; a further record is left out."""
    more = {"reason": None, "drop": "3", "layers": 7, "colour": ["red"], "seed": 1}
    given = {"half_sine": {"duration_s": 0.02}, "warnings": ["a"], "modulus_interval_pa": [1, 2.5]}
    for said in ({}, more, given, {**more, **given, "modulus_pa": math.nan}):
        result = DropResult.from_json(said)
        written = result.to_json()
        keys = [*written, "point", "refit", "nobody knows it", "to_json", "more"]
        expected = {key: written[key] for key in keys if key in written}
        if result.half_sine is not None:
            del expected["half_sine"]
        assert repr(result.values(keys)) == repr(expected)


def test_a_modulus_is_open_from_a_factor_of_ten_on() -> None:
    assert LayerResult(modulus_pa=9e7, modulus_interval_pa=(4e7, 4e8)).modulus_known
    assert not LayerResult(modulus_pa=9e7, modulus_interval_pa=(4e7, 4.01e8)).modulus_known
    assert LayerResult(modulus_pa=9e7).modulus_known
    assert not LayerResult().modulus_known


@pytest.mark.parametrize("state", [{"modulus_pa": 0.0}, {"modulus_pa": 4e7}])
def test_a_use_follows_from_whatever_a_file_has(state: dict[str, Any]) -> None:
    """A modulus of zero and a residual beyond all measure, as a damaged file may have them."""
    after = FittedState(
        modulus_interval_pa=(0.0, 5e7),
        residual_over_noise=1e200,
        residual_rms_over_peak=0.5,
        discrepancy_over_peak=0.5,
        **state,
    )
    result = DiagnosisResult(verdict="explained", after=after)
    assert result.to_json()["use"] == "do-not-use"
