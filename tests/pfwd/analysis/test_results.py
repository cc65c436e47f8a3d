"""Results as classes and as JSON: the order of the keys, damaged records."""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inversion import SurrogateLibrary
from inversion.errors import RecordFormatError
from inversion.notices import Notice, text_notice
from inversion.records import JsonRecord, stored_fields, without_none
from inversion.result import PlateContact
from pfwd.analysis.analyse import analyse_drop
from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import (
    DiagnosisResult,
    DropAnalysis,
    DropResult,
    EffectResult,
    FittedState,
    HeldOut,
    LayerResult,
    StructureResult,
)
from pfwd.analysis.screening.drops import Screening
from pfwd.files.header import PointSetup
from pfwd_device import Channel, Drop
from tests.pfwd.report.surveys import result_of
from tests.records import complete, known, read

COMMANDS = (Path(__file__).resolve().parents[3] / "docs" / "command-line.md").read_text("utf-8")
IN_FORCE = ["modulus_source", "modulus_depth_m"]
IN_FORCE += [
    f"{name}{part}_pa"
    for name in ("modulus_in_force", "equivalent_modulus")
    for part in ("", "_interval")
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


def records(kind: type[JsonRecord], **special: Any) -> st.SearchStrategy[Any]:
    """Records of a kind with anything that its fields may hold."""
    by_hint: dict[Any, st.SearchStrategy[Any]] = {
        float: numbers,
        int: st.integers(-(10**12), 10**12),
        str: texts,
        str | int | float: texts | numbers,
        bool: st.booleans(),
        tuple[float, float]: st.tuples(numbers, numbers),
        tuple[float, float | None]: st.tuples(numbers, maybe(numbers)),
        tuple[str, ...]: st.lists(texts, max_size=3).map(tuple),
        Notice: warnings,
        tuple[Notice, ...]: st.lists(warnings, max_size=3).map(tuple),
        tuple[int, ...]: st.lists(st.integers(0, 99), max_size=3).map(tuple),
        tuple[tuple[float, float], ...]: st.lists(st.tuples(numbers, numbers), max_size=2).map(
            tuple
        ),
    }

    def of(hint: Any) -> st.SearchStrategy[Any]:
        inner = without_none(hint)
        if inner is not hint:
            return maybe(of(inner))
        if get_origin(inner) is Literal:
            return st.sampled_from(get_args(inner))
        if inner in by_hint:
            return by_hint[inner]
        if get_origin(inner) is tuple:
            return st.lists(records(get_args(inner)[0]), max_size=2).map(tuple)
        return records(inner)

    hints = get_type_hints(kind)
    names = [field.name for field in stored_fields(kind)]
    return st.builds(kind, **{name: special.get(name, of(hints[name])) for name in names})


drops = records(
    DropResult,
    modulus_pa=numbers,
    modulus_sd_pa=numbers,
    model=texts,
    viscosity_pa_s=numbers,
    density_kg_m3=numbers,
    poisson_ratio=numbers,
    plate=st.sampled_from(get_args(PlateContact)),
    plate_radius_m=numbers,
    bedrock_depth_m=st.none() | st.floats(0.1, 100.0),
)
diagnoses = records(DiagnosisResult)


@given(drops | diagnoses)
def test_a_record_comes_back_from_its_json(record: DropResult | DiagnosisResult) -> None:
    assert type(record).from_json(json.loads(json.dumps(record.to_stored()))) == record


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
def test_the_keys_agree_with_the_document(heading: str, kind: type[JsonRecord]) -> None:
    table = COMMANDS.partition(heading)[2].partition("|---")[2].partition("\n\n")[0]
    rows = [line.split("|")[1] for line in table.splitlines()[1:]]
    documented = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    added = IN_FORCE if kind is DiagnosisResult else []
    required = [f.name for f in dataclasses.fields(kind) if f.default is f.default_factory]
    written = list(kind(**dict.fromkeys(required, 1.0)).to_json())
    # Fits are stored with a diagnosis and not printed.
    stored = {field.name for field in stored_fields(kind)} - {"fits"}
    assert {*documented} == {*stored, *written, *added}
    if kind is not DiagnosisResult:  # its use stands in the document beside its verdict
        assert [name for name in documented if name in written] == written


@pytest.mark.parametrize("written", [None, 3, "text", [1, 2], True])
def test_json_that_is_no_mapping_is_refused(written: object) -> None:
    with pytest.raises(RecordFormatError, match="expected a record with its keys, got "):
        DropResult.from_json(written)


@pytest.mark.parametrize(
    "damage",
    [
        {"modulus_pa": "a lot"},
        {"drop": 2.5},
        {"status": "fell"},
        {"seed": True},
        {"seed": 10**400, "peak_load_n": 10**400},
        {"colour": ["red"]},
        {"facts": {"peak_load_n": "8 kN"}},
        {"bedrock_depth_m": 0.0},
        {"layers": [{"modulus_pa": 9e7}]},
        {"modulus_interval_pa": [1.0]},
        {"modulus_interval_pa": None, "modulus_sd_pa": None},
        *({name: None} for name in ("model", "viscosity_pa_s", "density_kg_m3", "poisson_ratio")),
        *({name: None} for name in ("plate", "plate_radius_m", "warnings")),
        ["bedrock_depth_m"],
    ],
)
def test_a_damaged_record_is_refused(damage: dict[str, Any] | list[str]) -> None:
    """Wrong values, or keys that are missing."""
    sound = complete(DropResult, result_of(1))
    assert DropResult.from_json(sound).modulus_pa == 45e6
    broken = sound | damage if isinstance(damage, dict) else sound
    broken = {
        key: value for key, value in broken.items() if isinstance(damage, dict) or key not in damage
    }
    with pytest.raises(RecordFormatError, match="expected "):
        DropResult.from_json(broken)


def pulse_of(peak: float, offset: float = 0.0) -> Drop:
    time = np.arange(-50, 400) / 1e4
    inside = (time > 0) & (time < 0.018)
    load = offset + np.where(inside, peak * np.sin(np.pi * time / 0.018), 0.0)
    return Drop(3, time, load, (Channel(0.0, "displacement", 1e-8 * load),))


def test_the_peak_load_is_that_of_the_record_less_its_offset() -> None:
    analysis = DropAnalysis(pulse_of(8000.0, offset=70.0), Screening("measured"), None)
    result = drop_result("x.csv", analysis)
    assert result.peak_load_n == pytest.approx(8000.0, rel=1e-3)
    rejected = DropAnalysis(pulse_of(100.0), Screening("rejected", text_notice("no pulse")), None)
    assert drop_result("x.csv", rejected).peak_load_n == pytest.approx(100.0, rel=1e-3)


def test_a_missing_pulse_has_no_peak_load() -> None:
    drop = pulse_of(8000.0)
    missing = (drop.time > 5e-3) & (drop.time < 9e-3)
    drop = dataclasses.replace(drop, load=np.where(missing, np.nan, drop.load))
    analysis = DropAnalysis(drop, Screening("rejected", text_notice("damaged record")), None)
    assert drop_result("x.csv", analysis).peak_load_n is None


SETUP = PointSetup(plate_radius=0.15, plate_mass=0.0, poisson_ratio=0.35)


@pytest.mark.parametrize(
    "options",
    [AnalysisOptions(published=True), AnalysisOptions(method="posterior", model="half-space")],
)
def test_a_result_has_its_method_and_is_not_explained_if_clipped(options: AnalysisOptions) -> None:
    drop = pulse_of(8000.0)
    analysis = analyse_drop(drop, SETUP, Screening("seating"), options, SurrogateLibrary())
    explained = dataclasses.replace(known(analysis.result), explained=True)
    analysis = dataclasses.replace(analysis, result=explained)
    result = drop_result("x", analysis)
    assert result.explained is True
    assert result.method == ("published" if options.published else "posterior")
    clipped = dataclasses.replace(analysis, screening=Screening("seating", clipped=True))
    assert drop_result("x", clipped).explained is False


def test_values_of_some_fields_agree_with_the_json() -> None:
    result = read(DropResult, result_of(1) | {"drift_m": [[0.1, 0.2]]})
    written = result.to_json()
    assert result.values(["seed", "drift_m", "model", "reason"]) == {
        key: written[key] for key in ("seed", "drift_m", "model")
    }


def test_a_modulus_is_open_from_a_factor_of_ten_on() -> None:
    medium = {"viscosity_pa_s": 0.0, "density_kg_m3": 1e3, "poisson_ratio": 0.3}
    layer = LayerResult(modulus_pa=9e7, modulus_interval_pa=(4e7, 4e8), **medium)
    assert layer.modulus_known
    assert not dataclasses.replace(layer, modulus_interval_pa=(4e7, 4.01e8)).modulus_known


@pytest.mark.parametrize("state", [{"modulus_pa": 0.0}, {"modulus_pa": 4e7}])
def test_a_use_follows_from_whatever_a_file_has(state: dict[str, Any]) -> None:
    """A modulus of zero and a residual beyond all measure, as a damaged file may have them."""
    after = FittedState(
        model="half-space",
        modulus_interval_pa=(0.0, 5e7),
        residual_over_noise=1e200,
        residual_rms_over_peak=0.5,
        discrepancy_over_peak=0.5,
        **state,
    )
    result = DiagnosisResult(verdict="explained", after=after)
    assert result.to_json()["use"] == "do-not-use"
