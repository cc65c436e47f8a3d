"""`import pfwd`: inversion, diagnosis, surveys, tables and plots in scripts."""

import io
import itertools
import json
import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any, get_args

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure

import pfwd
from benchmarks.example_files import TRACES
from inversion.notices import text_notice, text_of
from pfwd.analysis.analyse import analyse_files
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.result_store import store_diagnoses
from pfwd.analysis.results import DiagnosisResult
from pfwd.analysis.screening.drops import REBOUND_OVER_LARGEST
from pfwd.display import BEFORE_COLOUR, MAX_NOTEBOOK_ROWS, html_table
from pfwd.export.columns import DROP_COLUMNS, POINT_COLUMNS
from pfwd.files.editing import Edit, edit_survey
from pfwd.files.importing import import_files
from pfwd.files.traces import read_traces
from pfwd.judging import JobRequest
from pfwd.judging.verdicts import modulus_in_force
from pfwd.procedures import PointModulus, Procedure, find_procedure, plain_procedure
from pfwd.scripting.options import DIAGNOSE_OPTIONS, INVERT_OPTIONS
from pfwd.scripting.surveys import DATA_FOLDER, Traces
from pfwd.units import modulus_text
from pfwd_device.recording import SurveyWriter
from tests.pfwd.report.surveys import save_results
from tests.records import known, read

# As pfwd/scripting/data/README.md says them; a file says nothing of it.
TRUE_MODULI = {"half-space": 60e6, "layer": 45e6, "three-sensors": 80e6}


@pytest.fixture(scope="module")
def inverted() -> Callable[[Any], pfwd.Results]:
    """Gives the results of an example, which are computed once."""
    return cache(lambda name: pfwd.invert(pfwd.example(name)))


@pytest.mark.parametrize(("name", "truth"), TRUE_MODULI.items())
def test_the_examples_are_inverted_to_their_truth(
    name: Any, truth: float, inverted: Callable[[Any], pfwd.Results]
) -> None:
    for result in inverted(name):
        assert result.modulus == pytest.approx(truth, rel=0.005)
        low, high = result.modulus_interval or (math.nan, math.nan)
        assert low < truth < high
        assert (result.warnings, result.in_force) == ((), True)


def test_a_result_prints_the_basis_of_its_modulus(
    inverted: Callable[[Any], pfwd.Results],
) -> None:
    (result,) = inverted("three-sensors")
    line = repr(result)
    for part in (
        f"E {modulus_text(result.modulus, result.modulus_interval)};",
        "layer 1.4 m deep",
        "rigid-rough plate of radius 0.15 m",
        "Poisson's ratio 0.35",
        "no warnings",
    ):
        assert part in line
    assert "np." not in line


def test_the_warnings_are_printed_in_full() -> None:
    time, load, values = _arrays("half-space")
    result = pfwd.invert(
        time, load, values, quantity="velocity", plate_radius=0.15, method="posterior"
    )
    assert "plate-mass-not-declared" in [warning.code for warning in result.warnings]
    text = "plate_mass_kg is not declared: taken as 0"
    assert f"  warning: {text}" in str(result).splitlines()
    assert text in result._repr_html_()


def test_the_keys_agree_with_the_command_line(layer_results: pfwd.Results) -> None:
    path = str(pfwd.example("layer").file)
    (outcome,) = analyse_files([path], AnalysisOptions(method="posterior"))
    records = layer_results.to_dict()["results"]
    for record, result in zip(records, outcome.results, strict=True):
        expected = result.to_json()
        assert list(record) == list(expected)
        del record["elapsed_s"], expected["elapsed_s"]
        assert record == json.loads(json.dumps(expected))


def test_drops_points_surveys_and_paths_give_the_same(layer_results: pfwd.Results) -> None:
    points = pfwd.example("layer")
    moduli = [result.modulus for result in layer_results]
    for several in (points.file, list(points.drops), [points[0]]):
        assert [each.modulus for each in pfwd.invert(several, method="posterior")] == moduli
    first = pfwd.invert(points.drops[0], method="posterior")
    assert isinstance(first, pfwd.Result)
    assert first.modulus == moduli[0]
    survey = pfwd.example("survey")
    assert len(pfwd.invert(survey, method="posterior", bedrock_depth="none")) == 8


def test_arrays_give_the_result_of_their_file() -> None:
    time, load, values = _arrays("three-sensors")
    declared: Any = {"plate_radius": 0.15, "plate_mass": 10.6, "poisson_ratio": 0.35}
    declared |= {"quantity": "velocity", "method": "posterior"}
    result = pfwd.invert(time, load, values, offsets=(0.0, 0.3, 0.6), **declared)
    assert isinstance(result, pfwd.Result)
    drop = pfwd.example("three-sensors").drops[0]
    assert result.modulus == pfwd.invert(drop, method="posterior").modulus
    # On the other side of the plate they say the same.
    mirrored = pfwd.invert(time, load, values, offsets=(-0.0, -0.3, 0.6), **declared)
    assert mirrored.modulus == result.modulus
    assert mirrored.history.offsets.tolist() == [0.0, -0.3, 0.6]


def test_a_drop_is_compared_with_the_drops_of_its_point() -> None:
    point = read_traces(pfwd.example("layer").file)
    factor = 0.9 * REBOUND_OVER_LARGEST
    # Larger drops, so that the small one is above what is a false trigger by itself.
    first, second = (replace(drop, load=5.0 * drop.load) for drop in point.drops[:2])
    drops = (first, replace(second, load=factor * second.load))
    result = pfwd.invert(pfwd.Point(replace(point, drops=drops)).drops[1])
    assert (result.status, result.modulus) == ("rejected", None)
    assert "rejected, false trigger" in repr(result)
    assert "18% of the largest" in result._repr_html_()
    with pytest.raises(pfwd.SurveyError, match="expected a result with traces to draw"):
        result.plot()


def test_the_options_agree_with_the_command_line() -> None:
    drop = pfwd.example("three-sensors").drops[0]
    result = pfwd.invert(
        drop, model="half-space", sensors="centre", plate="rigid-smooth", seed=3, elastic=True
    )
    assert (result.model, result.plate, result["seed"]) == ("half-space", "rigid-smooth", 3)
    assert not result.in_force, "it has other settings"
    assert result.viscosity == 0.0
    assert result.history.offsets.tolist() == [0.0]
    with_depth = pfwd.invert(drop, bedrock_depth=np.float64(1.4), method="posterior")
    assert with_depth.bedrock_depth == 1.4
    assert with_depth["method"] == "posterior"


def test_layers_and_thicknesses_are_options() -> None:
    drop = pfwd.example("three-sensors").drops[0]
    quick: Any = {"sensors": "centre", "method": "posterior"}
    result = pfwd.invert(drop, layers=2, thickness=np.array([0.3]), **quick)
    upper, lower = result["layers"]
    assert (upper["thickness_m"], upper["thickness_interval_m"]) == (0.3, None)
    assert lower["modulus_pa"] == result.modulus
    assert type(upper["modulus_pa"]) is float
    json.dumps(result.to_dict(), allow_nan=False)
    item = pfwd.invert(drop, layers=np.int64(1), thickness="unknown", **quick)
    (layer,) = item["layers"]
    assert layer["modulus_pa"] == item["effective_modulus_pa"] == item.modulus


def test_a_declared_value_wins_over_the_file() -> None:
    points = pfwd.example("half-space")
    for data in (points.file, points.drops[0]):
        result: Any = pfwd.invert(data, plate_radius=0.1, method="posterior")
        first = result if isinstance(result, pfwd.Result) else result[0]
        assert first.plate_radius == 0.1
    (by_header,) = pfwd.invert(points.file, header={"plate_radius_m": 0.1}, method="posterior")
    assert by_header.plate_radius == 0.1


def test_a_joint_inversion_gives_all_drops_the_same_ground() -> None:
    results = pfwd.invert(pfwd.example("layer"), joint=True)
    assert len({item.modulus for item in results}) == 1


WAVE = np.sin(np.linspace(0, np.pi, 100))
TIME = np.arange(100) * 1e-4


MASKED = np.ma.masked_greater(WAVE, 0.9)
DATES = np.arange(100).astype("datetime64[us]")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ((3,), r"data: expected a path, a survey, .* got int"),
        (([],), r"data: expected .* got an empty one"),
        ((["layer.csv", 3],), r"layer.csv: expected a readable trace file"),
        (("no such file.csv",), r"no such file.csv: expected a readable trace file"),
        ((TIME,), r"arrays: expected three: time, load, values, got 1$"),
        ((TIME, WAVE[:50], WAVE), r"load: expected 100 samples .* got 50"),
        ((TIME, WAVE, WAVE[:50]), r"values: expected \(100,\) or"),
        ((TIME, WAVE, [WAVE, WAVE]), r"offsets: expected the distances of 2"),
        ((TIME**2, WAVE, WAVE), r"time: expected uniform, rising steps"),
        ((TIME, np.nan * WAVE, WAVE), r"load: expected finite numbers"),
        ((TIME, MASKED, WAVE), r"load: expected numbers, got masked values; interpolate the miss"),
        ((TIME, WAVE, WAVE + 1j), r"values: expected real numbers, got array\(\["),
        ((DATES, WAVE, WAVE), r"time: expected real numbers, got array\(\['1970-01-01T00:00"),
        ((TIME, "abc", WAVE), r"load: expected real numbers, got 'abc'"),
    ],
)
def test_wrong_data_are_an_error_line(data: tuple[Any, ...], message: str) -> None:
    with pytest.raises(pfwd.SurveyError, match=message) as caught:
        pfwd.invert(*data, plate_radius=0.1)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, r"plate_radius: expected a number > 0, in m, got none"),
        ({"quantity": "speed"}, r"quantity: expected velocity or .*, got 'speed'"),
        ({"header": "plate.toml"}, r"header: expected none for arrays, got one"),
        ({"bedrok_depth": 1}, r"bedrok_depth: expected one of .*; did you mean bedrock_dep"),
        ({"model": "soil"}, r"model: expected .layer. or .half-space., got 'soil'"),
        ({"layers": 2, "thickness": 1 + WAVE[:2]}, r"thickness: expected a value for each"),
        ({"layers": WAVE[:2]}, r"layers: expected a whole number from 1 to 4, "),
        ({"elastic": "yes"}, r"elastic: expected true or false, got 'yes'"),
    ],
)
def test_a_wrong_option_is_an_error_line(options: dict[str, Any], message: str) -> None:
    with pytest.raises(pfwd.SurveyError, match=message) as caught:
        pfwd.invert(TIME, WAVE, WAVE, **options)
    assert "\n" not in str(caught.value)


LAYER = DATA_FOLDER / "layer.csv"
CALLS: list[tuple[Callable[[], object], str]] = [
    (lambda: pfwd.invert("f", header=3), r"header: expected the path of a TOML file"),
    (lambda: pfwd.invert("f", offsets=1.0), r"offsets: expected none unless arrays are given"),
    (lambda: pfwd.invert("f", quantity="velocity"), r"quantity: expected none unless arrays are"),
    (lambda: pfwd.invert(pfwd.read(LAYER), header={}), r"header: .*; give it to pfwd.read"),
    (lambda: pfwd.invert(pfwd.read(LAYER)[0][0], joint=True), r"joint: expected several drops of"),
    (lambda: pfwd.diagnose(LAYER, method="mpga"), r"method: expected one of elastic, load, plate_"),
    (lambda: pfwd.diagnose(LAYER, jobs=0), r"jobs: expected a whole number >= 1, got 0"),
    (lambda: pfwd.read(None), r"path: expected the path of a file or folder"),
    (lambda: pfwd.read(LAYER, channels="all"), r"channels: expected raw or stored, got 'all'"),
    (lambda: pfwd.read(LAYER).plot(3), r"ax: expected axes of matplotlib, .* got int"),
    (lambda: pfwd.open(DATA_FOLDER), r"expected a survey, .* got another folder"),
    (lambda: pfwd.open(LAYER), r"expected a survey, .* got another file"),
    (lambda: pfwd.open(3), r"path: expected the path of a survey, got int"),
    (lambda: pfwd.example("moon"), r"example: expected one of half-space, .* survey, got"),
]


@pytest.mark.parametrize(("call", "message"), CALLS)
def test_a_wrong_call_is_an_error_line(call: Callable[[], object], message: str) -> None:
    with pytest.raises(pfwd.SurveyError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_the_diagnosis_finds_the_effect_of_the_example(diagnosis: pfwd.Diagnosis) -> None:
    # Text, verdict and effects are those of docs/python.md, whose examples are run as a test.
    # The sensor comes 0.5 ms late, over a ground of 50 MPa (pfwd/scripting/data/README.md).
    (effect,) = diagnosis["effects"]
    assert effect["value"] == pytest.approx(5e-4, rel=0.02)
    before, after = diagnosis.before, diagnosis.after
    assert after is not None
    assert after["modulus_pa"] == pytest.approx(50e6, rel=0.005)
    # The delay is an unknown of the fit without effects, too.
    assert known(before)["modulus_pa"] == pytest.approx(50e6, rel=0.005)
    frame = diagnosis.to_dataframe()
    assert frame["state"].tolist() == ["before", "after"]
    assert frame["in_force"].tolist() == [False, True]
    assert set(frame["use"]) == {"design"}
    assert (diagnosis.modulus, diagnosis.use) == (after["modulus_pa"], "design")
    assert (diagnosis.in_force, diagnosis.modulus_source) == (True, "diagnosed")
    assert diagnosis.modulus_interval == tuple(after["modulus_interval_pa"])
    assert diagnosis.equivalent_modulus == after["equivalent_modulus_pa"]
    assert diagnosis.equivalent_modulus_interval == tuple(after["equivalent_modulus_interval_pa"])
    assert diagnosis.stored is None


@pytest.mark.parametrize(
    ("residual", "source", "advice"),
    [(0.05, "fitted", "use the one before"), (0.3, None, "use none")],
)
def test_an_unusable_diagnosis_names_the_usable_result(
    diagnosis: pfwd.Diagnosis, residual: float, source: str | None, advice: str
) -> None:
    record = json.loads(json.dumps(diagnosis.to_stored()))
    record["before"]["contact_residual_rms_over_peak"] = residual
    modulus = record["after"]["modulus_pa"]
    for name in ("modulus", "equivalent_modulus"):
        record["after"][f"{name}_interval_pa"] = [modulus / 2, 2 * modulus]
    result = read(DiagnosisResult, record)
    unusable = replace(result, point_modulus=modulus_in_force(result))
    assert unusable.use == "do-not-use"
    assert "after: do not use (the interval of the modulus reaches" in repr(unusable)
    assert f", {advice}; " in repr(unusable)
    assert unusable.to_dataframe()["in_force"].tolist() == [source is not None, False]
    assert (unusable.in_force, unusable.modulus_source) == (False, source)
    expected = record["before"]["modulus_pa"] if source else None
    assert unusable.modulus == expected
    assert (unusable.modulus_interval is None) == (expected is None)


def test_a_diagnosis_of_unsupported_records_has_no_modulus_to_use(
    diagnosis: pfwd.Diagnosis,
) -> None:
    modulus = PointModulus(50e6, (49e6, 51e6), "diagnosed", text_notice("drop 2: a copy"))
    unusable = replace(diagnosis, point_modulus=modulus)
    assert (unusable.modulus, unusable.in_force, unusable.use) == (None, False, "do-not-use")
    assert "after: do not use (drop 2: a copy), use none; " in repr(unusable)


def test_a_drop_without_effect_is_clean() -> None:
    results = pfwd.diagnose(pfwd.example("half-space").drops[0])
    assert (results.verdict, results.effects) == ("clean", ())


def _arrays(name: Any) -> tuple[Any, Any, Any]:
    drop = pfwd.example(name).drops[0]
    return drop.time, drop.load, drop.values


def test_every_option_of_the_analysis_is_offered() -> None:
    # `header` is an argument of its own, and `pfwd.diagnose` diagnoses.
    names = {field.name for field in fields(AnalysisOptions)} - {"header", "diagnose"}
    assert set(INVERT_OPTIONS) == names
    assert set(DIAGNOSE_OPTIONS) < names
    for name in INVERT_OPTIONS:
        assert f"{name} :" in str(pfwd.invert.__doc__) or f"{name}," in str(pfwd.invert.__doc__)


def test_a_diagnosis_predicts_a_drop_that_follows(diagnosis: pfwd.Diagnosis) -> None:
    drop = pfwd.example("unexplained").drops[-1]
    predicted = diagnosis.predict(drop.time, 1.5 * drop.load)
    assert predicted.shape == (len(drop.offsets), drop.time.size)
    # The lag of its sensor is in it.
    assert predicted[0].max() == pytest.approx(1.5 * known(drop.peak_displacement), rel=0.02)
    with pytest.raises(pfwd.SurveyError, match="load: expected"):
        diagnosis.predict(drop.time, drop.load[:-1])
    with pytest.raises(pfwd.InversionError, match="load: expected a positive pulse"):
        diagnosis.predict(drop.time, np.zeros(drop.time.size))


HOSTILE = "\x1b[31m<b>$x_1$"


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    imported = import_files([str(DATA_FOLDER / "layer.csv")], tmp_path / "site")
    assert [item.error for item in imported] == [None] * 3
    return tmp_path / "site"


def test_numbers_of_numpy_become_plain_numbers(layer_results: pfwd.Results) -> None:
    ends: Any = {"modulus_interval_pa": (np.float64(5e7), np.float64(7e7))}
    plain = replace(layer_results[0], modulus_pa=np.float64(6e7), modulus_sd_pa=math.nan, **ends)
    assert type(plain["modulus_pa"]) is float
    assert plain["modulus_sd_pa"] is None
    assert plain.to_dict()["modulus_interval_pa"] == [5e7, 7e7]
    assert all(type(end) is float for end in plain["modulus_interval_pa"])
    json.dumps(plain.to_dict(), allow_nan=False)


def test_a_stored_modulus_without_its_model_is_damaged(
    survey: Path, layer_results: pfwd.Results
) -> None:
    result = layer_results[0]
    stored = result.to_json()
    damaged, stale_result = {**stored, "model": None}, {**stored, "plate_radius_m": 0.1}
    save_results(survey, {1: damaged, 2: stored, 3: stale_result})
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
    save_results(survey, {result.number: result.to_json() for result in layer_results})
    edit_survey(survey, [Edit("discard")], drop=2)
    opened = pfwd.open(survey)
    assert [result.number for result in opened.results] == [1, 3]
    assert [drop.number for drop in opened.drops] == [1, 3]
    assert opened.to_dataframe()["discarded"].tolist() == [False, True, False]
    assert len(opened.to_dict()["drops"]) == 3


def test_text_of_a_file_is_printed_harmlessly(tmp_path: Path) -> None:
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


# Names, reading, surveys, tables, plots, and what the import costs


mpl.use("Agg")

TOP = Path(__file__).resolve().parents[2]


def axes() -> Any:
    return Figure().subplots()


@pytest.fixture(scope="module")
def objects(layer_results: pfwd.Results, diagnosis: pfwd.Diagnosis) -> list[Any]:
    points, survey = pfwd.example("layer"), pfwd.example("survey")
    of_survey = [survey, survey.results, survey.results.measured[0]]
    results = [layer_results, layer_results[0]]
    return [points, points[0], points.drops[0], *of_survey, *results, diagnosis]


def test_completion_lists_the_public_names_only() -> None:
    assert dir(pfwd) == sorted(pfwd.__all__)
    for name in pfwd.__all__:
        assert getattr(pfwd, name).__doc__


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'pfwd' has no attribute 'opne'"):
        pfwd.opne  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize(
    ("use", "heavy"),
    [
        ("", {"numpy", "scipy", "h5py", "matplotlib", "pandas", "textual", "rich"}),
        (
            "repr(pfwd.invert(pfwd.example('half-space'), method='posterior'))",
            {"matplotlib", "pandas", "textual", "simulators", "tui"},
        ),
    ],
)
def test_the_import_loads_no_large_packages(use: str, heavy: set[str]) -> None:
    code = f"import sys, pfwd\n{use}\nprint(*({heavy} & set(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", code], cwd=TOP, capture_output=True, text=True)
    assert (run.returncode, run.stdout.split()) == (0, [])


def test_every_object_has_text_table_values_and_picture(objects: list[Any]) -> None:
    for item in objects:
        line, values, frame, ax = repr(item), item.to_dict(), item.to_dataframe(), axes()
        assert "\n" not in line
        assert getattr(pfwd, line.partition("(")[0]) is type(item)
        assert item._repr_html_().startswith("<table><caption>")
        assert json.loads(json.dumps(values, allow_nan=False)) == values
        assert len(frame) >= 1
        assert "np." not in line + str(item) + repr(frame.head(1).to_dict("records"))
        assert item.plot(ax) is ax
        assert ax.has_data()
        assert ax.get_ylabel()
        ax.figure.savefig(io.BytesIO())
    assert "radius 0.15 m" in ax.get_title(), "of the diagnosis"


def test_a_table_of_results_has_the_basis_of_each_modulus(layer_results: pfwd.Results) -> None:
    for frame in (
        layer_results.to_dataframe(),
        pfwd.example("survey").to_dataframe(),
        pfwd.example("survey").results.to_dataframe(),
    ):
        expected = {"modulus_pa", "modulus_interval_low_pa", "modulus_interval_high_pa", "model"}
        expected |= {"modulus_sd_pa", "plate", "plate_radius_m", "poisson_ratio", "warnings"}
        assert expected <= set(frame.columns)


def test_a_plot_makes_a_new_figure_with_the_basis_of_moduli_as_title() -> None:
    first, second = (pfwd.example("survey").results.plot() for _ in range(2))
    assert first is not second
    pyplot.close("all")
    title = first.get_title()
    assert "half-space, rigid-rough plate of radius 0.15 m, Poisson's ratio 0.35" in title


@pytest.mark.parametrize(
    ("package", "method"),
    [("pandas", "to_dataframe"), ("xarray", "to_xarray")],
)
def test_a_missing_package_is_named(
    monkeypatch: pytest.MonkeyPatch, package: str, method: str
) -> None:
    drop = pfwd.example("layer").drops[0]
    monkeypatch.setitem(sys.modules, package, None)
    message = rf"{method}\(\): expected the package {package}, got none; "
    message += r'python -m pip install "pfwd\[dataframe\]"'
    with pytest.raises(pfwd.OptionError, match=message):
        getattr(drop, method)()


def test_a_drop_becomes_a_dataset_of_xarray() -> None:
    drop = pfwd.example("three-sensors").drops[0]
    data = drop.to_xarray()
    assert dict(data.sizes) == {"time": drop.time.size, "sensor": 3}
    for name, values in (("load", drop.load), ("velocity", drop.values)):
        np.testing.assert_array_equal(data[name], values)
    np.testing.assert_array_equal(data["displacement"], drop.displacement)
    assert data["offset"].values.tolist() == list(drop.offsets)
    units = {str(name): values.attrs["units"] for name, values in data.variables.items()}
    lengths = dict.fromkeys(("displacement", "offset"), "m")
    assert units == {"load": "N", "velocity": "m/s", "time": "s", **lengths}
    assert data.attrs["plate_radius_m"] == 0.15
    recorded = pfwd.drop(drop.time, drop.load, drop.displacement[0], plate_radius=0.15)
    data = recorded.to_xarray()
    np.testing.assert_allclose(data["displacement"], recorded.values, atol=1e-7)
    assert data["velocity"].isnull().all()


def test_a_survey_draws_the_judged_values_in_the_unit_of_the_axis() -> None:
    survey = pfwd.open(DATA_FOLDER / "survey.pfwdz")
    ax = survey.plot(axes())
    assert ax.get_ylabel() == "equivalent modulus with its 95 % interval, MPa"
    (bars,) = ax.containers
    drawn = bars.lines[0].get_ydata()
    assert drawn == pytest.approx([drop.modulus / 1e6 for drop in survey.results.measured])
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["no verdict"]
    assert [tick.get_text() for tick in ax.get_xticklabels()] == [p.name for p in survey.points]


def survey_with_job(folder: Path, procedure: Procedure, target: float) -> pfwd.Survey:
    (outcome, *_) = import_files([str(DATA_FOLDER / "survey.pfwdz")], folder)
    assert outcome.error is None
    with SurveyWriter.open(folder) as writer:
        for kind, values in JobRequest(procedure=procedure, target=target).events():
            writer.note_event(kind, values)
    return pfwd.open(folder)


def test_a_survey_draws_targets_and_verdicts_or_peaks(tmp_path: Path) -> None:
    ax = survey_with_job(tmp_path / "a", plain_procedure(1, 1), 50e6).plot(axes())
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert sorted(texts) == ["fail", "pass", "target"]
    assert [lines.get_segments()[0][0][1] for lines in ax.collections[-1:]] == [50.0]
    procedure = find_procedure("mndot", enforce_unverified=True)  # it needs six drops
    survey = survey_with_job(tmp_path / "b", procedure, 0.6e-3)
    ax = survey.plot(axes())
    assert ax.get_ylabel() == "peak displacement in the centre, mm"
    peaks = [1e3 * float(drop.peak_displacement or 0) for drop in survey.drops]
    assert ax.lines[0].get_ydata() == pytest.approx(peaks)


def test_a_survey_has_its_points_drops_and_results() -> None:
    survey = pfwd.open(DATA_FOLDER / "survey.pfwdz")
    assert survey.points["km 0+025"].drops == survey.points[1].drops == tuple(survey.points[1])
    for named, name in ((survey.points, "km 1"), (pfwd.Results(survey.results[:2]), "km 0+000")):
        with pytest.raises(KeyError, match=r"expected a name that occurs once of km 0\+000, "):
            named[name]
    assert len(survey.drops) == 8
    assert all(item.in_force for item in survey.results)
    assert [item.status for item in survey.results][:2] == ["seating", "measured"]
    # pfwd/scripting/data/README.md: what was simulated.
    truths = [62e6, 48e6, 31e6, 55e6]
    assert [item.modulus for item in survey.results.measured] == pytest.approx(truths, rel=0.01)
    assert list(survey.to_dataframe().columns) == [column.name for column in DROP_COLUMNS]
    points = survey.points_dataframe()
    assert list(points.columns) == [column.name for column in POINT_COLUMNS]
    assert points["point"].tolist() == [point.name for point in survey.points]
    in_force = [drop.modulus for drop in survey.results.measured]
    assert points["modulus_pa"].tolist() == pytest.approx(in_force)


def test_a_stored_drop_draws_the_fit_in_force(tmp_path: Path, diagnosis: pfwd.Diagnosis) -> None:
    folder = tmp_path / "site"
    (imported,) = import_files([str(DATA_FOLDER / "unexplained.csv")], folder)
    assert imported.error is None
    save_results(folder, {1: pfwd.invert(folder)[0].to_json()})
    (stored,) = pfwd.open(folder).results
    assert (stored.history, stored.in_force) == (None, True)
    measured, fitted = stored.plot(axes()).lines
    assert fitted.get_ydata() == pytest.approx(measured.get_ydata(), abs=2.0)  # µm
    assert store_diagnoses(str(folder), [(1, diagnosis)]) is None
    (stored,) = pfwd.open(folder).results
    ax = stored.plot(axes())
    names = ["measured, 0 m", "before, 0 m", "fitted, 0 m"]
    assert [line.get_label() for line in ax.lines] == names
    assert "the modulus of the diagnosis" in ax.get_title()
    assert ax.lines[1].get_color() == BEFORE_COLOUR
    curves = diagnosis.curves[0]
    for line, values in zip(ax.lines[1:], (curves.before[0], curves.after[0]), strict=True):
        drawn = np.interp(1e3 * curves.time, line.get_xdata(), line.get_ydata())
        assert drawn == pytest.approx(1e6 * values, abs=0.5)
    with pytest.raises(pfwd.SurveyError, match="a result with traces to draw, got one without"):
        replace(stored, read_history=None).plot()


def test_reading_accepts_a_header_and_declarations(tmp_path: Path) -> None:
    header = tmp_path / "plate.toml"
    header.write_text("plate_radius_m = 0.1\n")
    for header_values in (header, {"plate_radius_m": 0.1}):
        points = pfwd.read(DATA_FOLDER / "layer.csv", header=header_values)
        assert points[0].declared["plate_radius_m"] == 0.1
    points = pfwd.read(DATA_FOLDER / "layer.csv", header=header, plate_radius=0.2)
    assert points.drops[0].declared["plate_radius_m"] == 0.2


def test_a_drop_has_its_measured_traces() -> None:
    drop = pfwd.example("three-sensors").drops[0]
    assert drop.time.shape == drop.load.shape == drop.displacement[0].shape
    assert drop.values.shape == drop.displacement.shape == (3, drop.time.size)
    assert drop.offsets == (0.0, 0.3, 0.6)
    assert drop.quantities == ("velocity",) * 3
    assert drop.peak_load == pytest.approx(7000.0, rel=0.03)
    # A rigid plate, static: (1 - 0.35^2) F / (2 a E) = 0.256 mm at 80 MPa, less over rock.
    assert drop.peak_displacement == pytest.approx(0.25e-3, rel=0.05)
    frame = drop.to_dataframe()
    sensors = [f"velocity_m_s@{offset}" for offset in drop.offsets]
    assert list(frame.columns) == ["drop", "time_s", "load_N", *sensors]
    np.testing.assert_array_equal(frame["load_N"], drop.load)


def test_the_examples_are_small_and_do_not_contain_their_truth() -> None:
    files = {path.stem for path in DATA_FOLDER.iterdir()} - {"README"}
    assert files == {*get_args(Traces), "survey"}
    assert sum(path.stat().st_size for path in DATA_FOLDER.iterdir()) < 300_000
    for name in get_args(Traces):
        lines = (DATA_FOLDER / f"{name}.csv").read_text(encoding="utf-8").splitlines()
        keys = {line.split("=")[0].strip("# ") for line in lines if line.startswith("#")}
        assert not {"modulus", "viscosity"} & keys


@pytest.mark.slow
@pytest.mark.parametrize("name", ["half-space", "unexplained"])
def test_the_examples_are_made_by_their_command(name: Any, tmp_path: Path) -> None:
    TRACES[name](tmp_path / "made.csv")
    simulated, shipped = pfwd.read(tmp_path / "made.csv").drops[0], pfwd.example(name).drops[0]
    assert simulated.declared == shipped.declared
    # A count of the converter more or less, on another platform.
    for values, expected in (
        (simulated.load, shipped.load),
        (simulated.values, shipped.values),
    ):
        np.testing.assert_allclose(values, expected, atol=2e-4 * np.max(np.abs(expected)))


def test_a_table_is_bounded_and_escaped() -> None:
    text = html_table("<b>", itertools.repeat({"point": "<script>"}))
    assert text.count("&lt;script&gt;") == MAX_NOTEBOOK_ROWS
    assert "<script>" not in text
    assert "first 20 rows" in text


def test_a_program_without_pip_names_no_pip(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    with pytest.raises(pfwd.OptionError, match=r"pfwd\[dataframe\]") as caught:
        pfwd.example("layer").drops[0].to_dataframe()
    assert "pip" not in str(caught.value)
