"""The result of a point in a report: every number from the stored result whose modulus counts."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from inversion.notices import text_of
from pfwd.analysis.result_store import basis_of
from pfwd.analysis.results import DiagnosisResult
from pfwd.judging import PointView
from pfwd.report.blocks import Listing, Table
from pfwd.report.content import Report
from pfwd.report.gathering import gather
from pfwd.report.point_blocks import point_blocks
from pfwd.report.point_facts import all_warnings
from pfwd.report.point_result import result_rows
from pfwd.report.summary_blocks import common_warnings, warning_blocks
from pfwd_device.recording import read_survey
from tests.pfwd.report.surveys import EN, flat, result_of, save_results, texts_of
from tests.records import known, read

pytestmark = pytest.mark.usefixtures("without_curves")


FIT: dict[str, Any] = {
    "model": "layer",
    "bedrock_depth_m": 7.77,
    "bedrock_depth_sd_m": 0.1,
    "bedrock_depth_interval_m": [6.66, 8.88],
    "viscosity_pa_s": 33e3,
    "warnings": ["the fit leaves a residual: do not use it"],
}

AFTER: dict[str, Any] = {
    "model": "layer",
    "modulus_pa": 51.2e6,
    "modulus_interval_pa": [48.6e6, 53.9e6],
    "equivalent_modulus_pa": 52.3e6,
    "equivalent_modulus_interval_pa": [50.1e6, 54.6e6],
    "viscosity_pa_s": 12.3e3,
    "density_kg_m3": 1911.0,
    "bedrock_depth_m": 0.887,
    "stress_pa": 219e3,
    "modulus_100kpa_pa": 40e6,
    "residual_rms_over_peak": 0.003,
    "discrepancy_over_peak": 0.003,
}


def survey_with_fits(survey: Path) -> Path:
    save_results(survey, {d.number: result_of(d.drop) | FIT for d in read_survey(survey).drops})
    return survey


def diagnosed_report(survey: Path, verdict: str, **after: Any) -> Report:
    """A report with a diagnosis of the first point."""
    report = gather(survey_with_fits(survey))
    first = report.points[0]
    record = {
        "point": first.shown_name,
        "drops": [2, 3, 4],
        "left_out": [1],
        "basis": basis_of(first.setup),
        "verdict": verdict,
        "poisson_ratio": 0.35,
        "plate_radius_m": 0.15,
        "before": {"model": "half-space", "modulus_pa": 43e6, "modulus_interval_pa": [27e6, 68e6]},
        "after": {**AFTER, **after},
        "effects": [],
        "warnings": ["modulus open after the diagnosis"],
    }
    diagnosed = replace(first, whole=None, diagnosis=read(DiagnosisResult, record))
    return replace(report, points=(diagnosed.as_diagnosed, *report.points[1:]))


def rows_of(point: PointView) -> dict[str, str]:
    rows = result_rows(point, EN)
    return {label: value.replace("\N{NO-BREAK SPACE}", " ") for label, value in rows if value}


def report_text(report: Report) -> str:
    """Everything that the part on the first point says outside its table of fits."""
    blocks = flat(point_blocks(report.points[0], report, EN, common_warnings(report)))
    others = [b for b in blocks if not isinstance(b, Table) or b.columns[0] == "Drop"]
    return "\n".join(texts_of(others, pictures=False))


def test_a_diagnosed_point_has_the_numbers_of_its_diagnosis(survey: Path) -> None:
    report = diagnosed_report(survey, "explained")
    rows = rows_of(report.points[0])
    assert rows["Modulus E"].replace("\xa0", " ") == "51.2 MPa (48.6 – 53.9)"
    assert rows["Basis"] == (
        "Drops 2 – 4, diagnosis: layer on rock at 0.887 m, rigid plate without slip 0.15 m, "
        "ν 0.35, η 12.3 kPa s, ρ 1911 kg/m³"
    )
    assert rows["Use"] == (
        "design value: the record is explained and the interval is narrow; secant modulus at "
        "219 kPa under the plate, 40.0 MPa at 100 kPa"
    )
    text = report_text(report)
    assert not any(number in text for number in ("7.77", "6.66", "8.88", "33", "Modulus E, MPa"))


def test_a_diagnosed_depth_has_the_deviation_of_its_effect(survey: Path) -> None:
    report = diagnosed_report(survey, "explained")
    point = report.points[0]
    record = known(point.diagnosis).to_stored()
    record["effects"] = [{"name": "bedrock", "value": 0.887, "sd": 0.031, "unit": "m"}]
    with_effect = replace(point, whole=None, diagnosis=read(DiagnosisResult, record))
    assert "layer on rock at 0.89 ± 0.03 m," in rows_of(with_effect)["Basis"]


def test_warnings_do_not_contradict_a_modulus_to_use_with_care(survey: Path) -> None:
    report = diagnosed_report(survey, "unexplained", discrepancy_over_peak=0.014, stress_pa=None)
    point = report.points[0]
    rows = rows_of(point)
    assert rows["Use"].startswith("use with care: 1.4 % of the peak is unexplained")
    assert "do not use it" not in " ".join(map(text_of, all_warnings(point)))
    text = report_text(report)
    assert "do not use" not in text
    # The other point has no diagnosis: there the warning of the fits is one of the report.
    (_, warnings) = warning_blocks(report, EN)
    assert isinstance(warnings, Listing)
    (line,) = [item for item in warnings.items if "do not use it" in item]
    assert line.endswith("(point B)")


def test_an_unusable_diagnosis_leaves_the_numbers_of_the_fits(survey: Path) -> None:
    report = diagnosed_report(survey, "unexplained", discrepancy_over_peak=0.2)
    rows = rows_of(report.points[0])
    assert rows["Modulus E"].startswith("45")
    assert (
        rows["Basis"]
        == "Drops 2 – 4, mean of the fits: layer, rigid plate without slip 0.15 m, ν 0.35"
    )
    assert rows["Use"] == (
        "the fits count, because the diagnosed modulus must not be used: "
        "20 % of the peak is unexplained (allowance included), at most 3 % is permitted"
    )
    text = report_text(report)
    assert "design value" not in text
    assert "use with care" not in text
    assert "for comparison only" not in text


def test_a_single_fit_has_its_depth_and_viscosity(survey: Path) -> None:
    point = gather(survey_with_fits(survey)).points[0]
    progress = replace(point.progress, used=(3,))
    single = replace(point, whole=None)
    single.__dict__["progress"] = progress
    basis = rows_of(single)["Basis"]
    assert basis.startswith(
        "Drop 3, fit: layer on rock at 7.8 m (6.7 – 8.9), rigid plate without slip 0.15 m, ν 0.35"
    )
    assert "η 33" in basis
    assert "Use" not in rows_of(single)
