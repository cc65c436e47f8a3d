"""`pfwd demo --firmware`: the main job on the compiled core."""

from pathlib import Path

import pytest

from tests.firmware.compiled import needs_compiler
from tests.tui.console import pfwd, records

pytestmark = needs_compiler


def test_the_main_job_runs_on_the_compiled_core(tmp_path: Path) -> None:
    # The first drop must fall after the check of the load cell, on a busy computer as well.
    run = pfwd("demo", "--firmware", "--drops", 2, "--rate", 3, "--json", "-o", tmp_path / "s")
    assert run.status == 0, run.err
    assert "compiled firmware playing simulated drops at socket://127.0.0.1:" in run.err
    assert "PFWD core, host board" in run.err
    results = [record for record in records(run.out) if record.get("method") == "posterior"]
    truth = {1: 38.25e6, 2: 42.30e6}
    for record in results:
        assert record["modulus_pa"] == pytest.approx(truth[record["drop"]], rel=0.005)
    assert {record["drop"] for record in results} == {1, 2}


def test_a_scenario_with_faults_or_lines_is_refused(tmp_path: Path) -> None:
    run = pfwd("demo", "--firmware", "--scenario", "unplug", "--lines", "-o", tmp_path / "s")
    assert run.status == 2
    assert "expected a scenario in the binary protocol without faults" in run.err
