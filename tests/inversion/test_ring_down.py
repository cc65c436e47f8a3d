"""Natural frequency and damping of a decay: simulated ones, and a seismometer with a laser."""

import csv
from pathlib import Path

import numpy as np
import pytest

from inversion import InversionError
from inversion.ring_down import decays


@pytest.mark.parametrize("damping", [0.02, 0.2, 0.5, 0.7])
def test_intervals_hold_and_errors_are_small(damping: float) -> None:
    rng = np.random.default_rng(int(100 * damping))
    time = np.arange(0, 3.0, 2e-3)
    frequencies = rng.uniform(3, 12, 8)
    errors, held = [], 0
    for frequency in frequencies:
        omega = 2 * np.pi * frequency
        phase = omega * np.sqrt(1 - damping**2) * time + rng.uniform(0.2, 1.4)
        values = np.exp(-damping * omega * time) * np.sin(phase)
        values += 0.002 * rng.standard_normal(time.size)
        fit = decays(time, values)[0]
        low, high = fit.natural_frequency_interval
        lowest, highest = fit.damping_interval
        held += low <= frequency <= high and lowest <= damping <= highest
        errors.append((abs(fit.natural_frequency - frequency), abs(fit.damping - damping)))
    assert held >= 6  # both of two intervals of 95 %
    assert np.max(errors, axis=0)[0] < 0.1
    assert np.max(errors, axis=0)[1] < 0.02


@pytest.mark.parametrize("column", ["FuncGen", "Laser"])
def test_a_measured_decay_changes_with_its_amplitude(column: str, shared: Path) -> None:
    with (shared / "ringdown" / "sm3_free_period.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    time = np.array([float(row["Seconds"]) for row in rows])
    parts = decays(time - time[0], np.array([float(row[column]) for row in rows]))
    # Computed for the data's description by another program, in five windows with other ends.
    expected = [0.4737, 0.4767, 0.4791, 0.4812, 0.4831]
    np.testing.assert_allclose([p.natural_frequency for p in parts], expected, atol=1e-3)
    np.testing.assert_allclose(
        [part.damping for part in parts], [0.0172, 0.0141, 0.0126, 0.0113, 0.0107], atol=1e-3
    )


def test_noise_is_no_decay() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(InversionError, match="decaying oscillation"):
        decays(np.arange(500) * 1e-3, rng.standard_normal(500))
