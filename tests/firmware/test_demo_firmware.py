"""`pfwd demo --firmware`: the main job on the compiled core."""

from pathlib import Path

import pytest

from tests.firmware.compiled import needs_compiler
from tests.tui.console import pfwd, records

pytestmark = needs_compiler


def test_the_main_job_runs_on_the_compiled_core(tmp_path: Path) -> None:
    # The first drop must fall after the check of the load cell, on a busy computer as well.
    done = pfwd("demo", "--firmware", "--drops", 2, "--rate", 3, "--json", "-o", tmp_path / "s")
    assert done.returncode == 0, done.stderr
    assert "compiled firmware playing simulated drops at socket://127.0.0.1:" in done.stderr
    assert "PFWD core, host board" in done.stderr
    first = [record for record in records(done.stdout) if record.get("method") == "posterior"]
    truth = {1: 38.25e6, 2: 42.30e6}
    for record in first:
        assert record["modulus_pa"] == pytest.approx(truth[record["drop"]], rel=0.005)
    assert {record["drop"] for record in first} == {1, 2}


def test_what_the_core_cannot_play_is_refused(tmp_path: Path) -> None:
    done = pfwd("demo", "--firmware", "--scenario", "unplug", "--lines", "-o", tmp_path / "s")
    assert done.returncode == 2
    assert "expected a scenario in the binary protocol without faults" in done.stderr
    assert "Traceback" not in done.stderr
