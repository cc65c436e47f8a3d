"""Reports: their content, that nothing in them runs or is fetched, that they can be read."""

import base64
import dataclasses
import gc
import hashlib
import html.parser
import json
import pickle
import re
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pypdf
import pytest
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from inversion import SurrogateLibrary
from inversion.notices import Notice, codes, text_of
from pfwd.analysis.analyse import analyse_drop
from pfwd.analysis.diagnosis import diagnose as diagnosis
from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.fits import curves_of
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.result_store import basis_of
from pfwd.analysis.results import DiagnosisResult, DropResult
from pfwd.analysis.screening.drops import screen
from pfwd.errors import OptionError
from pfwd.files.editing import Edit, edit_survey
from pfwd.judging import DropView
from pfwd.procedures import StressLaw, Verdict
from pfwd.report import fonts
from pfwd.report.blocks import Listing, Pairs, Table
from pfwd.report.content import Report
from pfwd.report.diagnosis_blocks import (
    diagnosis_blocks,
    draw_ladder,
    ladder_height,
    ladder_of,
)
from pfwd.report.drawing import draw_point, place
from pfwd.report.gathering import ReportOptions, gather
from pfwd.report.point_blocks import _stress
from pfwd.report.provenance_blocks import device_blocks
from pfwd.report.report import GC_THRESHOLD, _rare_garbage_collection, write_report
from pfwd.report.texts import load_texts
from pfwd_device.recording import DropRecord, SurveyWriter
from tests.pfwd.report import surveys
from tests.pfwd.report.surveys import (
    DECLARED,
    EN,
    LAYERS,
    LOWER,
    SETUP,
    UPPER,
    RecordedInversion,
    half_sine_drop,
    result_of,
    save_results,
    with_loose_sensor,
)
from tests.records import complete, known, read


class Page(html.parser.HTMLParser):
    """Tags, attributes and texts of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def page_of(survey: Path, **options: Any) -> tuple[str, Page, Report]:
    target = survey.parent / "report.html"
    report = write_report(survey, target, ReportOptions(**options))
    text = target.read_text(encoding="utf-8")
    return text, Page(text), report


def is_stored(drop: DropView) -> bool:
    return drop.result is not None and bool(drop.result.stored)


def test_a_point_goes_to_another_process_without_the_survey(survey: Path) -> None:
    point = gather(survey).points[0]
    assert point.source is not None
    copy = pickle.loads(pickle.dumps(point))
    for part in (copy, copy.whole):
        assert [owner.source for owner in (part, *part.drops)] == [None] * (1 + len(part.drops))
    assert copy.progress == point.progress
    assert [drop.result for drop in copy.drops] == [drop.result for drop in point.drops]
    assert copy.place == point.place


def test_the_last_stored_result_is_used(survey: Path) -> None:
    save_results(survey, {1: result_of(1, 99e6) | {"refit": "elastic"}}, "trial")
    messages: list[str] = []
    report = gather(survey, ReportOptions(), messages.append)
    assert [point.shown_name for point in report.points] == ["A", "B"]
    drops = report.points[0].drops
    assert all(is_stored(drop) for drop in drops)
    moduli = [known(drop.result).modulus_pa for drop in drops]
    assert moduli == [45.1e6, 45.2e6, 45.3e6, 45.4e6]
    assert not any("inverted" in text for text in messages)
    # One seating drop was declared, no procedure chosen: the other three are averaged.
    assert report.points[0].progress.used == (2, 3, 4)
    value = known(report.points[0].progress.value)
    assert value.value == pytest.approx((45.2e6 * 45.3e6 * 45.4e6) ** (1 / 3))


LAYERED = {"layers": 2, "thickness": (0.2,), "bedrock_depth": "none", "elastic": True}


@pytest.mark.parametrize(
    "options",
    [
        {"bedrock_depth": 1.2},
        {"plate": "rigid-smooth", "load": "half-sine"},
        LAYERED,
        pytest.param({"plate": "uniform", "layers": 2}, marks=pytest.mark.slow),
    ],
)
def test_a_stored_result_gives_the_curves_of_its_inversion(options: dict[str, Any]) -> None:
    drop, library = half_sine_drop(2, 8000.0), SurrogateLibrary()
    screening = screen(drop, SETUP)
    analysis = analyse_drop(
        drop, SETUP, screening, AnalysisOptions(method="posterior", **options), library
    )
    history = known(analysis.result).history
    # As it comes back from the disk.
    result = read(DropResult, json.loads(json.dumps(drop_result("x", analysis).to_json())))
    curves = known(curves_of(drop, SETUP, screening, result, library))
    np.testing.assert_allclose(curves.observed, history.observed, rtol=1e-12)
    np.testing.assert_allclose(curves.time, history.time, rtol=1e-12)
    # The half-sine of a report has the measured area, that of this fit is by least squares.
    close = 2e-2 if options.get("load") == "half-sine" else 1e-9
    scale = np.abs(history.predicted).max()
    np.testing.assert_allclose(curves.predicted, history.predicted, atol=close * scale)


def test_sensors_are_named_by_side_and_excluded_ones_are_marked(
    survey: Path, make_drop: Any
) -> None:
    places = (0.0, 0.3, -0.3, 0.6, -0.6)
    with SurveyWriter.open(survey, publish=False) as writer:
        for number in (1, 2):
            drop = make_drop(number=number, offsets=places)
            record = DropRecord("sides", drop, None, DECLARED, {})
            if number == 1:
                record = dataclasses.replace(record, drop=with_loose_sensor(drop, -0.6))
            writer.save_result(writer.save_drop(record), complete(DropResult, result_of(number)))
    report = gather(survey, ReportOptions())
    (point,) = [item for item in report.points if item.shown_name == "sides"]
    for item in point.drops:
        assert item.left_out == (-0.6,)
        assert known(item.curves).offsets.tolist() == [0.0, 0.3, -0.3, 0.6]
        assert any("bad sensor: displacement at -0.6 m" in text_of(text) for text in item.warnings)
    figure = Figure()
    draw_point(figure, point, point.drops, load_texts("de"))
    names = [text.get_text() for text in figure.axes[1].get_legend().get_texts()]
    assert [name for name in names if "0,3 m" in name] == ["0,3 m", "-0,3 m"]
    assert names[-1] == load_texts("de").say("left_out", offset="-0,6")
    without_traces = Figure()
    draw_point(without_traces, point, [], EN)
    assert len(without_traces.axes) == len(figure.axes) - 3


@pytest.mark.parametrize(
    "wrong", [{"modulus_pa": -1.0}, {"poisson_ratio": 0.5}, {"thickness_m": 0.0}]
)
def test_layers_that_no_ground_has_give_no_curves(wrong: dict[str, float]) -> None:
    drop = half_sine_drop(2, 8000.0)
    result = read(DropResult, {**result_of(2), **LAYERS, "layers": [{**UPPER, **wrong}, LOWER]})
    assert curves_of(drop, SETUP, screen(drop, SETUP), result, SurrogateLibrary()) is None


def test_no_modulus_stands_without_interval_and_basis(survey: Path) -> None:
    text, page, _ = page_of(survey, target=40e6)
    plain = " ".join(page.texts).replace("\N{NO-BREAK SPACE}", " ")
    assert re.search(r"45\.\d+ MPa \(44\.\d+ – 46\.\d+\)", plain)
    assert "half-space, rigid plate without slip 0.15 m, ν 0.35" in plain
    assert "a warning of the search" in plain
    cells = [html.unescape(cell) for cell in re.findall(r"<(?:td|dd)[^>]*>(.*?)</(?:td|dd)>", text)]
    moduli = [cell for cell in cells if re.search("[0-9]\N{NO-BREAK SPACE}MPa", cell)]
    assert len(moduli) >= 4, "two points, in the table and on their pages"
    for cell in moduli:
        assert re.search(r"MPa \(\d.*\d\)", cell), cell


def test_a_page_is_self_contained_and_runs_no_code(survey: Path) -> None:
    text, page, _ = page_of(survey)
    assert not [tag for tag, _ in page.tags if tag in ("script", "link", "iframe", "object")]
    for tag, attributes in page.tags:
        for name, value in attributes.items():
            assert not name.startswith("on"), (tag, name)
            if name in ("src", "href"):
                kind, _, data = known(value).partition(",")
                assert kind == "data:image/svg+xml;base64"
                assert ElementTree.fromstring(base64.b64decode(data)).tag.endswith("svg")
    assert "url(" not in text
    assert sum(tag == "img" for tag, _ in page.tags) >= 5


def test_a_sensitivity_has_the_unit_of_its_sensor(survey: Path) -> None:
    units = {
        "load": " V/N",
        "geophone": " V/(m/s)",
        "accelerometer": " V/(m/s²)",
        "displacement": " V/m",
        "unused": "",
    }
    channels = [{"name": role, "role": role, "sensitivity": 0.0004} for role in units]
    instrument = {"channels": channels, "plate_radius": 0.15, "plate_mass": 15.0}
    blocks = device_blocks(dataclasses.replace(gather(survey), instruments=(instrument,)), EN)
    (pairs,) = (block for block in blocks if isinstance(block, Pairs))
    assert any(value.startswith("r = 0.15 m, m = 15 kg") for _, value in pairs.rows)
    (table,) = (block for block in blocks if isinstance(block, Table))
    for row, unit in zip(table.rows, units.values(), strict=True):
        assert f"0.0004{unit}" in row


def test_discarded_drops_and_points_are_marked(survey: Path) -> None:
    edit_survey(survey, [Edit("discard", "plate slipped")], point="A", drop=3)
    edit_survey(survey, [Edit("discard", None)], point="B")
    text, _, report = page_of(survey, target=40e6)
    assert report.points[0].progress.used == (2, 4)
    assert "discarded: plate slipped" in text
    assert report.points[1].discarded
    assert "1 pass, 0 fail, 0 undecided, 0 without a target" in text


def test_positions_make_a_map_and_distances(survey: Path) -> None:
    edit_survey(survey, [Edit("position", {"latitude": 60.0, "longitude": 11.0})], point="A")
    edit_survey(survey, [Edit("position", {"latitude": 60.0003, "longitude": 11.0003})], point="B")
    text, _, report = page_of(survey)
    assert "Sketch of the points" in text
    places = place(report)
    # A minute of latitude is a nautical mile, 1852 m: 0.0003 degrees are 33.3 m.
    assert places[1][1] - places[0][1] == pytest.approx(33.3, abs=0.1)
    # At 60 degrees north a degree of longitude is half as long.
    assert places[1][0] - places[0][0] == pytest.approx(33.3 / 2, abs=0.1)


def test_a_pdf_has_at_most_a_page_for_each_point(survey: Path) -> None:
    target = survey.parent / "report.pdf"
    write_report(survey, target, ReportOptions(language="de"))
    pages = len(pypdf.PdfReader(target).pages)
    assert 3 <= pages <= 4, "certificate, summary, two points and the command"


def test_chinese_needs_a_font_and_says_so(survey: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fonts, "chinese_family", lambda: None)
    with pytest.raises(OptionError, match=r"a font with Chinese letters .* fonts-noto-cjk"):
        write_report(survey, survey.parent / "report.pdf", ReportOptions(language="zh"))
    # A Chinese name in an English report is drawn with question marks, and counted.
    edit_survey(survey, [Edit("name", "测点")], point="A")
    letters = fonts.Letters()
    assert letters.drawable("测点 A") == "?? A"
    assert letters.missing == 2
    write_report(survey, survey.parent / "report.pdf")


def test_chinese_with_a_font(survey: Path) -> None:
    if fonts.chinese_family() is None:
        pytest.skip("no font with Chinese letters on this computer")
    target = survey.parent / "report.pdf"
    write_report(survey, target, ReportOptions(language="zh"))  # a missing letter would warn
    text, _, _ = page_of(survey, language="zh")
    assert load_texts("zh")["summary"] in text


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("report.txt", {}, "a name ending in .html or .pdf"),
        ("report.html", {"language": "fr"}, "one of de, en, zh, or a file .toml, got 'fr'"),
        ("no/such/folder/report.html", {}, "got none; make it first"),
        ("report.html", {"procedure": "mndott"}, "pfwd procedures lists them"),
        ("report.html", {"target": -1.0}, "--target: expected a number > 0"),
    ],
)
def test_wrong_usage_is_rejected(
    survey: Path, name: str, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(OptionError, match=message):
        write_report(survey, survey.parent / name, ReportOptions(**options))
    assert not list(survey.parent.glob(".report*")), "nothing half is left"


def test_the_command_is_complete_and_names_no_folder(
    made: Path, survey: Path, tmp_path: Path
) -> None:
    logo = tmp_path / "logo.png"
    Figure(figsize=(1, 1)).savefig(logo)
    target = survey.parent / "sent.html"
    judged = {"procedure": "astm-e2835", "target": 6e-4, "point": "A", "language": "de"}
    options = ReportOptions(company="Muster & Co", logo=str(logo), **judged)  # type: ignore[arg-type]
    report = write_report(survey, target, options)
    expected = "pfwd report survey -o sent.html --language de --procedure astm-e2835 --company "
    expected += "'Muster & Co' --logo logo.png --point A --target 0.6 --seed 0"
    assert report.command == expected
    assert report.points[0].progress.verdict is Verdict.PASS
    texts = " ".join(Page(target.read_text(encoding="utf-8")).texts)
    assert report.command in texts
    assert report.survey_id in texts
    assert '"plate_radius_m": 0.15' in texts
    for file in sorted(survey.glob("drops/*.h5"))[:4]:  # those of the point
        assert hashlib.sha256(file.read_bytes()).hexdigest() in texts
    assert hashlib.sha256((made.parent / "A.csv").read_bytes()).hexdigest() in texts
    assert str(survey.parent) not in texts


def test_a_report_without_storing_does_not_change_the_survey(
    short_survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace_diagnosis(monkeypatch)
    before = {path: path.read_bytes() for path in short_survey.rglob("*") if path.is_file()}
    quick = AnalysisOptions(method="posterior")
    options = ReportOptions(analysis=quick, refit=True, store=False, diagnose=True, point="A")
    report = write_report(short_survey, short_survey.parent / "report.html", options)
    assert not any(is_stored(drop) for drop in report.points[0].drops)
    assert not known(report.points[0].diagnosis).stored
    after = {path: path.read_bytes() for path in short_survey.rglob("*") if path.is_file()}
    assert before == after


def test_a_stale_result_is_inverted_once(short_survey: Path) -> None:
    edit_survey(short_survey, [Edit("declared", {"poisson_ratio": 0.4})], point="A")
    messages: list[str] = []
    options = ReportOptions(diagnose=False)
    first, second = (gather(short_survey, options, messages.append) for _ in range(2))
    assert sum("is inverted" in text for text in messages) == 2
    changed = first.points[0].drops[1]
    assert known(changed.result).poisson_ratio == 0.4
    assert "declarations-changed" in [warning.code for warning in changed.warnings]
    assert {is_stored(drop) for drop in first.points[0].drops} == {False}
    assert {is_stored(drop) for drop in first.points[1].drops} == {True}
    assert {is_stored(drop) for point in second.points for drop in point.drops} == {True}
    moduli = [[drop.facts.modulus for drop in report.points[0].drops] for report in (first, second)]
    assert moduli[0] == moduli[1]


def test_effects_of_a_diagnosis_have_values_and_alternatives(survey: Path) -> None:
    numbers = [
        {"name": "exponent", "value": 0.43, "sd": 0.13, "unit": "-"},
        {"name": "rest_stress", "value": 2e4, "unit": "Pa"},
    ]
    lag = {"name": "delay", "value": 0.0021, "sd": 0.0001, "unit": "s", "drop": 2}
    natural = {"name": "natural_frequency", "value": 11.0, "sd": 0.2, "unit": "Hz"}
    advice = "drop from other heights"
    effects = [
        {"name": "geophone_response", "parameters": [natural], "alternatives": ["lag"]},
        {"name": "stress_dependence", "parameters": numbers, "advice": advice, "probability": 0.9},
        {"name": "sensor_lag", "parameters": [lag]},
    ]
    (point, _) = gather(survey).points
    result = surveys.diagnosis([2, 3, 4], basis_of(point.setup), left_out=(1,))
    record = result.to_stored() | {"effects": effects}
    diagnosed = dataclasses.replace(point, whole=None, diagnosis=read(DiagnosisResult, record))
    blocks = diagnosis_blocks(diagnosed, EN)
    (listed,) = (block for block in blocks if isinstance(block, Listing))
    assert [item.replace("\N{NO-BREAK SPACE}", " ") for item in listed.items] == [
        "geophone response: 11.00 ± 0.20 Hz (or: lag)",
        f"stress dependence: exponent 0.43 ± 0.13; rest stress left open – {advice}",
        "sensor lag: (Drop 2) 2.10 ± 0.10 ms",
    ]


def replace_diagnosis(monkeypatch: pytest.MonkeyPatch) -> list[list[str | None]]:
    """Replace the diagnosis by a stored one; return the points of each request."""
    requests: list[list[str | None]] = []

    def diagnose(entries: Any, _request: Any) -> Any:
        requests.append([entry.point for entry in entries])
        for entry in entries:
            result = surveys.diagnosis([2, 3, 4], entry.basis, point=entry.point, left_out=(1,))
            yield diagnosis.Diagnosed("x", result, number=8)

    monkeypatch.setattr(diagnosis, "diagnose_entries", diagnose)
    return requests


@pytest.mark.usefixtures("without_curves")
def test_only_the_reported_point_is_diagnosed(
    survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    edit_survey(survey, [Edit("name", "north")], point="B")
    requests = replace_diagnosis(monkeypatch)
    RecordedInversion(monkeypatch)
    report = gather(survey, ReportOptions(diagnose=True, point="B"))
    assert requests == [["north"]]
    assert report.points[0].diagnosis_in_force is not None
    # Its stored diagnosis is used from then on, until the drops are to be fitted again.
    gather(survey, ReportOptions(diagnose=True, point="B"))
    assert requests == [["north"]]
    gather(survey, ReportOptions(diagnose=True, point="north", refit=True, store=False))
    assert requests == [["north"], ["north"]]
    gather(survey, ReportOptions(diagnose=True))
    assert requests[2:] == [["A", "north"]]


@pytest.mark.usefixtures("without_curves")
def test_a_point_whose_fit_leaves_a_residual_is_diagnosed_first(
    survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unexplained = Notice(
        "residual-not-explained", {"residual_over_noise": 4.0, "residual_over_peak": 0.02}
    )
    warned = {"warnings": [text_of(unexplained)], "warning_codes": codes([unexplained])}
    save_results(survey, {n: result_of(n) | warned for n in (5, 6, 7, 8)})  # of point B
    requests = replace_diagnosis(monkeypatch)
    plain = gather(survey, ReportOptions(diagnose=False)).points[1].progress
    assert known(plain.modulus).not_supported_code == "residual-not-explained"
    assert "--no-diagnose" in gather(survey, ReportOptions(diagnose=False)).command
    assert requests == []
    points = gather(survey).points
    assert requests == [["B"]]
    first, second = (point.progress.modulus for point in points)
    assert (known(first).source, known(second).source) == ("fitted", "diagnosed")
    gather(survey)  # from then on it is stored
    assert requests == [["B"]]


def test_garbage_collection_is_restored_after_drawing() -> None:
    before = gc.get_threshold()
    with _rare_garbage_collection():
        assert gc.get_threshold()[0] == max(before[0], GC_THRESHOLD)
    assert gc.get_threshold() == before


def test_a_visible_dependence_on_stress_is_stated() -> None:
    texts = {0.55: "not visible in the drops (90 to 120 kPa)", 0.04: "to the power -0.09"}
    for deviation, text in texts.items():
        stress = StressLaw(-0.09, deviation, (90e3, 120e3))
        point = SimpleNamespace(progress=SimpleNamespace(stress=stress))
        assert text in _stress(point, EN)  # type: ignore[arg-type]


def test_a_ladder_of_residuals_has_plain_numbers() -> None:
    state = {"model": "half-space", "modulus_pa": 50e6}
    effects = [
        {"name": "bedrock", "value": 1.8, "unit": "m", "residual_rms_over_peak_without": 0.058},
        {"name": "stress_dependence", "value": 0.5, "residual_rms_over_peak_without": 0.16},
    ]
    ends = {"before": 1.8, "after": 0.019}
    record = {key: {**state, "residual_rms_over_peak": value} for key, value in ends.items()}
    diagnosis = read(DiagnosisResult, {**record, "verdict": "explained", "effects": effects})
    height = ladder_height(ladder_of(diagnosis, load_texts("de")))
    figure = Figure(figsize=(180 / 25.4, height / 25.4))
    draw_ladder(figure, diagnosis, load_texts("de"))
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.texts] == ["180 %", "16 %", "5,8 %", "1,9 %"]
    labels = [label.get_text() for label in axes.get_xticklabels()]
    assert {"2", "10", "50", "100"} <= set(labels)


@pytest.mark.parametrize("language", ["en", "de", "zh"])
def test_labels_of_traces_do_not_overlap(survey: Path, language: str) -> None:
    if language == "zh" and fonts.chinese_family() is None:
        pytest.skip("no font with Chinese letters on this computer")
    point = gather(survey).points[0]
    with rc_context({"font.family": fonts.families()}):
        figure = Figure(figsize=(180 / 25.4, 50 / 25.4))
        canvas = FigureCanvasAgg(figure)
        draw_point(figure, point, point.drops[1:], load_texts(language))
        canvas.draw()
    renderer = canvas.get_renderer()
    labels = [axes.yaxis.label for axes in figure.axes[:3]]
    assert all(label.get_text() for label in labels)
    boxes = sorted((label.get_window_extent(renderer) for label in labels), key=lambda b: b.y0)
    assert all(lower.y1 < upper.y0 for lower, upper in pairwise(boxes))
    assert all(box.x0 >= 0 for box in boxes)
    for axes, box in zip(sorted(figure.axes[:3], key=lambda a: a.bbox.y0), boxes, strict=True):
        numbers = [label.get_window_extent(renderer) for label in axes.get_yticklabels()]
        assert not any(box.overlaps(number) for number in numbers)
