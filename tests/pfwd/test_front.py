"""`import pfwd`: names, reading, surveys, tables, plots, and what the import costs."""

import io
import itertools
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import matplotlib as mpl
import numpy as np
import pytest

import pfwd
from pfwd.analysis.result_store import store_diagnoses
from pfwd.analysis.results import DropResult
from pfwd.display import BEFORE_COLOUR, MAX_NOTEBOOK_ROWS, html_table
from pfwd.export.columns import DROP_COLUMNS, POINT_COLUMNS
from pfwd.files.importing import import_files
from pfwd.judging import JobRequest
from pfwd.procedures import Procedure, find_procedure, plain_procedure
from pfwd.scripting.surveys import DATA_FOLDER, Traces
from pfwd_device.recording import SurveyWriter
from tests.records import complete

mpl.use("Agg")
from matplotlib.figure import Figure

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


def test_without_axes_a_new_figure_is_made() -> None:
    from matplotlib import pyplot

    first, second = (pfwd.example("layer").drops[0].plot() for _ in range(2))
    assert first is not second
    pyplot.close("all")


def test_a_plot_of_moduli_has_their_basis_as_title() -> None:
    results = pfwd.example("survey").results
    title = results.plot(axes()).get_title()
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
    np.testing.assert_array_equal(data["load"], drop.load)
    np.testing.assert_array_equal(data["displacement"], drop.displacement)
    np.testing.assert_array_equal(data["velocity"], drop.values)
    assert data["offset"].values.tolist() == list(drop.offsets)
    units = {str(name): values.attrs["units"] for name, values in data.variables.items()}
    assert units == {
        "load": "N",
        "displacement": "m",
        "velocity": "m/s",
        "time": "s",
        "offset": "m",
    }
    assert data.attrs["plate_radius_m"] == 0.15
    largest = data.isel(sensor=0).displacement.sel(time=slice(0, 0.04)).max()
    assert float(largest) == pytest.approx(drop.peak_displacement, rel=0.01)


def test_a_displacement_has_no_velocity_in_the_dataset() -> None:
    drop = pfwd.example("half-space").drops[0]
    recorded = pfwd.drop(drop.time, drop.load, drop.displacement, plate_radius=0.15)
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


def test_a_survey_draws_targets_and_verdicts(tmp_path: Path) -> None:
    ax = survey_with_job(tmp_path, plain_procedure(1, 1), 50e6).plot(axes())
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert sorted(texts) == ["fail", "pass", "target"]
    assert [lines.get_segments()[0][0][1] for lines in ax.collections[-1:]] == [50.0]


def test_a_survey_without_values_draws_peaks(tmp_path: Path) -> None:
    procedure = find_procedure("mndot", enforce_unverified=True)  # it needs six drops
    survey = survey_with_job(tmp_path, procedure, 0.6e-3)
    ax = survey.plot(axes())
    assert ax.get_ylabel() == "peak displacement in the centre, mm"
    (line,) = ax.lines
    peaks = [1e3 * float(drop.peak_displacement or 0) for drop in survey.drops]
    assert line.get_ydata() == pytest.approx(peaks)


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
    with SurveyWriter.open(folder) as writer:
        writer.save_result(1, complete(DropResult, pfwd.invert(folder)[0].to_json()))
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
    for line, values in zip(
        ax.lines[1:], (diagnosis.curves[0].before[0], diagnosis.curves[0].after[0]), strict=True
    ):
        drawn = np.interp(1e3 * diagnosis.curves[0].time, line.get_xdata(), line.get_ydata())
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
    assert list(frame.columns) == [
        "drop",
        "time_s",
        "load_N",
        "velocity_m_s@0.0",
        "velocity_m_s@0.3",
        "velocity_m_s@0.6",
    ]
    np.testing.assert_array_equal(frame["load_N"], drop.load)


def test_the_examples_are_small_and_do_not_contain_their_truth() -> None:
    files = {path.stem for path in DATA_FOLDER.iterdir()} - {"README"}
    assert files == {*get_args(Traces), "survey"}
    assert sum(path.stat().st_size for path in DATA_FOLDER.iterdir()) < 300_000
    for name in get_args(Traces):
        header = [
            line.split("=")[0].strip("# ")
            for line in (DATA_FOLDER / f"{name}.csv").read_text(encoding="utf-8").splitlines()
            if line.startswith("#")
        ]
        assert not {"modulus", "viscosity"} & set(header)


def test_the_examples_are_made_by_their_command(tmp_path: Path) -> None:
    from benchmarks.example_files import TRACES

    for name in ("half-space", "unexplained"):
        TRACES[name](tmp_path / f"{name}.csv")
        simulated = pfwd.read(tmp_path / f"{name}.csv").drops[0]
        shipped = pfwd.read(DATA_FOLDER / f"{name}.csv").drops[0]
        assert simulated.declared == shipped.declared
        # A count of the converter more or less, on another platform.
        np.testing.assert_allclose(simulated.load, shipped.load, atol=2e-4 * np.max(shipped.load))
        np.testing.assert_allclose(
            simulated.values, shipped.values, atol=2e-4 * np.max(np.abs(shipped.values))
        )


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
