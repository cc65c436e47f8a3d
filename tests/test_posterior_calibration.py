"""Ranks of true values in the posterior, as ``pfwd bench calibration`` computes them."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from benchmarks import calibration
from inversion.threads import single_threaded_blas


@pytest.mark.timeout(300)
def test_true_values_have_uniform_ranks() -> None:
    with single_threaded_blas():
        replicates = [calibration.model_replicate(11, number) for number in range(50)]
    for name in ("log modulus", "equivalent modulus", "next peak", "1/depth"):
        ranks = np.sort([r.ranks[name] for r in replicates if name in r.ranks])
        assert ranks.size >= 15
        distance, band = calibration.distance_and_band(ranks)
        assert distance <= band, name


def test_the_distance_is_that_of_the_distribution_functions() -> None:
    # Ranks at the middles of equal parts are half a step from the uniform law.
    ranks = (np.arange(20) + 0.5) / 20
    distance, band = calibration.distance_and_band(ranks)
    assert distance == pytest.approx(0.025)
    # Largest distance for 20 values at a level of 1 % (Miller 1956, table 1).
    assert band == pytest.approx(0.352, abs=0.0005)


def test_a_posterior_of_half_the_width_leaves_the_band() -> None:
    ranks = (np.arange(300) + 0.5) / 300
    distance, band = calibration.distance_and_band(ndtr(2.0 * ndtri(ranks)))
    assert distance > band


def test_the_file_of_ranks_has_version_and_hash(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "ranks.json"
    arguments = ["--cases", "1", "--finite-elements", "0", "--jobs", "1", "--json"]
    calibration.run([*arguments, "--output", str(file)])
    written = json.loads(file.read_text(encoding="utf-8"))
    assert {"version", "seed", "sha256", "ranks"} == written.keys()
    assert len(written["ranks"]) == 1
    printed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {line["quantity"] for line in printed} >= {"log modulus", "equivalent modulus"}


def test_the_published_table_agrees_with_the_stored_ranks() -> None:
    docs = Path(__file__).parents[1] / "docs"
    stored = json.loads((docs / "validation" / "calibration.json").read_text(encoding="utf-8"))
    text = json.dumps(stored["ranks"], separators=(",", ":"))
    assert hashlib.sha256(text.encode()).hexdigest() == stored["sha256"]
    table = (docs / "validation.md").read_text(encoding="utf-8")
    for source, title in (
        (calibration.MODEL, "1000 of the model"),
        (calibration.FINITE_ELEMENTS, "100 by finite"),
    ):
        ranks = np.array([r["log modulus"] for r in stored["ranks"] if r["source"] == source])
        deviation = ndtri(np.clip(ranks, 1e-6, 1 - 1e-6)).std()
        (row,) = [line for line in table.splitlines() if line.startswith(f"| {title}")]
        assert f"| {deviation:.2f} |" in row
