"""Layers, deflection bowl and residual by sensor in a report."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from inversion.notices import Notice
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DropResult
from pfwd.files.editing import Edit, edit_survey
from pfwd.judging import PointView
from pfwd.report.composing import compose
from pfwd.report.fonts import Letters
from pfwd.report.formatting import basis_of
from pfwd.report.gathering import ReportOptions, gather
from pfwd.report.ground_blocks import draw_ground, effective_of, ground_blocks
from pfwd.report.texts import languages, load_texts
from pfwd_device import Drop
from pfwd_device.recording import DropRecord, SurveyWriter
from tests.pfwd.report.surveys import (
    DECLARED,
    EN,
    LAYERS,
    LOWER,
    UPPER,
    RecordedInversion,
    layer,
    result_of,
    texts_of,
    with_loose_sensor,
)
from tests.records import complete

OFFSETS = (0.0, 0.3, -0.3, 0.6)


Write = Callable[..., None]


@pytest.fixture
def write(survey: Path, make_drop: Callable[..., Drop]) -> Write:
    """Writes a drop on layers, or with other values of its result."""

    def write_drop(number: int = 1, name: str = "L", offsets: Any = OFFSETS, **values: Any) -> None:
        drop = make_drop(number=number, offsets=offsets)
        if values.pop("loose", False):
            drop = with_loose_sensor(drop)
        with SurveyWriter.open(survey, publish=False) as writer:
            saved = writer.save_drop(DropRecord(name, drop, None, DECLARED, {}))
            writer.save_result(saved, complete(DropResult, result_of(number) | values))

    return write_drop


@pytest.fixture
def layered(survey: Path, write: Write) -> Path:
    """A survey with a point `L` of two drops on two media."""
    for number in (1, 2):
        write(number, **LAYERS)
    return survey


def point_of(survey: Path, **options: Any) -> Any:
    report = gather(survey, ReportOptions(**options))
    (point,) = [point for point in report.points if point.shown_name == "L"]
    return point


def text_of_report(survey: Path, point: str | None = None) -> str:
    """Return what the report, or its part on a point, says with its pictures."""
    report = gather(survey, ReportOptions(point=point))
    return " ".join(texts_of(compose(report, EN, Letters()))).replace("\xa0", " ")


def drawn(survey: Path, language: str = "en") -> Figure:
    figure = Figure()
    draw_ground(figure, point_of(survey).drops, load_texts(language))
    return figure


def lines_of(axes: Any) -> list[tuple[list[float], list[float]]]:
    return [(list(line.get_xdata()), list(line.get_ydata())) for line in axes.get_lines()]


def test_the_layers_of_every_drop_stand_in_a_table(layered: Path) -> None:
    text = text_of_report(layered)
    assert "1 1 120 (110 – 131) 0.250 (0.240 – 0.262) 20.0 1900 0.35" in text
    assert "2 2, subgrade 45.0 (44.0 – 46.0) unlimited" in text
    assert "Effective modulus 71.0 MPa (70.0 – 72.0), down to 0.93 m" in text


def test_an_open_modulus_is_dotted_and_has_no_value(survey: Path, write: Write) -> None:
    open_lower = layer(45e6, 40e6, 410e6)
    unknown = {"modulus_pa": None, "modulus_interval_pa": None}
    for number in (1, 2):
        write(number, offsets=(0.0,), layers=[UPPER, open_lower], density_sd_kg_m3=None, **unknown)
    text = text_of_report(survey, "L")
    assert "2, subgrade left open (40 – 410)" in text
    assert "2, subgrade 45" not in text
    assert not re.search(r"\b(nan|None|null)\b", text)
    assert point_of(survey).progress.value is None
    profile = drawn(survey).axes[0]
    styles = {tuple(line.get_xdata()): line.get_linestyle() for line in profile.get_lines()}
    assert styles[120.0, 120.0] == "-"
    assert styles[45.0, 45.0] == ":"


def test_a_declared_thickness_is_marked(survey: Path, write: Write) -> None:
    declared = UPPER | {"thickness_sd_m": None, "thickness_interval_m": None}
    write(**LAYERS | {"layers": [declared, LOWER]})
    assert "0.25 (given)" in text_of_report(survey, "L")


@pytest.mark.parametrize("language", languages())
def test_the_picture_has_steps_bands_boundary_and_effective_modulus(
    layered: Path, language: str
) -> None:
    profile, bowl = drawn(layered, language).axes
    lines = lines_of(profile)
    assert ([120.0, 120.0], [0.0, 0.25]) in lines
    assert ([120.0, 45.0], [0.25, 0.25]) in lines
    assert ([71.0, 71.0], [0.0, 0.93]) in lines
    # The interval of the boundary, between the two moduli.
    mean_modulus = pytest.approx(np.sqrt(120.0 * 45.0))
    assert any(x == [mean_modulus] * 2 and y == pytest.approx([0.24, 0.262]) for x, y in lines)
    bands = [path.get_datalim(profile.transData) for path in profile.collections]
    assert any((b.x0, b.x1) == pytest.approx((110.0, 131.0)) for b in bands)
    low, high = profile.get_ylim()
    assert low == pytest.approx(1.35 * 0.93)
    assert high == 0.0
    assert profile.get_xscale() == "log"
    offsets, _ = lines_of(bowl)[0]
    assert offsets == [-0.3, 0.0, 0.3, 0.6], "both sides of the plate"
    texts = load_texts(language)
    assert bowl.get_xlabel() == texts["offset_axis"]
    assert profile.get_ylabel() == texts["depth_axis"]


def test_rock_is_hatched_down_to_the_end(survey: Path, write: Write) -> None:
    on_rock = LOWER | {"thickness_m": 0.75, "thickness_sd_m": 0.01}
    write(**LAYERS | {"layers": [UPPER, on_rock]}, bedrock_depth_m=1.0, model="layer")
    profile = drawn(survey).axes[0]
    hatched = [patch for patch in profile.patches if patch.get_hatch()]
    assert len(hatched) == 1
    assert hatched[0].get_bbox().y0 == pytest.approx(1.0)
    assert hatched[0].get_bbox().y1 == pytest.approx(profile.get_ylim()[0])
    assert "rock" in [text.get_text() for text in profile.texts]


def test_the_bowl_is_drawn_without_layers(layered: Path, write: Write) -> None:
    write(1, "plain", (0.0, 0.3))
    points = {point.shown_name: point for point in gather(layered).points}
    figure = Figure()
    draw_ground(figure, points["plain"].drops, EN)
    (bowl,) = figure.axes
    measured = lines_of(bowl)[1]
    assert measured[0] == [0.0, 0.3]
    assert measured[1] == pytest.approx([0.5, 0.5 / 2.5], rel=1e-3)
    titles = [
        getattr(block, "text", "") for block in ground_blocks(points["plain"].drops, "plain", EN)
    ]
    assert "Layers" not in titles
    assert "Residual by sensor" in titles
    # A single sensor has no bowl, and the residual of the drop is its own.
    assert ground_blocks(points["A"].drops, "A", EN) == []
    empty = Figure()
    draw_ground(empty, points["A"].drops, EN)
    assert empty.axes == []


def test_an_excluded_sensor_is_named(survey: Path, write: Write) -> None:
    write(loose=True)
    text = text_of_report(survey)
    assert "0.6 m: left out – – – –" in text
    assert re.search(r"-0\.3 m \d", text)
    assert EN["lot"] in text, "three points, without targets and plate load tests"
    assert EN["plate_load"] not in text


def test_the_modulus_is_that_of_the_lowest_medium(layered: Path) -> None:
    lowest = "modulus-of-lowest-medium"

    def codes(point: PointView) -> list[str]:
        return [warning.code for warning in point.warnings if warning.code.startswith(lowest)]

    assert codes(point_of(layered, procedure="paper")) == [f"{lowest}-judged"]
    # E_vd is no modulus of the inversion, and the equivalent modulus is that of all media.
    assert codes(point_of(layered, procedure="tp-bf-stb-b8.3")) == [lowest]
    assert codes(point_of(layered)) == [lowest]
    assert "lowest of 2 media, half-space" in basis_of(point_of(layered).drops[0].result, EN)
    assert codes(gather(layered).points[0]) == []


def test_drops_with_different_numbers_of_media_are_reported(layered: Path, write: Write) -> None:
    write(3)
    assert Notice("media-differ", {"media": "1 and 2"}) in point_of(layered).warnings


def test_layers_are_inverted_for_the_report_whatever_is_stored(
    layered: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inversion = RecordedInversion(monkeypatch)
    gather(layered)
    assert inversion.options == []
    report = gather(
        layered, ReportOptions(analysis=AnalysisOptions(layers=3, thickness=(0.1, 0.3), seed=5))
    )
    assert len(inversion.options) == 10
    assert set(inversion.options) == {AnalysisOptions(layers=3, thickness=(0.1, 0.3), seed=5)}
    assert "--layers 3 --thickness 0.1,0.3 --seed 5" in report.command
    assert report.settings["layers"] == 3
    assert report.settings["thickness"] == "0.1,0.3"
    assert "layers" not in gather(layered).settings


def test_a_result_of_layers_that_is_stale_is_inverted_with_layers(
    layered: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    edit_survey(layered, [Edit("declared", {"poisson_ratio": 0.4})], point="L")
    inversion = RecordedInversion(monkeypatch)
    point_of(layered)
    assert inversion.options == [AnalysisOptions(layers=2)] * 2


def test_a_missing_effective_modulus_is_a_dash() -> None:
    assert effective_of(DropResult(), EN) == "–"
