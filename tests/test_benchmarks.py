"""Records of the benchmarks; their figures are in docs/validation.md."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks import coverage, layers, validation
from benchmarks.__main__ import main

# A missing surrogate is built, and every drop takes seconds.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def lines(capsys: pytest.CaptureFixture[str]) -> list[dict[str, object]]:
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_coverage_reports_groups_and_the_models_error(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # The status depends on the target, which a single drop cannot show.
    monkeypatch.setattr(coverage, "draw_case", lambda number, seed: CHEAP)
    assert coverage.run(["--cases", "1", "--jobs", "1", "--json"]) in (0, 1)
    records = lines(capsys)
    assert {record["group"] for record in records if "group" in record} == {"depth declared", "all"}
    largest = {str(r["model_error"]): r["largest"] for r in records if "model_error" in r}
    assert float(str(largest["plate_rms"])) < 0.002


CHEAP = coverage.CoverageCase(
    number=0,
    group="depth declared",
    modulus=60e6,
    viscosity=60e3,
    density=1900.0,
    depth=0.6,
    poisson_ratio=0.35,
    radius=0.15,
    plate_mass=10.0,
    pulse=0.013,
    pressure=100e3,
    quantity="velocity",
    noise=0.002,
    pre_trigger=0.015,
)


def test_drawn_cases_are_in_the_range_and_reproducible() -> None:
    cases = [coverage.draw_case(number) for number in range(300)]
    assert cases[7] == coverage.draw_case(7)
    for case in cases:
        assert 5e6 <= case.modulus <= 1e9
        assert case.depth == math.inf or 2.0 <= case.depth / case.radius <= 60.0
        assert case.hammer.pulse_duration == pytest.approx(case.pulse)
        assert 5.0 <= case.plate_mass <= 40.0
    assert 10 < sum(case.depth == math.inf for case in cases) < 60


def test_a_trace_has_declared_values_and_no_true_density() -> None:
    drop = coverage.simulate(CHEAP)
    record = coverage.recorded(CHEAP, drop)
    assert record.bedrock_depth == CHEAP.depth
    assert record.density is None
    assert np.max(record.load) == pytest.approx(np.max(drop.load), rel=0.02)


def test_validation_reports_methods_and_rungs(capsys: pytest.CaptureFixture[str]) -> None:
    assert validation.run(["--cases", "1", "--jobs", "1", "--json"]) == 0
    records = lines(capsys)
    overall = {r["method"]: r for r in records if r.get("cases") == "all"}
    assert set(overall) == set(validation.METHODS)
    assert abs(float(str(overall[validation.DEPTH_DECLARED]["mean"]))) < 0.5
    assert [r["rung"] for r in records if "rung" in r] == list(validation.LADDER)


def test_validation_runs_without_the_tables_of_the_study(tmp_path: Path) -> None:
    assert validation.printed_errors(tmp_path) == {}


@pytest.mark.parametrize("part", ["coverage", "calibration", "validation", "layers"])
def test_invalid_options_have_status_2(part: str) -> None:
    assert main([part, "--cases", "many"]) == 2


def test_layers_are_inverted_from_finite_elements(capsys: pytest.CaptureFixture[str]) -> None:
    assert layers.run(["--cases", "2", "--json"]) == 0
    records = {str(r.get("what")): r for r in lines(capsys)}
    for quantity in ("subgrade", "top"):
        assert float(str(records[quantity]["worst"])) < 10.0
        assert records[quantity]["interval_holds"] == 100.0
    assert records["subgrade"]["cases"] == 2
