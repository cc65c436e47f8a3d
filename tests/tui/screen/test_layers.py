"""Layers, bowl and residual by sensor on the screen."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DropResult
from pfwd.session.plan import SessionPlan
from pfwd.units import SI, US
from pfwd_device import Drop
from tests.tui.results import result
from tests.tui.screen.scripted import (
    Session,
    analysed,
    curves,
    ready,
    report,
    saved,
    saved_drop,
    screen_drop,
)
from tests.tui.screen.test_measure_view import text, view
from tui.screen.drawing.drop_figures import bowl_figure
from tui.screen.drawing.glyphs import ASCII, BRAILLE
from tui.screen.drawing.lines import text_of, width_of
from tui.screen.pages.drop import DropPage
from tui.screen.pages.drop_view import DropPageState, drop_lines, text_lines
from tui.screen.pages.layer_texts import layer_lines, sensor_lines
from tui.screen.session.drop_fits import DropFits
from tui.screen.session.screen_drop import ScreenDrop
from tui.screen.session.screen_events import SessionStarted
from tui.screen.session.state import SessionState

OFFSETS = (0.0, 0.3, -0.3, 0.6)
MEDIUM = {"viscosity_pa_s": 3e4, "density_kg_m3": 1900.0, "poisson_ratio": 0.35}
TOP = MEDIUM | {
    "modulus_pa": 120e6,
    "modulus_interval_pa": [110e6, 131e6],
    "thickness_m": 0.25,
    "thickness_sd_m": 0.004,
    "thickness_interval_m": [0.24, 0.262],
}
BELOW = MEDIUM | {"modulus_pa": 47.3e6, "modulus_interval_pa": [46.7e6, 47.9e6]}
OPEN = MEDIUM | {"modulus_pa": 90e6, "modulus_interval_pa": [40e6, 410e6]}
LAYERS: dict[str, Any] = {
    "layers": [TOP, BELOW],
    "effective_modulus_pa": 71e6,
    "effective_modulus_interval_pa": [70e6, 72e6],
    "effective_depth_m": 0.93,
    "bedrock_depth_m": None,
    "bedrock_depth_sd_m": None,
    "model": "half-space",
}
UNDETERMINED = LAYERS | {
    "layers": [TOP, OPEN],
    "modulus_pa": None,
    "modulus_sd_pa": None,
    "modulus_interval_pa": [40e6, 410e6],
}


def rows(drop_result: DropResult, width: int = 60, units: Any = SI) -> list[str]:
    return [text_of(text_row) for text_row in layer_lines(drop_result, units, width)]


def drop_of(make_drop: Callable[..., Drop], drop_result: DropResult, *places: float) -> ScreenDrop:
    """Return a drop whose curves are half off at all sensors but the centre."""
    stored = replace(saved_drop(), drop=make_drop(offsets=OFFSETS))
    histories = curves()
    observed = np.array([histories.observed[0] / (1 + 5 * abs(place)) for place in places])
    factor = np.array([1.0 if place == 0 else 1.5 for place in places])[:, None]
    drawn = replace(
        histories,
        observed=observed,
        predicted=factor * observed,
        offsets=np.array(places),
        peaks=observed.max(axis=1),
    )
    return screen_drop(drop_result, saved=stored, curves=drawn)


def page(drop: ScreenDrop, width: int, height: int, **more: Any) -> list[str]:
    state = SessionState(clock=lambda: 1.0)
    report(state, SessionStarted(Session(), "7"))
    text_on_page = DropPageState(drop, state, SI, BRAILLE, "", DropPage.KEYS, **more)
    lines = drop_lines(text_on_page, width, height)
    assert len(lines) == height
    assert all(width_of(text_row) == width for text_row in lines)
    return [text_of(text_row) for text_row in lines]


def test_each_layer_is_a_row_with_a_bar_on_a_log_scale() -> None:
    texts = rows(result(**LAYERS), 70)
    assert texts[0] == "layers, E MPa (95 %); bars 37 to 164 MPa, log"
    assert texts[1].startswith("1 0.250 m (0.240 to 0.262) 120 (110 to 131)")
    assert texts[2].startswith("2 no end                   47.3 (46.7 to 47.9)")
    assert texts[3] == "effective 71.0 MPa (70.0 to 72.0), down to 0.93 m"
    assert len(texts) == 4
    top, below = (row.rsplit(")", 1)[1].strip() for row in texts[1:3])
    assert len(top) == len(below)
    # The bars run over a factor of 4.4; 120 is at 79 % of it, 47.3 at 16 %.
    assert top.index("■") == round(0.79 * (len(top) - 1))
    assert below.index("■") == round(0.16 * (len(below) - 1))
    assert "─" in top
    assert ASCII.to_terminal(top).isascii()


def test_an_open_modulus_has_a_bar_and_no_value() -> None:
    texts = rows(result(**UNDETERMINED), 70)
    assert "2 no end                   not known (40 to 410)" in texts[2]
    assert "■" not in texts[2]
    assert texts[2].count("─") > texts[1].count("─")


def test_rock_units_and_narrow_columns() -> None:
    ground_on_rock = BELOW | {"thickness_m": 0.75}
    layers = LAYERS | {"layers": [TOP, ground_on_rock], "bedrock_depth_m": 1.0}
    assert "rock at 1 m (given)" in rows(result(**layers))
    assert any("ksi" in row and "MPa" not in row for row in rows(result(**LAYERS), 70, US))
    assert "1 0.250 m 120 (110 to 131)" in rows(result(**LAYERS), 40)[2]
    narrow = rows(result(**LAYERS), 30)
    assert all(len(row) <= 30 for row in narrow)
    assert any(row.startswith("   ") and "■" in row for row in narrow)
    assert rows(result()) == []


def test_residuals_by_sensor_name_excluded_sensors(
    make_drop: Callable[..., Drop],
) -> None:
    drop = drop_of(make_drop, result(**LAYERS), 0.0, 0.3, -0.3)
    texts = [text_of(text_row) for text_row in sensor_lines(drop.memory.curves, OFFSETS, SI)]
    assert texts[0] == "residual by sensor, of its own peak"
    assert texts[1].split() == ["centre", "0", "%,", "0", "%", "in", "contact"]
    assert texts[2].split()[:2] == ["300", "mm"]
    assert texts[3].split()[:2] == ["-300", "mm"]
    assert texts[4].strip() == "600 mm  excluded from the fit"
    assert sensor_lines(drop.memory.curves, (0.0,), SI) == []
    assert sensor_lines(None, OFFSETS, SI) == []


def test_curves_are_fetched_and_refits_reported_with_their_layers(
    make_drop: Callable[..., Drop],
) -> None:
    """Curves of homogeneous ground would be those of a different fit."""
    requested: list[AnalysisOptions] = []
    messages: list[str] = []
    source: Any = SimpleNamespace(plan=SessionPlan(options=AnalysisOptions(seed=4)))
    no_session: Any = SimpleNamespace(put=lambda _: None)
    state = SessionState(clock=lambda: 1.0)
    fits = DropFits(source, no_session, state, messages.append, no_session)
    jobs: Any = SimpleNamespace(submit=lambda *args, **_: requested.append(args[4]))
    fits._jobs = jobs
    fits.fetch(screen_drop(result(**LAYERS)))
    fixed = TOP | {"thickness_sd_m": None, "thickness_interval_m": None}
    fields = result(**LAYERS | {"layers": [fixed, BELOW]})
    fits.fetch(screen_drop(fields))
    fits.fetch(screen_drop(result()))
    quick = AnalysisOptions(seed=4, method="posterior")
    assert requested == [
        replace(quick, layers=2),
        replace(quick, layers=2, thickness=(0.25,)),
        quick,
    ]
    fits.on_refitted(1, "2 layers", result(**UNDETERMINED), SI)
    fits.on_refitted(1, "2 layers", result(None, reason="no pulse", layers=None), SI)
    assert messages == [
        "drop 1, 2 layers: effective 71.0 MPa; m goes through the results",
        "drop 1, 2 layers: no fit, no pulse",
    ]


def test_the_bowl_has_a_dash_for_each_sensor_and_a_line_for_the_fit(
    make_drop: Callable[..., Drop],
) -> None:
    figure = bowl_figure(drop_of(make_drop, result(**LAYERS), *OFFSETS), SI)
    assert figure is not None
    measured, modelled = figure.curves
    assert figure.time_unit == "mm"
    assert (figure.start, figure.end) == pytest.approx((-318.0, 618.0))
    for place, peak in ((-300.0, 256.0), (0.0, 640.0), (300.0, 256.0), (600.0, 160.0)):
        at = int(np.argmin(np.abs(measured.time - place)))
        assert measured.values[at] == pytest.approx(peak, rel=1e-2)
        factor = 1.0 if place == 0 else 1.5
        assert modelled.values[at] == pytest.approx(factor * peak, rel=1e-2)
    assert np.isnan(measured.values[int(np.argmin(np.abs(measured.time - 150.0)))])
    single = screen_drop(result(), curves=curves())
    assert bowl_figure(single, SI) is None


@pytest.mark.parametrize("size", [(80, 24), (120, 40), (200, 60)])
@pytest.mark.parametrize("fields", [LAYERS, UNDETERMINED])
def test_the_drop_page_has_layers_bowl_and_sensors(
    make_drop: Callable[..., Drop], size: tuple[int, int], fields: dict[str, Any]
) -> None:
    drop = drop_of(make_drop, result(**fields), *OFFSETS)
    text_on_page = page(drop, *size, panel="bowl")
    assert any("bowl" in row and "µm" in row for row in text_on_page)
    state = SessionState(clock=lambda: 1.0)
    lines = text_lines(DropPageState(drop, state, SI, BRAILLE, "", DropPage.KEYS), drop, 60)
    written = "\n".join(text_of(text_row) for text_row in lines)
    assert "effective 71.0 MPa" in written
    assert "residual by sensor" in written
    assert ("subgrade 47.3 MPa (46.7 to 47.9)" in written) == (fields is LAYERS)
    assert ("not known (40 to 410)" in written) == (fields is UNDETERMINED)


@pytest.mark.parametrize("size", [(120, 40), (200, 60)])
def test_the_measure_page_names_the_layer_of_a_modulus(size: tuple[int, int]) -> None:
    text_on_page = text(view(ready(), saved(1), analysed(1, **LAYERS)), size)
    assert "subgrade  47.3 (46.7 to 47.9) MPa" in text_on_page
    assert "top       120 (110 to 131) MPa, 0.25 m" in text_on_page
    assert "lowest of 2 layers, soil without bedrock" in text_on_page
    text_on_page = text(view(ready(), saved(1), analysed(1, **UNDETERMINED)), size)
    assert "subgrade  not known (40 to 410) MPa" in text_on_page
    assert "subgrade" not in text(view(ready(), saved(1), analysed(1)), size)


@pytest.mark.parametrize(("status", "role"), [("measured", "text"), ("rejected", "bad")])
def test_the_status_of_a_rejected_drop_alone_is_in_red(status: str, role: str) -> None:
    seating = [saved(number) for number in (1, 2, 3)]
    state = view(ready(), *seating, saved(4, status=status)).state
    assert state.last is not None
    (title, *_) = drop_lines(
        DropPageState(state.last, state, SI, BRAILLE, "", DropPage.KEYS), 120, 40
    )
    assert [cell.role for cell in title if cell.text.strip() == status] == [role]
