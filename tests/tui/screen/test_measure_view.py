"""The measure page as text, at every size: a few whole pictures, and what must always hold."""

import re
from typing import Any

import numpy as np
import pytest

from inversion.notices import Notice
from pfwd.judging import Job, Station
from pfwd.procedures import find_procedure, plain_procedure
from pfwd.session.events import JobReported
from pfwd.session.live_trace import Envelope
from pfwd.units import SI, US, Units
from pfwd_plugins.quantities import Measurand
from tests.snapshots import check_snapshot
from tests.tui.screen.scripted import (
    Session,
    analysed,
    complete_point,
    ready,
    report,
    saved,
    status,
)
from tui.screen.drawing.glyphs import ASCII, BRAILLE, Glyphs
from tui.screen.drawing.lines import text_of, width_of
from tui.screen.pages.measure import MeasurePage
from tui.screen.pages.measure_view import MeasureView, complete_point_lines, measure_lines
from tui.screen.session.screen_events import SessionStarted
from tui.screen.session.state import SessionState
from tui.screen.session.stations import ReceiverStatus
from tui.screen.session.status import status_of

SIZES = [(80, 24), (120, 40), (200, 60)]


def view(*events: Any, units: Units = SI, glyphs: Glyphs = BRAILLE, **more: Any) -> MeasureView:
    state = SessionState(target=45e6, clock=lambda: 1.0)
    report(state, SessionStarted(Session(), "7"))
    report(state, *events)
    rest = np.zeros((500, 2))
    envelope = Envelope(0.01, rest, rest, 50_000, Measurand.VELOCITY)
    word = status_of(state, 100.0)
    return MeasureView(
        state,
        word,
        units,
        glyphs,
        envelope,
        "12:00:07",
        "Ring road km 12",
        MeasurePage.KEYS,
        **more,
    )


def text(on_page: MeasureView, size: tuple[int, int]) -> str:
    return "".join(text_of(row).rstrip() + "\n" for row in measure_lines(on_page, *size))


@pytest.mark.parametrize("size", SIZES)
def test_the_measure_page_matches_its_snapshots(size: tuple[int, int]) -> None:
    for name, chosen in (("measure", 6), ("done", None)):
        page = text(view(*complete_point(), chosen=chosen), size)
        check_snapshot(page, __file__, f"{name}-{size[0]}x{size[1]}")


CASES = {
    "nothing": [],
    "ready": [ready(), status()],
    "rejected": [ready(), saved(1, status="rejected", reason="false trigger: 1.10 kN")],
    "first answer": [ready(), saved(1), analysed(1, full=False)],
    "complete": complete_point(),
    "peaks": [JobReported(Job(procedure=find_procedure("mndot"))), *complete_point()],
    "bound": [ready(), saved(1), analysed(1, at_bound=["modulus"], explained=False)],
    "many": [event for n in range(1, 30) for event in (saved(n), analysed(n))],
    "long": [ready(), saved(1, "a very long name of a point, as long as one can be, 64 letter")],
}


@pytest.mark.parametrize("size", [*SIZES, (60, 20), (100, 30), (99, 29), (132, 43), (40, 12)])
@pytest.mark.parametrize("large", [False, True])
def test_the_page_fills_just_the_terminal(size: tuple[int, int], large: bool) -> None:
    for case, events in CASES.items():
        lines = measure_lines(view(*events, large=large), *size)
        assert len(lines) == size[1]
        assert [width_of(row) for row in lines if width_of(row) > size[0]] == [], case
        if size in SIZES:
            assert "n next point" in text_of(lines[-1]), "the keys"
            assert any("▶" in text_of(row) for row in lines[:4]), "the next action"


@pytest.mark.parametrize("size", SIZES)
def test_the_modulus_in_large_type_has_its_assumptions(size: tuple[int, int]) -> None:
    on_page = text(view(*complete_point(), large=True, chosen=6), size)
    parts = ["soil on bedrock", "rigid plate without slip", "radius 150 mm", "95 %"]
    parts += ["Poisson's ratio 0.35", "POINT DONE", "(3/3)", "target 45.0 MPa", "mean of 3"]
    parts += ["47.6"]  # of the last drop, in the table
    assert [part for part in parts if part not in on_page] == []


@pytest.mark.parametrize("size", SIZES)
def test_faults_have_words(size: tuple[int, int]) -> None:
    on_page = " ".join(text(view(*CASES["bound"]), size).replace("│", " ").split())
    assert "UNEXPLAINED" in on_page
    assert "AT THE LIMIT" in on_page
    on_page = text(view(*CASES["rejected"]), size)
    assert "REPEAT" in on_page
    assert "false trigger: peak load 1.1 kN" in on_page


def test_us_customary_units_and_ascii_are_everywhere() -> None:
    on_page = text(view(*complete_point(), units=US, glyphs=ASCII, chosen=6), (120, 40))
    assert not any(0x2800 <= ord(letter) < 0x2900 for letter in on_page), "no dots of Braille"
    for part in ("ksi", "lbf", "mil", "in/s", "radius 5.91 in"):
        assert part in on_page
    for part in ("MPa", "kN", "µm", "mm"):
        assert part not in on_page


@pytest.mark.parametrize("size", SIZES)
def test_a_message_is_not_cut(size: tuple[int, int]) -> None:
    sentence = "the analysis process died twice; the drop is safe, invert it again later"
    on_page = " ".join(text(view(*complete_point(), message=sentence), size).split())
    assert sentence in on_page


@pytest.mark.parametrize("size", [(80, 24), (120, 40)])
def test_small_terminals_show_receiver_and_lot(size: tuple[int, int]) -> None:
    stations = tuple(Station(f"12+3{n}0", 12_300.0 + 10 * n) for n in range(4))
    job = Job(procedure=plain_procedure(), target=45e6, stations=stations)
    where = ReceiverStatus("GPS RTK fixed 11 sat", "48.13740, 11.57550", is_good=True)
    on_page = text(view(JobReported(job), ready(), status(), position=where), size)
    assert "GPS RTK fixed 11 sat" in on_page
    assert "0 of 4 stations" in on_page, "the point that is measured is not done yet"
    assert "lost 0" in on_page


def test_a_point_without_drops_has_no_verdict() -> None:
    on_page = text(view(ready()), (120, 40))
    assert "nothing measured yet" in on_page
    assert "UNDECIDED" not in on_page


def test_verdict_and_value_stand_side_by_side_where_they_do_not_fit_below() -> None:
    on_page = text(view(*complete_point(), message="a sentence that is longer " * 9), (80, 24))
    (row, *_) = [row for row in on_page.split("\n") if row.startswith(" ████")]
    assert len(row) > 60, "PASS, and the modulus to its right"
    rows = [text_of(row) for row in complete_point_lines(view(*complete_point()), 80, 8)]
    assert ["█" in row for row in rows] == [False, *[True] * 5, False, False]
    assert all(row.strip() for row in rows[-2:]), "as many facts as there are rows for"


@pytest.mark.parametrize("large", [False, True])
def test_no_advice_is_cut_on_a_small_terminal(large: bool) -> None:
    marks = (Notice("saturated", {"samples": 12, "channel": "g0"}),)
    job = Job(procedure=find_procedure("tp-bf-stb-b8.3"), target=45e6)
    on_page = view(JobReported(job), ready(), saved(1, marks=marks), analysed(1), large=large)
    advice = on_page.state.advice(on_page.drop)
    assert len(advice) == 2
    words = " ".join(text(on_page, (80, 24)).split())
    assert [part for part in advice if part not in words] == []


def test_the_mark_of_a_number_without_support_is_explained() -> None:
    unexplained = {"contact_residual_rms_over_peak": 0.3, "explained": False}
    drops = [event for n in (1, 2, 3, 4) for event in (saved(n), analysed(n, **unexplained))]
    page = text(view(ready(), *drops), (80, 24))
    assert re.search(r"point: E_eq \S+\* .* \* not supported", page)
