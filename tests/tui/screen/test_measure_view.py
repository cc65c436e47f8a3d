"""The measure page as text, at every size: a few whole pictures, and what must always hold."""

from typing import Any

import numpy as np
import pytest

from pfwd.judging import Job, Station
from pfwd.procedures import plain_procedure
from pfwd.session.events import JobReported
from pfwd.session.live_trace import Envelope
from tests.snapshots import check_snapshot
from tests.tui.screen.scripted import Session, analysed, ready, saved, status, whole_point
from tui.screen.drawing.glyphs import ASCII, BRAILLE, Glyphs
from tui.screen.drawing.lines import text_of, width_of
from tui.screen.pages.measure import MeasurePage
from tui.screen.pages.measure_view import MeasureView, measure_lines
from tui.screen.session.screen_events import SessionStarted
from tui.screen.session.state import SessionState
from tui.screen.session.stations import ReceiverStatus
from tui.screen.session.status import status_of
from tui.screen.units import SI, US, Units

SIZES = [(80, 24), (120, 40), (200, 60)]


def view(*events: Any, units: Units = SI, glyphs: Glyphs = BRAILLE, **more: Any) -> MeasureView:
    state = SessionState(target=45e6, clock=lambda: 1.0)
    state.take(SessionStarted(Session(), "7"))
    for event in events:
        state.take(event)
    rest = np.zeros((500, 2))
    envelope = Envelope(0.01, rest, rest, 50_000, "m/s")
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


def text(shown: MeasureView, size: tuple[int, int]) -> str:
    return "\n".join(text_of(one).rstrip() for one in measure_lines(shown, *size)) + "\n"


@pytest.mark.parametrize("size", SIZES)
def test_the_page_looks_as_it_was_looked_at(size: tuple[int, int]) -> None:
    page = text(view(*whole_point(), chosen=6), size)
    check_snapshot(page, __file__, f"measure-{size[0]}x{size[1]}")


@pytest.mark.parametrize("size", SIZES)
def test_a_point_that_is_done_looks_as_it_was_looked_at(size: tuple[int, int]) -> None:
    check_snapshot(text(view(*whole_point()), size), __file__, f"done-{size[0]}x{size[1]}")


def test_a_wide_terminal_has_the_traces_beside_the_verdict() -> None:
    wide = text(view(*whole_point()), (200, 60))
    for part in ("deflection µm", "load kN", "residual µm", "PASS"):
        assert part in wide
    assert max(len(row.rstrip()) for row in wide.splitlines()[4:30]) > 160
    assert "deflection µm" not in text(view(*whole_point()), (120, 40))


CASES = {
    "nothing": [],
    "ready": [ready(), status()],
    "rejected": [ready(), saved(1, status="rejected", reason="false trigger: 1.10 kN")],
    "first answer": [ready(), saved(1), analysed(1, full=False)],
    "whole": whole_point(),
    "bound": [ready(), saved(1), analysed(1, at_bound=["modulus"], explained=False)],
    "many": [event for n in range(1, 30) for event in (saved(n), analysed(n))],
    "long": [ready(), saved(1, "a very long name of a point, as long as one can be, 64 letter")],
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("size", [*SIZES, (60, 20), (100, 30), (99, 29), (132, 43), (40, 12)])
@pytest.mark.parametrize("large", [False, True])
def test_the_page_fills_just_the_terminal(case: str, size: tuple[int, int], large: bool) -> None:
    lines = measure_lines(view(*CASES[case], large=large), *size)
    assert len(lines) == size[1]
    assert [width_of(one) for one in lines if width_of(one) > size[0]] == []


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("large", [False, True])
def test_the_modulus_stands_with_all_it_rests_on(size: tuple[int, int], large: bool) -> None:
    shown = text(view(*whole_point(), large=large, chosen=6), size)
    for part in (
        "MPa",
        "ground over rock",
        "rigid plate without slip",
        "radius 150 mm",
    ):
        assert part in shown
    for part in (
        "Poisson's ratio 0.35",
        "± for 95 %",
        "POINT DONE",
        "(3/3)",
        "target 45.0 MPa",
        "mean of 3",
    ):
        assert part in shown
    assert "47.6" in shown  # of the last drop, in the table


@pytest.mark.parametrize("size", SIZES)
def test_bounds_and_unexplained_residuals_are_told_in_words(size: tuple[int, int]) -> None:
    shown = " ".join(text(view(*CASES["bound"]), size).replace("│", " ").split())
    assert "UNEXPLAINED" in shown
    assert "AT THE LIMIT" in shown


@pytest.mark.parametrize("size", SIZES)
def test_a_rejected_drop_says_why_in_words(size: tuple[int, int]) -> None:
    shown = text(view(*CASES["rejected"]), size)
    assert "REPEAT" in shown
    assert "false trigger: 1.10 kN" in shown


def test_us_customary_units_are_everywhere() -> None:
    shown = text(view(*whole_point(), units=US, chosen=6), (120, 40))
    for part in ("ksi", "lbf", "mil", "in/s", "radius 5.91 in"):
        assert part in shown
    for part in ("MPa", "kN", "µm", "mm"):
        assert part not in shown


def test_in_ascii_there_is_nothing_else() -> None:
    shown = text(view(*whole_point(), glyphs=ASCII), (120, 40))
    assert ASCII.to_terminal(shown.replace("\n", " ").replace("ν", "n")).isascii()
    assert not any(0x2800 <= ord(letter) < 0x2900 for letter in shown)


def test_the_curves_of_the_fit_are_told_apart_by_their_form() -> None:
    shown = text(view(*whole_point(), chosen=6), (120, 40))
    assert "─── measured" in shown
    assert "- - fitted" in shown


def test_a_message_is_shown_whole() -> None:
    said = "the analysis ended by itself twice; the drop is safe, invert it again later"
    for size in SIZES:
        shown = " ".join(text(view(*whole_point(), message=said), size).split())
        assert said in shown


def test_a_chosen_drop_is_the_one_that_is_shown() -> None:
    shown = text(view(*whole_point(), chosen=2), (120, 40))
    assert "modulus, drop 2" in shown
    assert "▶   2" in shown


def test_next_action_and_keys_are_always_there() -> None:
    for case in CASES.values():
        for size in SIZES:
            lines = text(view(*case), size).splitlines()
            assert "n next point" in lines[-1]
            assert any("▶" in one for one in lines[:4])


@pytest.mark.parametrize("size", [(80, 24), (120, 40)])
def test_the_receiver_and_the_lot_are_seen_on_small_terminals_too(size: tuple[int, int]) -> None:
    stations = tuple(Station(f"12+3{n}0", 12_300.0 + 10 * n) for n in range(4))
    job = Job(procedure=plain_procedure(), target=45e6, stations=stations)
    where = ReceiverStatus("GPS RTK fixed 11 sat", "48.13740, 11.57550", is_good=True)
    shown = text(view(JobReported(job), ready(), status(), position=where), size)
    assert "GPS RTK fixed 11 sat" in shown
    assert "0 of 4 stations" in shown, "the point that is measured is not done yet"
    assert "lost 0" in shown


def test_nothing_measured_has_no_verdict() -> None:
    shown = text(view(ready()), (120, 40))
    assert "nothing measured yet" in shown
    assert "UNDECIDED" not in shown


def test_verdict_and_value_stand_side_by_side_where_they_do_not_fit_below() -> None:
    shown = text(view(*whole_point(), message="a sentence that is longer " * 9), (80, 24))
    (row, *_) = [one for one in shown.split("\n") if one.startswith(" ████")]
    assert len(row) > 60, "PASS, and the modulus beside it"


def test_a_high_terminal_shows_what_every_drop_says() -> None:
    assert "modulus of each drop, MPa" in text(view(*whole_point(), chosen=6), (200, 60))
    assert "modulus of each drop, MPa" not in text(view(*whole_point(), chosen=6), (120, 40))
