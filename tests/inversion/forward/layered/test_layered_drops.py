"""Layered ground against finite elements: the project's own, and a folder of another program's."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inversion import Instrument
from inversion.forward.layered import LayeredGround, LayeredGrounds, Medium
from inversion.forward.model import Synthesis
from pfwd.analysis.analyse import record_of
from pfwd.files.traces import read_traces
from simulators.drop import Hammer, simulate_drop
from simulators.mesh import Plate, SoilLayer, SoilProfile
from tests.inversion.forward.layered.histories import layered_displacement

RADIUS = 0.15
OFFSETS = (0.0, 0.3, 0.6, 0.9)


@pytest.mark.slow
@pytest.mark.parametrize("contact", ["rough", "smooth"])
@pytest.mark.parametrize(
    ("layers", "base"),
    [
        ((SoilLayer(2.5e7, 2e4, 1900, 0.30, 0.3), SoilLayer(8e7, 8e4, 2050, 0.40, 1.2)), "rigid"),
        ((SoilLayer(2.2e8, 1.9e5, 2050, 0.35, 0.23), SoilLayer(5.9e7, 1e5, 2030, 0.35)), "none"),
    ],
)
def test_finite_elements_of_the_simulators(layers: Any, base: Any, contact: Any) -> None:
    """Measured: 0.04 % under the plate, 0.12 % of each sensor's own peak beside it."""
    drop = simulate_drop(
        SoilProfile(layers, base),
        Plate(RADIUS, 12.0, contact),
        Hammer(10.0, 5.6e5, 3.0),
        OFFSETS,
        duration=0.05,
        time_step=2e-4,
    )
    instrument = Instrument(RADIUS, 12.0)
    synthesis = Synthesis(instrument, drop.time, drop.load, drop.time[1:], 1600.0)
    media = tuple(
        Medium(m.modulus, m.viscosity, m.density, m.poisson_ratio, m.thickness) for m in layers
    )
    grounds = LayeredGrounds.of([LayeredGround(media, base == "rigid")])
    result = layered_displacement(f"rigid-{contact}", instrument, OFFSETS, synthesis, grounds)[0]
    expected = drop.ground_displacement[:, 1:]
    error = np.max(np.abs(result - expected), axis=1) / np.max(np.abs(expected), axis=1)
    assert error[0] < 1e-3
    assert np.all(error < 2e-3)


NAMES = [f"layers{number:02}" for number in range(1, 7)]


@pytest.mark.parametrize("name", NAMES)
def test_finite_elements_of_another_program(name: str, shared: Path) -> None:
    """Bonded plate, noise of 0.05 to 0.4 % of the peak, about 0.3 % too stiff themselves."""
    folder = shared / "layered"
    truth = json.loads((folder / "truth.json").read_text())[name]
    point = read_traces(folder / f"{name}.csv")
    record = record_of(point.drops[0], point.setup)
    rock = truth["rock_depth_m"]
    above = truth["thickness_m"]
    media = tuple(
        Medium(
            1e6 * layer["modulus_MPa"],
            1e3 * layer["viscosity_kPa_s"],
            layer["density"],
            record.poisson_ratio,
            h,
        )
        for layer, h in zip(
            truth["layers"], [*above, math.inf if rock is None else rock - sum(above)], strict=True
        )
    )
    time = record.time - record.time[0]
    synthesis = Synthesis(record.instrument, time, record.load, time[1:], 1600.0)
    grounds = LayeredGrounds.of([LayeredGround(media, rock is not None)])
    offsets = [sensor.offset for sensor in record.sensors]
    (moved,) = layered_displacement("rigid-rough", record.instrument, offsets, synthesis, grounds)
    for sensor, result in zip(record.sensors, moved, strict=True):
        assert sensor.quantity == "velocity"
        residual = np.gradient(result, time[1]) - sensor.values[1:]
        rms = np.sqrt(np.mean(residual**2)) / np.max(np.abs(sensor.values))
        # Noise and what their mesh leaves.
        assert rms < math.hypot(1.1 * truth["noise"], 4.5e-3)
