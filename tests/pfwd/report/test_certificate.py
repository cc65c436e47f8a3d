"""The first page: what the procedure's document asks for, and deflection curves past their peak."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfwd.judging import PointView
from pfwd.report import drawing
from pfwd.report.blocks import Pairs, Paragraph
from pfwd.report.certificate_blocks import certificate_blocks, points_table
from pfwd.report.composing import compose
from pfwd.report.content import Report
from pfwd.report.drawing import curves_height, decimals_of
from pfwd.report.fonts import Letters
from pfwd.report.gathering import ReportOptions, gather
from pfwd.report.texts import load_texts

EN, DE = load_texts("en"), load_texts("de")


def rows_of(report: Report) -> dict[str, str]:
    blocks = certificate_blocks(report, EN, Letters())
    (pairs,) = (block for block in blocks if isinstance(block, Pairs))
    return dict(pairs.rows)


@pytest.mark.parametrize(
    ("procedure", "formula", "drops", "columns"),
    [
        (
            "tp-bf-stb-b8.3",
            "E_vd = 1.5 r σ / s̄, σ = 0.1 MPa",
            "3 (seating) + 3 (measured)",
            ["s, mm", "s̄, mm", "v, mm/s", "s/v, ms", "E_vd", "Modulus E"],
        ),
        (
            "mchw-885",
            "E_LWD = 2 (1 - ν²) r σ / s̄, σ = F / (π r²), ν = 0.35",
            "3 (seating) + 3 (measured)",
            ["s, mm", "s̄, mm", "F, kN", "E_LWD", "Modulus E"],
        ),
        (
            "mndot",
            None,
            "3 (seating) + 3 (measured)",
            ["s, mm", "F, kN", "Peak deflection", "Modulus E"],
        ),
        ("paper", None, None, ["s, mm", "s̄, mm", "F, kN", "Modulus E"]),
        (None, None, None, ["s, mm", "s̄, mm", "v, mm/s", "s/v, ms", "Modulus E"]),
    ],
)
def test_it_has_what_the_procedure_asks_for(
    survey: Path, procedure: str | None, formula: str | None, drops: str | None, columns: list[str]
) -> None:
    report = gather(survey, ReportOptions(procedure=procedure))
    rows, table = rows_of(report), points_table(report, EN)
    assert rows.get("Formula") == formula
    assert rows.get("Drops at a point") == drops
    assert list(table.columns) == ["Point", "Time", *columns, "Target", "Verdict"]
    assert [table.columns[place] for place in table.right] == [
        name for name in columns if name in ("s̄, mm", "v, mm/s", "s/v, ms", "F, kN")
    ]


def test_loads_pressures_and_conditions_are_said(survey: Path) -> None:
    report = gather(survey)
    assert rows_of(report)["Peak load"] == "measured: 8.00 – 8.03 kN, σ = 113 – 114 kPa"
    by_nominal = rows_of(gather(survey, ReportOptions(procedure="tp-bf-stb-b8.3")))["Peak load"]
    assert by_nominal == (
        "measured: 8.00 – 8.03 kN, σ = 113 – 114 kPa; presumed: 7.07 kN, σ = 100 kPa (± 10 %, our "
        "tolerance)"
    )
    assert "Conditions" not in rows_of(report)
    first, second = report.points

    def declared(point: PointView, **values: Any) -> PointView:
        setup = replace(point.setup, **values)
        return replace(point, drops=[replace(drop, setup=setup) for drop in point.drops])

    wet = declared(first, moisture=5.5, temperature=12.0)
    dry = declared(second, moisture=4.0, material="gravel")
    said = rows_of(replace(report, points=(wet, dry)))["Conditions"]
    assert said == "Material: gravel; Moisture: 4.00 – 5.50 %; Temperature: 12.0 °C"


def test_names_of_documents_keep_their_points(survey: Path) -> None:
    report = gather(survey, ReportOptions(procedure="tp-bf-stb-b8.3"))
    said = [b.text for b in compose(report, DE, Letters()) if isinstance(b, Paragraph)]
    assert any(text.endswith("TP BF-StB Teil B 8.3") for text in said)


def test_a_curve_goes_past_its_peak_when_the_plate_is_lowest_after_the_load(survey: Path) -> None:
    drop = gather(survey).points[0].drops[-1]
    curves = drop.curves
    assert curves is not None
    # As on soft ground: the load has gone at 6 ms, the peak comes at 11.8 ms.
    late = replace(curves, window_end=0.006, contact_end=0.006)
    shown = drawing._curve_part(drop, late)
    lowest = int(curves.observed[0].argmax())
    assert lowest in shown
    assert curves.time[shown[-1]] > curves.time[lowest] + 0.005
    assert curves.observed[0][shown[-1]] < 0.7 * curves.observed[0][lowest]
    assert np.array_equal(shown, np.arange(shown.size))
    # A drift beyond two pulses is none.
    drifting = curves.observed.copy()
    drifting[0][-1] = 1.0
    assert np.array_equal(drawing._curve_part(drop, replace(late, observed=drifting)), shown)


def test_pictures_of_curves_have_room_below(survey: Path) -> None:
    points = gather(survey).points
    assert curves_height(points[:1]) == 62.0
    assert curves_height(points) == 33.0 + 8.0


def test_numbers_of_an_axis_are_those_of_its_steps() -> None:
    assert [decimals_of(step) for step in (100.0, 1.0, 0.2, 0.25, 0.125)] == [0, 0, 1, 2, 3]
